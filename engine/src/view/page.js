// The page: its state, what the user does to it, and one picture after another.

const find = (id) => document.getElementById(id);
const BACKGROUNDS = [0.07, 0.5, 1];
const SPEEDS = [...find("speed").options].map((option) => Number(option.value));
/** How often more of a stream is requested, in milliseconds. */
const POLL = 400;
/** How long an interval that did not come is left alone, in milliseconds. */
const RETRY = 2000;
const GONE = "The server does not answer any more. What was loaded can still be looked at.";
/** Key frames marked on the time line at most. */
const MARKS = 160;
const PLAY = "M5 3l12 7-12 7z";
const PAUSE = "M5 3h3.5v14H5zM11.5 3H15v14h-3.5z";

const canvas = find("canvas");
const embedded = find("scene");
const camera = new Camera();
const sway = new Sway(camera);
const pace = new Pace();
let drawing = null;
let [orders, store] = [null, null];

/** A worker that runs the page's own script. */
const ownWorker = () => new Worker(URL.createObjectURL(new Blob([find("worker").textContent], { type: "text/javascript" })));

/** Takes a source of intervals and its worker into use, in place of those before. */
function use(helper, source) {
  orders?.helper.end();
  const own = (orders = new Orders(helper, () => (due = true)));
  store = new Store(source, (interval) => own.forget(interval));
}

const state = {
  time: 0,
  playing: false,
  following: false,
  loop: true,
  free: false, // whether a scene in time is turned without bounds
  springing: false, // whether it turns back to where that is free
  mode: 0,
  background: [0.07, 0.07, 0.07],
  picked: null, // { identity, … }
  shown: null, // { packet, interval, order, t, view } of the picture on the screen
};

/** The headset that the scene is shown in, if any. */
let headset = null;
/** True if the next frame must be drawn although nothing plays: something changed. */
let stale = true;
/** True if a better order came for what is on the screen: it is drawn again, and nothing moved. */
let due = false;
let placed = false;
let placing = null;

// ---- Messages -------------------------------------------------------------------------------------------------------------------

function say(text) {
  find("message").textContent = text;
  find("message").hidden = !text;
}

/** Sets an element's text where it differs. */
function write(id, text) {
  const element = find(id);
  if (element.textContent !== text) element.textContent = text;
}

const count = (n, what) => `${n.toLocaleString("en")} ${what}${n === 1 ? "" : "s"}`;

// ---- Time -----------------------------------------------------------------------------------------------------------------------

function seek(time) {
  const [start, end] = store.span;
  const next = clamp(time, start, end);
  if (next !== state.time) stale = true;
  state.time = next;
}

/** The user chose a time: a stream is no longer followed. */
function jump(time) {
  follow(false);
  seek(time);
}

function play(on) {
  const [start, end] = store.span;
  state.playing = on && end > start;
  // What has ended begins again.
  if (state.playing && !state.loop && state.time >= end) seek(start);
  find("play").setAttribute("aria-label", on ? "Pause" : "Play");
  find("symbol").setAttribute("d", on ? PAUSE : PLAY);
  stale = true;
}

function follow(on) {
  state.following = on && Boolean(store.about?.live);
  find("live").setAttribute("aria-pressed", String(state.following));
}

/** Takes the time `seconds` further. */
function advance(seconds) {
  const [start, end] = store.span;
  if (state.following) {
    // A second behind is caught up with within about a second.
    seek(state.time + seconds * Math.max(1, end - state.time));
    return;
  }
  if (!state.playing || end === start) return;
  const next = state.time + seconds * Number(find("speed").value);
  const streams = store.about.live && !store.about.complete;
  seek(next > end ? (streams || !state.loop ? end : start) : next);
  if (next > end && !streams && !state.loop) play(false);
}

function loop(on) {
  state.loop = on;
  find("loop").setAttribute("aria-pressed", String(on));
}

function listTimes() {
  const [start, end] = store.span;
  const slider = find("time");
  slider.min = start;
  slider.max = end;
  // One frame has no time line; a stream's may still get one.
  document.documentElement.classList.toggle("instant", end === start && !store.about.live);
  const marks = store.times.slice(store.first).map((times) => times.end);
  const shown = marks.length <= MARKS && end > start ? marks : [];
  find("marks").replaceChildren(
    ...shown.map((time) => {
      const mark = document.createElement("i");
      mark.style.left = `${(100 * (time - start)) / (end - start)}%`;
      return mark;
    }),
  );
}

