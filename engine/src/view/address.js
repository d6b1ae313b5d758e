// State of the view in the address, so that a link shows what its sender saw.

/** The timer that writes the view into the address. */
let writing = 0;

/** Takes the view from the address (#t=0.5&yaw=20&…). */
function readAddress() {
  clearTimeout(writing);
  // The picture there is shows another view.
  delete canvas.dataset.shown;
  stale = true;
  const said = new URLSearchParams(location.hash.slice(1));
  const number = (key, otherwise) => {
    const value = Number.parseFloat(said.get(key));
    return Number.isFinite(value) ? value : otherwise;
  };
  camera.reset();
  const { yaw, pitch, lens } = camera.home;
  camera.yaw = number("yaw", yaw);
  camera.pitch = clamp(number("pitch", pitch), -STEEPEST, STEEPEST);
  camera.zoom = 1;
  camera.magnify(number("zoom", 1));
  camera.shift = ["x", "y", "z"].map((key) => number(key, 0));
  look((said.get("lens") ?? lens) === "perspective");
  show(Math.max(0, MODES.indexOf(said.get("mode"))));
  const grey = number("background", BACKGROUNDS[0]);
  state.background = [grey, grey, grey].map((level) => clamp(level, 0, 1));
  find("interface").hidden = said.get("interface") === "none";
  if (said.has("t")) jump(number("t", 0));
  return said.has("t");
}

/** The address got another view while the page was open. A view that was waiting to be written may have replaced it since: it is put back. */
function addressChanged(event) {
  const { hash } = new URL(event.newURL);
  if (location.hash !== hash) history.replaceState(null, "", hash || "#");
  sway.stop();
  readAddress();
}

/** Writes the view into the address, once nothing has changed for a while. */
function writeAddress() {
  clearTimeout(writing);
  writing = setTimeout(() => {
    const said = new URLSearchParams();
    const put = (key, value, otherwise, digits) => value !== otherwise && said.set(key, digits ? String(Number(value.toFixed(digits))) : value);
    if (!state.playing && !state.following && !store.about.still) put("t", state.time, null, 4);
    put("yaw", camera.yaw, camera.home.yaw, 2);
    put("pitch", camera.pitch, camera.home.pitch, 2);
    put("zoom", camera.zoom, 1, 4);
    ["x", "y", "z"].forEach((key, i) => put(key, camera.shift[i], 0, 4));
    put("lens", camera.perspective ? "perspective" : "parallel", camera.home.lens);
    put("mode", MODES[state.mode], MODES[0]);
    put("background", state.background[0], BACKGROUNDS[0], 3);
    if (find("interface").hidden) said.set("interface", "none");
    if (saidAxes()) said.set("axes", saidAxes().toLowerCase());
    history.replaceState(null, "", `#${said}`);
  }, 500);
}
