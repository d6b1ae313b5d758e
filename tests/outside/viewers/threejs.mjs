import * as THREE from "three/webgpu";
import { GaussianSplat } from "three/addons/objects/GaussianSplat.js";
import { GaussianSplatPLYLoader } from "three/addons/loaders/GaussianSplatPLYLoader.js";
import { GLTFGaussianSplatLoaderExtension } from "three/addons/loaders/GLTFGaussianSplatLoaderExtension.js";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { SPLATLoader } from "three/addons/loaders/SPLATLoader.js";
import { SPZLoader } from "three/addons/loaders/SPZLoader.js";

/** It treats splats' colours as linear and encodes them: `linear` prevents that. */
export async function show(file, { position, look_at, up, fov_y_degrees, linear }) {
  const camera = new THREE.PerspectiveCamera(fov_y_degrees, innerWidth / innerHeight, 0.01, 100);
  camera.up.set(...up);
  camera.position.set(...position);
  camera.lookAt(...look_at);
  const renderer = new THREE.WebGPURenderer({ antialias: false, forceWebGL: true });
  if (linear) renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
  await renderer.init();
  renderer.setPixelRatio(1);
  renderer.setSize(innerWidth, innerHeight);
  renderer.setClearColor(0x000000, 1);
  document.body.append(renderer.domElement);
  const scene = new THREE.Scene();
  const ending = file.split(".").pop();
  if (ending === "glb") {
    const loader = new GLTFLoader();
    loader.register((parser) => new GLTFGaussianSplatLoaderExtension(parser));
    scene.add((await loader.loadAsync(file)).scene);
  } else {
    const loader = { ply: GaussianSplatPLYLoader, splat: SPLATLoader, spz: SPZLoader }[ending];
    scene.add(new GaussianSplat(await new loader().loadAsync(file)));
  }
  return () => renderer.render(scene, camera);
}