// ---- The picture ----------------------------------------------------------------------------------------------------------------

/** Makes the canvas as large as it is seen; a device may have several pixels to one of the page. */
function fit() {
  const scale = Math.min(window.devicePixelRatio || 1, 2) * pace.detail;
  const [width, height] = [window.innerWidth, window.innerHeight].map((side) => Math.max(1, Math.round(side * scale)));
  if (canvas.width === width && canvas.height === height) return;
  canvas.width = width;
  canvas.height = height;
  stale = true;
}

/** Lets the camera turn about the middle of the first interval, whichever is shown: an address is the same picture wherever one came from. */
function place() {
  if (performance.now() < again) return;
  const own = store;
  placing ??= store.fetch(0).then(
    (first) => {
      camera.depth = depthOf(depthsOf(first).middle);
      placed = stale = true;
    },
    (e) => {
      if (own !== store) return;
      placing = null;
      again = performance.now() + RETRY;
      say(e instanceof TypeError ? GONE : `Interval 0: ${e.message}`);
    },
  );
}

/** When an interval that did not come is requested again, in milliseconds of the browser's clock. */
let again = 0;

/** Asks for an interval; where it does not come, not again for a while. */
function load(interval) {
  if (performance.now() < again) return;
  const own = store;
  store.fetch(interval).then(
    () => {
      if (own === store) say("");
      stale = true;
    },
    (e) => {
      if (own !== store) return;
      again = performance.now() + RETRY;
      // fetch() throws a TypeError without an answer.
      say(e instanceof TypeError ? GONE : `Interval ${interval}: ${e.message}`);
    },
  );
}

/** How a packet is drawn, apart from where from. */
function appearance(packet) {
  const { far, near } = packet.still ? { far: 0, near: 1 } : depthsOf(packet);
  return { mode: state.mode, background: state.background, range: [far, near] };
}

/** The packet at the state's time with its order from a view, and how it is drawn; null where its interval, or what places the camera, is still to come. */
function sceneFrom(view) {
  const interval = store.find(state.time);
  const packet = store.held(interval);
  if (!packet) {
    load(interval);
    return null;
  }
  if (interval + 1 < store.times.length) store.fetch(interval + 1).catch(() => {});
  if (!placed) {
    place();
    return null;
  }
  const t = packet.end > packet.start ? clamp((state.time - packet.start) / (packet.end - packet.start), 0, 1) : 0;
  orders.want(interval, t, view, moving() && store.kept.has(interval + 1) ? interval + 1 : null);
  const found = orders.of(interval, t, view);
  return found && { packet, interval, t, ...found, looks: { ...appearance(packet), share: found.share } };
}

const moving = () => state.playing || state.following;

/** Draws the scene at the state's time; false where that is still to come. */
function picture() {
  const view = { ...camera.view(canvas.width, canvas.height), share: pace.share };
  const found = sceneFrom(view);
  if (!found) return false;
  // The order of a moment ago serves while things move; where they rest, the picture is exact.
  const { packet, interval, t, order, exact, looks } = found;
  drawing.draw(packet, order, t, view, looks);
  state.shown = { packet, interval, order, t, view, whole: exact && looks.share === 1 };
  pace.drew();
  find("poster")?.remove();
  if (moving() || (state.shown.whole && pace.detail === 1)) canvas.dataset.shown = String(state.time);
  describe();
  mark();
  // An order that is still to come makes it due again.
  return true;
}

