// Shared by viewers on three.js: a camera, and a renderer that draws on black.

import * as THREE from "three";

/** A camera, and a renderer whose canvas fills the page. */
export function stage({ position, look_at, up, fov_y_degrees }) {
  const camera = new THREE.PerspectiveCamera(fov_y_degrees, innerWidth / innerHeight, 0.01, 100);
  camera.up.set(...up);
  camera.position.set(...position);
  camera.lookAt(...look_at);
  camera.updateMatrixWorld();
  const renderer = new THREE.WebGLRenderer({ antialias: false, precision: "highp", preserveDrawingBuffer: true });
  renderer.setPixelRatio(1);
  renderer.setSize(innerWidth, innerHeight);
  renderer.setClearColor(0x000000, 1);
  document.body.append(renderer.domElement);
  return { camera, renderer, THREE };
}
