// Files that are dropped on the page or chosen: read by a worker of their own, which takes the place of the scene's once it has read all.

/** Gaussians that are read at most, as engine/src/formats/limits.rs has it. */
const MOST = 2 ** 24;
/** The worker that reads a file. */
let reading = null;

/** Shows a file in place of the scene; where that cannot be, says why, and the scene stays. */
async function openFile(file) {
  reading?.end();
  const own = (reading = new Helper(ownWorker()));
  say(`${file.name}: reading …`);
  try {
    await begun;
    if (!drawing) throw new Error("this browser offers no WebGL2");
    const { buffer, still, scene } = await own.ask({ kind: "file", file, most: Math.min(MOST, drawing.room), axes: saidAxes() });
    const source = scene ? new Contained(new BlobFile(file), scene, own, file.name) : new Local(file.name, packetIn(buffer), still);
    const packet = await source.packet(0);
    if (reading !== own) return;
    drawing.upload(packet);
    reading = null;
    say("");
    leave();
    use(own, source);
    await store.refresh();
    enter();
    if (still?.note) refuse(`${file.name}: ${still.note}`);
  } catch (e) {
    own.end();
    if (reading === own) reading = null;
    refuse(`${file.name}: ${e.message}`);
  }
}

/** Axes of a file's numbers, as the address says them (#axes=rdf). */
const saidAxes = () => new URLSearchParams(location.hash.slice(1)).get("axes")?.toUpperCase();

/** Says why nothing was opened, or what was assumed, until the user does something else. */
function refuse(text) {
  say(text);
  const until = new AbortController();
  const end = () => (say(""), until.abort());
  for (const act of ["pointerdown", "keydown"]) window.addEventListener(act, end, { signal: until.signal });
}

/** The one file among what was dropped. */
function openDropped({ files, items }) {
  if (!files.length) return;
  const { name } = files[0];
  if (files.length > 1) refuse(`${name}: expected one file, found ${files.length}`);
  else if (items[0]?.webkitGetAsEntry?.()?.isDirectory) refuse(`${name}: expected a file, found a folder (open it with: streamsplat view FOLDER)`);
  else openFile(files[0]);
}

function listenToFiles() {
  const over = (on) => document.documentElement.classList.toggle("over", on);
  window.addEventListener("dragover", (e) => {
    e.preventDefault();
    over(true);
  });
  window.addEventListener("dragleave", (e) => e.relatedTarget || over(false));
  window.addEventListener("drop", (e) => {
    e.preventDefault();
    over(false);
    openDropped(e.dataTransfer);
  });
  find("open").addEventListener("click", () => find("file").click());
  find("file").addEventListener("change", ({ target }) => {
    if (target.files.length) openFile(target.files[0]);
    // The same file can be chosen again.
    target.value = "";
  });
}