/** Writes the panels' texts about the picture. */
function describe() {
  const { packet, interval, view } = state.shown;
  if (packet.still) {
    const trained = packet.antialiased ? " · trained with anti-aliasing" : "";
    write("facts", `${count(packet.count, "Gaussian")} · ${store.about.still.format} · harmonics of degree ${packet.degree}${trained}`);
    write("near", `near ${view.ends[0].toPrecision(2)}`);
    write("far", `${view.ends[1].toPrecision(2)} far`);
    return;
  }
  const [start, end] = store.span;
  const digits = end - start < 100 ? 2 : 1;
  write("clock", `${state.time.toFixed(digits)} / ${end.toFixed(digits)} s`);
  // The instant before the first interval is not counted.
  const [first] = store.times;
  const instant = store.times.length > 1 && first.end === first.start ? 1 : 0;
  const of = store.about.live && !store.about.complete ? "" : ` of ${store.times.length - instant}`;
  write("facts", `${count(packet.count, "Gaussian")} · interval ${Math.max(1, interval + 1 - instant)}${of} · ${Number(store.about.fps.toFixed(3))} fps`);
  const slider = find("time");
  const frame = Math.round((state.time - start) * store.about.fps) + 1;
  slider.setAttribute("aria-valuetext", `${state.time.toFixed(digits)} seconds of ${end.toFixed(digits)}, frame ${frame}`);
  if (document.activeElement !== slider || Number(slider.value) !== state.time) slider.value = state.time;
  if (state.mode === 1) {
    const { far, near } = depthsOf(packet);
    write("near", `near ${depthOf(clamp(near, 0, 1)).toPrecision(2)}`);
    write("far", `${depthOf(clamp(far, 0, 1)).toPrecision(2)} far`);
  }
}

/** Draws the path of the identity that was picked. */
function mark() {
  const { packet, interval, t, view } = state.shown;
  const scale = canvas.clientWidth / canvas.width;
  const onPage = (point) => project(view, point).slice(0, 2).map((x) => x * scale);
  const visible = (point) => point && project(view, point)[2] > nearest(view);
  const path = state.picked ? pathOf(store, interval, state.picked.identity).filter(visible) : [];
  find("path").setAttribute("points", path.map((point) => onPage(point).join(",")).join(" "));
  const here = state.picked && whereIs(packet, state.picked.identity, t);
  find("here").style.display = visible(here) ? "" : "none";
  if (visible(here)) {
    const [x, y] = onPage(here);
    find("here").setAttribute("cx", x);
    find("here").setAttribute("cy", y);
  }
}

/** Takes the time further, unless it waits for an interval that is still to come. */
function pass(seconds) {
  if (!state.shown || store.held(store.find(state.time))) advance(seconds);
}

/** One turn of the browser's clock. */
let before = performance.now();
function turn(now) {
  const seconds = Math.min(0.1, Math.max(0, (now - before) / 1000));
  before = now;
  requestAnimationFrame(turn);
  if (headset) return;
  if (sway.advance(seconds)) stale = true;
  if (state.springing) spring(seconds);
  if (pace.turn(now, state.playing || state.following || sway.on || stale)) stale = true;
  fit();
  if (store.times.length && drawing) {
    pass(seconds);
    if (stale || due) {
      due = false;
      try {
        stale = !picture();
      } catch (e) {
        stale = false;
        say(e.message);
      }
    }
  }
}

// ---- Picking --------------------------------------------------------------------------------------------------------------------

/** Intervals on either side of the present one through which a picked identity is followed. */
const FOLLOWED = 8;

/** Picks what is shown at a place of the page; null lets go. */
function choose(place) {
  const { packet, interval, order, t, view } = state.shown ?? {};
  const scale = canvas.width / canvas.clientWidth;
  state.picked = place && packet ? pick(packet, order, t, view, place[0] * scale, place[1] * scale) : null;
  find("card").hidden = !state.picked;
  stale = true;
  if (!state.picked) return;
  const { identity, birth, weight, colour } = state.picked;
  find("swatch").style.background = `rgb(${colour.join(" ")})`;
  write("identity", String(identity));
  for (let i = Math.max(store.first, interval - FOLLOWED); i <= interval + FOLLOWED && i < store.times.length; i++) {
    store.fetch(i).then(() => (stale = true), () => {});
  }
  const story = packet.still ? "its number in the file" : `first seen in key frame ${birth}`;
  write("story", `${story} · ${Math.round(100 * weight)} % of this pixel`);
}

// ---- What the user does ---------------------------------------------------------------------------------------------------------

function changed() {
  sway.stop();
  stale = true;
  writeAddress();
}

function show(mode) {
  state.mode = mode;
  for (const button of document.querySelectorAll("[data-mode]")) {
    button.setAttribute("aria-pressed", String(Number(button.dataset.mode) === mode));
  }
  find("legend").hidden = mode !== 1;
  stale = true;
}

