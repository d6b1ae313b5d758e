import * as Splats from "/@mkkellogg/gaussian-splats-3d/build/gaussian-splats-3d.module.js";
import { stage } from "./three.mjs";

export async function show(file, view) {
  const { camera, renderer } = stage(view);
  const viewer = new Splats.Viewer({
    renderer,
    camera,
    selfDrivenMode: false,
    useBuiltInControls: false,
    sharedMemoryForWorkers: false, // without the headers that it needs
    integerBasedSort: false, // thousandths of a unit would be too coarse
    enableSIMDInSort: false,
    gpuAcceleratedSort: false,
    sceneRevealMode: Splats.SceneRevealMode.Instant,
    sphericalHarmonicsDegree: 2,
    logLevel: Splats.LogLevel.None,
  });
  await viewer.addSplatScene(file, { showLoadingUI: false, progressiveLoad: false, splatAlphaRemovalThreshold: 0 });
  return () => {
    viewer.update();
    viewer.render();
  };
}
