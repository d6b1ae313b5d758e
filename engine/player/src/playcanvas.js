// A scene in time as an entity of PlayCanvas's engine, on WebGL2.

import { Clip } from "./clip.js";
import { Clock } from "./clock.js";
import { PER_ROW } from "./draw.js";
import { FRAGMENT, VERTEX, backToFront, inFours, playback, viewOf } from "./placed.js";

/** Creates an integer texture that is read texel by texel. */
function texture(pc, device, name, width, height, format) {
  const [filter, address] = [pc.FILTER_NEAREST, pc.ADDRESS_CLAMP_TO_EDGE];
  const options = { name, width, height, format, mipmaps: false, minFilter: filter, magFilter: filter, addressU: address, addressV: address };
  return new pc.Texture(device, options);
}

/** Fills a texture's array and uploads it to the GPU. */
function fill(texture, put) {
  put(texture.lock());
  texture.unlock();
}

/**
 * A scene in time for an application of PlayCanvas's engine: `const video = await load(pc, app, "clip.ssz"); app.root.addChild(video.entity);` and
 * `video.update(seconds)` before each picture. It occludes other objects and is occluded by them. Its origin is the point that the source's camera
 * looked at in the first interval; x is right, y up, z towards that camera; a unit is half the height of the model's input.
 */
export async function load(pc, app, source, options = {}) {
  const device = app.graphicsDevice;
  if (!device.isWebGL2) throw new Error(`graphics device: expected WebGL2, found ${device.deviceType}`);
  const clip = await Clip.open(source, options);
  await clip.place();
  const video = new Splats(pc, app, clip);
  clip.came = () => video.onchange();
  clip.failed = (error) => video.onerror(error);
  return video;
}

class Splats extends playback(Object) {
  constructor(pc, app, clip) {
    super();
    const device = app.graphicsDevice;
    [this.pc, this.app, this.clip, this.clock] = [pc, app, clip, new Clock(clip.start, clip.end)];
    /** Called when loaded data changes the picture, and when an interval cannot be loaded. */
    [this.onchange, this.onerror] = [() => {}, () => {}];
    const rows = Math.max(1, Math.ceil(clip.most / PER_ROW));
    this.textures = {
      records: texture(pc, device, "records", 2 * PER_ROW, rows, pc.PIXELFORMAT_RGBA32U),
      rates: texture(pc, device, "rates", PER_ROW, rows, pc.PIXELFORMAT_RGBA8I),
      order: texture(pc, device, "order", PER_ROW, rows, pc.PIXELFORMAT_R32U),
    };
    this.material = new pc.ShaderMaterial({
      uniqueName: "streamsplat",
      vertexGLSL: VERTEX,
      // The engine has its own output.
      fragmentGLSL: FRAGMENT.replace("out vec4 colour;\n", "").replace("colour = ", "gl_FragColor = "),
      attributes: { vertex_position: pc.SEMANTIC_POSITION },
    });
    Object.assign(this.material, { blendType: pc.BLEND_PREMULTIPLIED, depthWrite: false, cull: pc.CULLFACE_NONE });
    for (const [name, texture] of Object.entries(this.textures)) this.material.setParameter(name, texture);
    this.material.setParameter("mode", 0);
    this.material.update();
    const mesh = new pc.Mesh(device);
    mesh.setPositions(new Float32Array(3 * 4 * PER_ROW));
    mesh.setIndices(Array.from({ length: 6 * PER_ROW }, (_, k) => 4 * Math.floor(k / 6) + [0, 1, 2, 2, 1, 3][k % 6]));
    mesh.update();
    this.instance = new pc.MeshInstance(mesh, this.material);
    this.instance.setInstancing(true);
    this.instance.cull = false;
    this.instance.instancingCount = 0;
    this.entity = new pc.Entity("streamsplat");
    this.entity.addComponent("render", { meshInstances: [this.instance], castShadows: false });
    [this.packet, this.ordered] = [null, null];
    this.modelView = new pc.Mat4();
    this.listening = app.scene.on("prerender", (camera) => this.prepare(camera));
  }

  /** Called before a camera draws. */
  prepare(component) {
    const { camera } = component;
    const { clip, clock, material } = this;
    const target = camera.renderTarget ?? this.app.graphicsDevice;
    const [width, height] = [target.width * camera.rect.z, target.height * camera.rect.w];
    this.modelView.mul2(camera.viewMatrix, this.entity.getWorldTransform());
    const view = viewOf(clip.camera, this.modelView.data, camera.projectionMatrix.data, width, height);
    const found = clip.at(clock.time, view, { moving: clock.playing, loop: clock.loop });
    if (found) this.take(found);
    const numbers = { grow: 1, units: view.units, scale: view.scale, pinhole: view.pinhole ? 1 : 0, size: [width, height] };
    const lists = { eye: view.eye, focal: view.focal, own: view.own, turn: new Float32Array(view.axes.flat()), projection: camera.projectionMatrix.data };
    for (const [name, value] of Object.entries({ ...numbers, ...lists })) material.setParameter(name, value);
  }

  /** Uploads the current data to the GPU. */
  take({ packet, order, t }) {
    const { material, textures } = this;
    if (packet !== this.packet) {
      fill(textures.records, (words) => words.set(packet.words));
      fill(textures.rates, (fours) => inFours(packet.rates, fours));
      for (const name of ["positionLow", "positionStep", "velocityLow", "velocityStep"]) material.setParameter(name, packet[name]);
      for (const name of ["rateStep", "beyond"]) material.setParameter(name, packet[name]);
      this.packet = packet;
    }
    if (order !== this.ordered) {
      fill(textures.order, (words) => backToFront(order, words));
      material.setParameter("total", order.length);
      this.instance.instancingCount = Math.ceil(order.length / PER_ROW);
      this.ordered = order;
    }
    material.setParameter("t", t);
  }

  /** Ends the worker and frees GPU memory. */
  destroy() {
    this.listening.off();
    this.entity.destroy();
    this.material.destroy();
    for (const texture of Object.values(this.textures)) texture.destroy();
    this.clip.close();
  }
}