function look(perspective) {
  camera.perspective = perspective;
  find("perspective").setAttribute("aria-pressed", String(perspective));
  stale = true;
}

/** Lets go of the scene: it turns back to where turning is free, at once where the system asks for less motion. */
function release() {
  state.springing = true;
  if (window.matchMedia("(prefers-reduced-motion: reduce)").matches) spring(Infinity);
}

function spring(seconds) {
  state.springing = camera.settle(seconds);
  if (state.springing) changed();
}

function turnFreely(on) {
  state.free = on;
  find("free").checked = on;
  camera.bounded = !on && !store.about.still;
  if (camera.bounded) release();
}

function changeSpeed(by) {
  const place = clamp(SPEEDS.indexOf(Number(find("speed").value)) + by, 0, SPEEDS.length - 1);
  find("speed").value = String(SPEEDS[place]);
}

function nextBackground() {
  const grey = BACKGROUNDS[(BACKGROUNDS.indexOf(state.background[0]) + 1) % BACKGROUNDS.length];
  state.background = [grey, grey, grey];
}

/** The key frame before (−1) or after (+1) the state's time. */
function keyFrame(by) {
  const ends = store.times.slice(store.first).map((times) => times.end);
  const others = ends.filter((time) => (by > 0 ? time > state.time + 1e-9 : time < state.time - 1e-9));
  return (by > 0 ? others[0] : others[others.length - 1]) ?? state.time;
}

function openKeys() {
  if (state.shown) find("camera").value = JSON.stringify(cameraFile(state.shown.view));
  find("keys").showModal();
}

const KEYS = {
  " ": () => play(!state.playing),
  ArrowLeft: (e) => jump(e.shiftKey ? keyFrame(-1) : state.time - 1 / store.about.fps),
  ArrowRight: (e) => jump(e.shiftKey ? keyFrame(1) : state.time + 1 / store.about.fps),
  Home: () => jump(store.span[0]),
  End: () => jump(store.span[1]),
  "[": () => changeSpeed(-1),
  "]": () => changeSpeed(1),
  1: () => show(0),
  2: () => show(1),
  3: () => show(2),
  ",": () => jump(state.time - 1 / store.about.fps),
  ".": () => jump(state.time + 1 / store.about.fps),
  a: () => (camera.turn(5, 0), release()),
  d: () => (camera.turn(-5, 0), release()),
  w: () => (camera.turn(0, 5), release()),
  s: () => (camera.turn(0, -5), release()),
  t: () => turnFreely(!state.free),
  "+": () => camera.magnify(1.1),
  "=": () => camera.magnify(1.1),
  "-": () => camera.magnify(1 / 1.1),
  p: () => look(!camera.perspective),
  r: () => camera.reset(),
  f: () => camera.reset(),
  b: nextBackground,
  o: () => find("file").click(),
  u: () => (find("interface").hidden = !find("interface").hidden),
  l: () => (store.about.live && !store.about.complete ? follow(!state.following) : loop(!state.loop)),
  v: toggleFullscreen,
  i: askSize,
  c: copyLink,
  h: openKeys,
  "?": openKeys,
  Escape: () => choose(null),
};

function listenToKeys() {
  window.addEventListener("keydown", (e) => {
    const key = e.key.length === 1 ? e.key.toLowerCase() : e.key;
    const inControl = e.target.matches("textarea, select") || find("keys").open || find("picture").open;
    // A button or the slider keeps the keys that work it.
    const own = (e.target.matches("button") && key === " ") || (e.target.matches("input") && key.startsWith("Arrow"));
    if (!KEYS[key] || inControl || own || e.ctrlKey || e.metaKey || e.altKey || !store.about) return;
    e.preventDefault();
    KEYS[key](e);
    changed();
  });
}

function listenToButtons() {
  const click = (id, act) => find(id).addEventListener("click", () => (act(), changed()));
  click("play", () => play(!state.playing));
  click("perspective", () => look(!camera.perspective));
  click("home", () => camera.reset());
  click("live", () => follow(!state.following));
  click("loop", () => loop(!state.loop));
  click("back", () => jump(state.time - 1 / store.about.fps));
  click("next", () => jump(state.time + 1 / store.about.fps));
  find("free").addEventListener("change", ({ target }) => turnFreely(target.checked));
  click("unpick", () => choose(null));
  find("help").addEventListener("click", openKeys);
  for (const button of document.querySelectorAll("[data-mode]")) {
    button.addEventListener("click", () => (show(Number(button.dataset.mode)), changed()));
  }
  find("time").addEventListener("input", () => (jump(Number(find("time").value)), changed()));
}

