// The Earth and the sky as a picture, drawn again only when it would look different: without a graphics card, their shades take
// most of the time of a frame, and while the camera rests they hardly change from one frame to the next.

import { Matrix4, NearestFilter, Scene, ShaderMaterial, Vector2, WebGLRenderTarget } from "three";
import { disc, placeOnHorizon } from "viewer/globe";

const MOST_SHIFT = 0.35; // pixels that a part of the picture may be off

const HIDE = {
  vertex: "void main() { gl_Position = projectionMatrix * (modelViewMatrix * vec4(position, 1.0)); }",
  fragment: "void main() { gl_FragColor = vec4(0.0); }",
};

/** The picture; `earth` belongs into the scene that is drawn over it, and hides what lies behind the Earth. */
export class Backdrop {
  constructor(globe) {
    this.globe = globe;
    this.scene = new Scene();
    this.scene.add(globe.sky, globe.group);
    this.picture = new WebGLRenderTarget(1, 1, { minFilter: NearestFilter, magFilter: NearestFilter, generateMipmaps: false });
    this.picture.scissorTest = true;
    this.kept = []; // by view: what its part of the picture shows
    this.drawn = 0;
    this.size = new Vector2();
    this.earth = disc(new ShaderMaterial({ vertexShader: HIDE.vertex, fragmentShader: HIDE.fragment, colorWrite: false }));
    this.earth.renderOrder = -1;
  }

  /** Bring the part of the picture that view `index` shows up to date: `box` is its place [x, y, width, height] in pixels. */
  update(renderer, camera, index, box) {
    placeOnHorizon(this.earth, camera.position);
    renderer.getDrawingBufferSize(this.size);
    if (this.picture.width !== this.size.x || this.picture.height !== this.size.y) {
      this.picture.setSize(this.size.x, this.size.y);
      this.kept = [];
    }
    const look = { box, ...this.#look(camera) };
    if (this.#isStale(this.kept[index], look, camera)) {
      this.kept[index] = look;
      this.#render(renderer, camera, box);
    }
    this.#copy(renderer, box);
  }

  #render(renderer, camera, box) {
    this.picture.viewport.set(...box);
    this.picture.scissor.set(...box);
    renderer.setRenderTarget(this.picture);
    renderer.clear();
    renderer.render(this.scene, camera);
    renderer.setRenderTarget(null);
    this.drawn++;
  }

  /** Copy a part of the picture to the canvas: software does this much faster by a blit than by a textured surface. */
  #copy(renderer, [x, y, width, height]) {
    const gl = renderer.getContext();
    const { __webglFramebuffer: source } = renderer.properties.get(this.picture);
    const box = [x, y, x + width, y + height];
    renderer.state.bindFramebuffer(gl.READ_FRAMEBUFFER, source);
    gl.blitFramebuffer(...box, ...box, gl.COLOR_BUFFER_BIT, gl.NEAREST);
    renderer.state.bindFramebuffer(gl.READ_FRAMEBUFFER, null);
  }

  /** Where the camera sees the Earth, the Sun and the stars: numbers that say how far parts of the picture move. */
  #look(camera) {
    const view = camera.matrixWorldInverse;
    const earth = new Matrix4().multiplyMatrices(view, this.globe.group.matrix).elements.slice();
    const sun = this.globe.sunN.clone().transformDirection(view).toArray();
    return { earth, sky: [...view.elements.slice(0, 11), ...sun], lens: camera.projectionMatrix.elements.slice(0, 10).join() };
  }

  #isStale(old, now, camera) {
    if (!old || old.lens !== now.lens || old.box.join() !== now.box.join()) return true;
    const furthest = (name) => now[name].reduce((most, x, k) => Math.max(most, Math.abs(x - old[name][k])), 0);
    const focal = (camera.projectionMatrix.elements[5] * now.box[3]) / 2; // pixels
    const nearest = Math.max(camera.position.length() - 1, 1e-3); // radii from the camera to the ground
    return furthest("earth") * focal > MOST_SHIFT * nearest || furthest("sky") * focal > MOST_SHIFT;
  }
}
