import { SparkRenderer, SplatMesh } from "/@sparkjsdev/spark/dist/spark.module.js";
import { stage } from "./three.mjs";

export async function show(file, view) {
  const { camera, renderer, THREE } = stage(view);
  const scene = new THREE.Scene();
  scene.add(new SparkRenderer({ renderer }));
  const mesh = new SplatMesh({ url: file });
  scene.add(mesh);
  await mesh.initialized;
  return () => renderer.render(scene, camera);
}
