// Actions of the page other than showing the scene: fullscreen, a picture of any size, a link.

/** Sides of a saved picture, in pixels, at most. */
const LARGEST = 8192;
/** How often a picture that is not at rest is looked at again, 50 ms apart. */
const TRIES = 600;

function toggleFullscreen() {
  if (document.fullscreenElement) document.exitFullscreen();
  else document.documentElement.requestFullscreen?.().catch((e) => refuse(e.message));
}

/** Asks for the size of a picture; what the screen shows is the default. */
function askSize() {
  if (!state.shown) return;
  play(false);
  const scale = Math.min(window.devicePixelRatio || 1, 2);
  find("across").value = Math.round(window.innerWidth * scale);
  find("down").value = Math.round(window.innerHeight * scale);
  find("picture").showModal();
}

/** Saves what is on the screen as a PNG file of width × height pixels, once it is at rest. */
async function savePicture(width, height) {
  const limit = Math.min(LARGEST, drawing.largest);
  if (!(width >= 1 && height >= 1 && width <= limit && height <= limit)) {
    refuse(`expected 1 to ${limit} pixels a side, found ${width}×${height}`);
    return;
  }
  // With all Gaussians, in the order of this view.
  for (let tries = 0; !state.shown?.whole; tries++) {
    if (tries === TRIES) return refuse("the picture is not at rest");
    await wait(50);
  }
  const { packet, order, t } = state.shown;
  [canvas.width, canvas.height] = [width, height];
  drawing.draw(packet, order, t, camera.view(width, height), appearance(packet));
  // Taken before the browser shows anything: the canvas has its own size again in the next picture.
  canvas.toBlob((blob) => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    const when = packet.still ? "" : `-${state.time.toFixed(3)}s`;
    link.download = `${store.about.title.replace(/\.\w+$/, "")}${when}-${width}x${height}.png`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  });
  fit();
  stale = true;
}

/** Copies the page's address, which has the view in it; where the browser does not let a page do that, shows it. */
async function copyLink() {
  writeAddress();
  // It is written once nothing has changed for a while.
  await wait(600);
  try {
    await navigator.clipboard.writeText(location.href);
    say("The link is copied");
    setTimeout(() => find("message").textContent === "The link is copied" && say(""), 1500);
  } catch {
    refuse(location.href);
  }
}

function listenToActions() {
  find("whole").hidden = !document.fullscreenEnabled;
  find("whole").addEventListener("click", toggleFullscreen);
  find("save").addEventListener("click", askSize);
  find("link").addEventListener("click", copyLink);
  find("headset").addEventListener("click", wear);
  offersHeadset().then((has) => (find("headset").hidden = !has));
  find("more").addEventListener("click", () => {
    find("more").setAttribute("aria-expanded", String(find("interface").classList.toggle("more")));
  });
  find("picture").addEventListener("close", () => {
    if (find("picture").returnValue === "save") savePicture(Number(find("across").value), Number(find("down").value));
    find("picture").returnValue = "";
  });
}

/** Shows the scene in a headset until its wearer takes it off. */
async function wear() {
  if (!state.shown || headset) return;
  const selected = () => play(!state.playing);
  const left = () => {
    headset = null;
    stale = true;
  };
  try {
    headset = await Headset.enter(drawing, camera, { advance: pass, found: sceneFrom, selected, left });
  } catch (e) {
    refuse(`headset: ${e.message}`);
  }
}
