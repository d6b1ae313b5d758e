// A scene in time as an object of three.js.

import { Clip } from "./clip.js";
import { Clock } from "./clock.js";
import { PER_ROW } from "./draw.js";
import { FRAGMENT, VERTEX, backToFront, inFours, playback, viewOf } from "./placed.js";

/** Creates an integer texture that is read texel by texel. */
function texture(THREE, data, width, height, format, type, internalFormat) {
  const made = new THREE.DataTexture(data, width, height, format, type);
  Object.assign(made, { internalFormat, unpackAlignment: 1, generateMipmaps: false, minFilter: THREE.NearestFilter, magFilter: THREE.NearestFilter });
  made.needsUpdate = true;
  return made;
}

/** The uniforms that are textures; the mode of splat.vert that draws colours. */
const TEXTURES = ["records", "rates", "order"];
const COLOUR = 0;

/**
 * A scene in time for a scene of three.js, drawn by a WebGLRenderer: `const video = await load(THREE, "clip.ssz"); scene.add(video);` and
 * `video.update(seconds)` before each picture. It occludes other objects and is occluded by them. Its origin is the point that the source's camera
 * looked at in the first interval; x is right, y up, z towards that camera; a unit is half the height of the model's input.
 */
export async function load(THREE, source, options = {}) {
  const clip = await Clip.open(source, options);
  await clip.place();

  return new (class Splats extends playback(THREE.Mesh) {
    constructor() {
      const rows = Math.max(1, Math.ceil(clip.most / PER_ROW));
      const words = new Uint32Array(2 * PER_ROW * rows * 4);
      const rates = new Int8Array(4 * PER_ROW * rows);
      const order = new Uint32Array(PER_ROW * rows);
      const geometry = new THREE.InstancedBufferGeometry();
      geometry.setIndex(Array.from({ length: 6 * PER_ROW }, (_, k) => 4 * Math.floor(k / 6) + [0, 1, 2, 2, 1, 3][k % 6]));
      geometry.instanceCount = 0;
      const value = (value) => ({ value });
      const uniforms = {
        records: value(texture(THREE, words, 2 * PER_ROW, rows, THREE.RGBAIntegerFormat, THREE.UnsignedIntType, "RGBA32UI")),
        rates: value(texture(THREE, rates, PER_ROW, rows, THREE.RGBAIntegerFormat, THREE.ByteType, "RGBA8I")),
        order: value(texture(THREE, order, PER_ROW, rows, THREE.RedIntegerFormat, THREE.UnsignedIntType, "R32UI")),
        total: value(0),
        projection: value(new THREE.Matrix4()),
        turn: value(new THREE.Matrix3()),
        ...Object.fromEntries(["positionLow", "positionStep", "velocityLow", "velocityStep", "eye"].map((name) => [name, value(new THREE.Vector3())])),
        ...Object.fromEntries(["focal", "own", "size"].map((name) => [name, value(new THREE.Vector2())])),
        ...Object.fromEntries(["rateStep", "beyond", "t", "units", "scale"].map((name) => [name, value(0)])),
        grow: value(1),
        pinhole: value(false),
        mode: value(COLOUR),
      };
      const material = new THREE.RawShaderMaterial({
        uniforms,
        vertexShader: VERTEX,
        fragmentShader: FRAGMENT,
        glslVersion: THREE.GLSL3,
        transparent: true,
        depthWrite: false,
        side: THREE.DoubleSide,
        blending: THREE.CustomBlending,
        blendSrc: THREE.OneFactor,
        blendDst: THREE.OneMinusSrcAlphaFactor,
      });
      super(geometry, material);
      this.frustumCulled = false;
      this.clip = clip;
      this.clock = new Clock(clip.start, clip.end);
      /** Called when loaded data changes the picture. A program that draws on demand draws then. */
      this.onchange = () => {};
      clip.came = () => this.onchange();
      clip.failed = (error) => this.dispatchEvent({ type: "error", error });
      [this.packet, this.ordered, this.modelView, this.viewport] = [null, null, new THREE.Matrix4(), new THREE.Vector4()];
    }

    onBeforeRender(renderer, scene, camera) {
      this.modelView.multiplyMatrices(camera.matrixWorldInverse, this.matrixWorld);
      renderer.getCurrentViewport(this.viewport);
      const { z: width, w: height } = this.viewport;
      const view = viewOf(clip.camera, this.modelView.elements, camera.projectionMatrix.elements, width, height);
      const found = clip.at(this.clock.time, view, { moving: this.clock.playing, loop: this.clock.loop });
      if (found) this.take(found);
      const { uniforms } = this.material;
      for (const name of ["units", "scale", "pinhole"]) uniforms[name].value = view[name];
      for (const name of ["eye", "focal", "own"]) uniforms[name].value.fromArray(view[name]);
      uniforms.turn.value.fromArray(view.axes.flat());
      uniforms.size.value.set(width, height);
      uniforms.projection.value.copy(camera.projectionMatrix);
      this.material.uniformsNeedUpdate = true;
    }

    /** Uploads the current data to the GPU. */
    take({ packet, order, t }) {
      const { uniforms } = this.material;
      if (packet !== this.packet) {
        uniforms.records.value.image.data.set(packet.words);
        inFours(packet.rates, uniforms.rates.value.image.data);
        for (const name of ["records", "rates"]) uniforms[name].value.needsUpdate = true;
        for (const name of ["positionLow", "positionStep", "velocityLow", "velocityStep"]) uniforms[name].value.fromArray(packet[name]);
        uniforms.rateStep.value = packet.rateStep;
        uniforms.beyond.value = packet.beyond;
        this.packet = packet;
      }
      if (order !== this.ordered) {
        backToFront(order, uniforms.order.value.image.data);
        uniforms.order.value.needsUpdate = true;
        uniforms.total.value = order.length;
        this.geometry.instanceCount = Math.ceil(order.length / PER_ROW);
        this.ordered = order;
      }
      uniforms.t.value = t;
    }

    /** Ends the worker and frees GPU memory. */
    dispose() {
      clip.close();
      this.geometry.dispose();
      for (const name of TEXTURES) this.material.uniforms[name].value.dispose();
      this.material.dispose();
    }
  })();
}
