// A camera that turns about a center: drag, wheel, pinch and keys. Lengths are in radii of the Earth.

import { Matrix4, PerspectiveCamera, Vector3 } from "three";

const NEAREST = 0.02;
const FARTHEST = 40;
const LEGEND = 12; // CSS pixels by which the center is higher than the middle, so that the legend is free
const STEEPEST = 1.55; // rad of elevation, short of the pole

/** Angles and distance of the camera in axes that may move, such as the Hill frame of a satellite. */
export class OrbitCamera {
  constructor(element, onChange) {
    this.camera = new PerspectiveCamera(35, 1, 0.01, 100);
    this.azimuth = 0;
    this.elevation = 0.35;
    this.distance = 3.75;
    this.center = new Vector3();
    this.axes = new Matrix4();
    this.pointers = new Map();
    this.onChange = onChange;
    element.addEventListener("pointerdown", (event) => this.#down(element, event));
    element.addEventListener("pointermove", (event) => this.#move(element, event));
    for (const name of ["pointerup", "pointercancel"]) {
      element.addEventListener(name, (event) => this.pointers.delete(event.pointerId));
    }
    element.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
  }

  /** Turn by angles, rad. */
  turn(azimuth, elevation) {
    this.azimuth += azimuth;
    this.elevation = Math.min(Math.max(this.elevation + elevation, -STEEPEST), STEEPEST);
    this.onChange();
  }

  zoom(factor) {
    this.distance = Math.min(Math.max(this.distance * factor, NEAREST), FARTHEST);
    this.onChange();
  }

  /** Move the camera: `axes` are columns of a matrix, the third one is up, and `center` is looked at. */
  place(center, axes, width, height) {
    const [ca, sa] = [Math.cos(this.azimuth), Math.sin(this.azimuth)];
    const [ce, se] = [Math.cos(this.elevation), Math.sin(this.elevation)];
    const back = new Vector3(ca * ce, sa * ce, se).applyMatrix4(axes);
    const wider = Math.max(1, height / width) ** 0.92; // all of the globe fits into tall screens
    const distance = this.distance * wider;
    this.camera.up.set(0, 0, 1).applyMatrix4(axes);
    this.camera.position.copy(center).addScaledVector(back, distance);
    this.camera.lookAt(center);
    this.camera.aspect = width / height;
    const altitude = Math.max(this.camera.position.length() - 1, 1e-3);
    this.camera.near = Math.min(altitude, distance) * 0.1;
    this.camera.far = this.camera.position.length() + 12;
    this.camera.setViewOffset(width, height, 0, height > 300 ? LEGEND : 0, width, height);
    this.camera.updateProjectionMatrix();
    this.camera.updateMatrixWorld();
  }

  #down(element, event) {
    element.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
  }

  #move(element, event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const spread = this.#spread();
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (this.pointers.size === 2) return this.zoom(spread / this.#spread());
    const height = Math.max(this.camera.position.length() - 1, 0.05); // near the ground, turn less
    const scale = (Math.min(1, height) * 2.4) / element.clientHeight;
    this.turn((before[0] - event.clientX) * scale, (event.clientY - before[1]) * scale);
  }

  #spread() {
    const [a, b] = [...this.pointers.values()];
    return b ? Math.hypot(a[0] - b[0], a[1] - b[1]) || 1 : 1;
  }

  #wheel(event) {
    event.preventDefault();
    this.zoom(Math.exp(Math.min(Math.max(event.deltaY, -200), 200) * 0.0015));
  }
}