/** Drags move the camera; a click picks. */
function listenToPointers() {
  const begun = () => {
    sway.stop();
    state.springing = false;
  };
  followPointers(canvas, () => camera, { begun, changed, released: release, tapped: choose });
}

function listen() {
  listenToKeys();
  listenToButtons();
  listenToPointers();
  listenToFiles();
  listenToActions();
  window.addEventListener("hashchange", addressChanged);
  canvas.addEventListener("webglcontextlost", (e) => (e.preventDefault(), (drawing = null)));
  canvas.addEventListener("webglcontextrestored", () => ((drawing = new Drawing(canvas)), (stale = true)));
  // For measurements: what the worker did, and how many pictures were drawn.
  canvas.work = () => ({ ...orders.work, pictures: pace.pictures });
}

// ---- Streams --------------------------------------------------------------------------------------------------------------------

const wait = (milliseconds) => new Promise((done) => setTimeout(done, milliseconds));

/** Asks for what is new until the stream ends; keeps what comes, as far as there is room. */
async function keepUp() {
  const own = store;
  let failures = 0;
  while (own === store && !own.about.complete && failures < 5) {
    await wait(POLL);
    try {
      const from = own.times.length;
      const more = await own.refresh();
      if (own.about.placement) camera.place(own.about.placement);
      for (let i = from; i < from + more; i++) if (own.times[i]) await own.fetch(i).catch(() => {});
      if (more) listTimes();
      failures = 0;
    } catch {
      failures++;
    }
  }
  if (own !== store) return;
  if (!own.about.complete) say(GONE);
  own.about.complete = true;
  find("live").textContent = "Ended";
  find("live").disabled = true;
  follow(false);
  stale = true;
}

// ---- The beginning --------------------------------------------------------------------------------------------------------------

/** Makes the page that of a still scene: without time. */
function stand(still) {
  camera.frame(still);
  placed = true;
  document.documentElement.classList.add("still");
  for (const element of document.querySelectorAll("[data-still]")) {
    element.dataset.moving ??= element.textContent;
    element.textContent = element.dataset.still;
  }
  if (still.view) find("home").textContent = find("home").dataset.moving;
  else find("home").title = "Back to where all of it is seen from (R)";
  document.querySelector("[data-mode='2']").title = "Each Gaussian in a colour of its own (3)";
}

/** Makes the page that of a scene in time again. */
function run() {
  document.documentElement.classList.remove("still");
  for (const element of document.querySelectorAll("[data-moving]")) element.textContent = element.dataset.moving;
  find("home").title = "Back to the source's view (R)";
  document.querySelector("[data-mode='2']").title = "Identity (3)";
}

/** Lets go of the scene and of everything about it. */
function leave() {
  sway.stop();
  follow(false);
  choose(null);
  state.shown = null;
  [placed, placing] = [false, null];
  pace.quick = 1;
  again = 0;
  history.replaceState(null, "", "#");
}

/** Shows the store's scene from its beginning, or as the address says. */
function enter() {
  const { title, placement, live, still } = store.about;
  document.title = `${title} · streamsplat`;
  write("title", title);
  if (placement) camera.place(placement);
  if (still) stand(still);
  else run();
  camera.bounded = !state.free && !still;
  find("loop").hidden = live;
  find("live").hidden = !live;
  listTimes();
  seek(store.span[0]);
  const rests = readAddress() || window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  if (live) {
    write("facts", "Waiting for the first interval …");
    follow(!rests);
    keepUp();
  } else {
    play(!rests);
    if (!rests && !location.hash) sway.start();
  }
}

async function begin() {
  const helper = new Helper(ownWorker());
  use(helper, embedded ? new Embedded(embedded, helper) : new Served(helper));
  play(false);
  listen();
  drawing = new Drawing(canvas);
  requestAnimationFrame(turn);
  await store.refresh();
  enter();
}

const begun = begin().catch((e) => {
  write("facts", "The scene cannot be shown");
  say(e.message);
});
