import * as pc from "playcanvas";

export async function show(file, { position, look_at, up, fov_y_degrees }) {
  const canvas = document.createElement("canvas");
  document.body.append(canvas);
  const app = new pc.Application(canvas, { graphicsDeviceOptions: { antialias: false, preserveDrawingBuffer: true } });
  app.setCanvasFillMode(pc.FILLMODE_NONE, innerWidth, innerHeight);
  app.setCanvasResolution(pc.RESOLUTION_FIXED, innerWidth, innerHeight);
  app.start();
  const camera = new pc.Entity();
  camera.addComponent("camera", { fov: fov_y_degrees, nearClip: 0.01, farClip: 100, clearColor: new pc.Color(0, 0, 0, 1) });
  camera.setPosition(...position);
  camera.lookAt(new pc.Vec3(...look_at), new pc.Vec3(...up));
  app.root.addChild(camera);
  const kind = file.endsWith(".glb") ? "container" : "gsplat";
  const asset = new pc.Asset(file, kind, { url: file });
  app.assets.add(asset);
  await new Promise((ready, failed) => {
    asset.ready(ready);
    asset.on("error", failed);
    app.assets.load(asset);
  });
  let entity = new pc.Entity();
  if (kind === "container") entity = asset.resource.instantiateRenderEntity();
  else entity.addComponent("gsplat", { asset });
  app.root.addChild(entity);
  return () => {
    app.renderNextFrame = true;
  };
}
