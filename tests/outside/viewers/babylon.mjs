const script = (source) =>
  new Promise((loaded, failed) => {
    const element = Object.assign(document.createElement("script"), { src: source, onload: loaded, onerror: failed });
    document.head.append(element);
  });
for (const source of ["/fflate/umd/index.js", "/babylonjs/babylon.js", "/babylonjs-loaders/babylonjs.loaders.js"]) await script(source);

/** Babylon.js is left-handed: it mirrors y of splats, and x of glTF. */
export async function show(file, { position, look_at, up, fov_y_degrees }) {
  const canvas = Object.assign(document.createElement("canvas"), { width: innerWidth, height: innerHeight });
  document.body.append(canvas);
  const engine = new BABYLON.Engine(canvas, false, { preserveDrawingBuffer: true });
  const scene = new BABYLON.Scene(engine);
  scene.clearColor = new BABYLON.Color4(0, 0, 0, 1);
  const here = ([x, y, z]) => (file.endsWith(".glb") ? new BABYLON.Vector3(-x, y, z) : new BABYLON.Vector3(x, -y, z));
  const camera = new BABYLON.FreeCamera("camera", here(position), scene);
  camera.upVector = here(up);
  camera.setTarget(here(look_at));
  camera.fov = (fov_y_degrees * Math.PI) / 180;
  camera.minZ = 0.01;
  camera.maxZ = 100;
  // By default it loads this library from another server.
  const splat = { spzLibraryUrl: "/@adobe/spz/dist/spz.js" };
  await BABYLON.ImportMeshAsync(file, scene, { pluginOptions: { splat } });
  await scene.whenReadyAsync();
  return () => scene.render();
}
