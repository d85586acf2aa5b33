// Targets on the ground or in orbit, and ground stations. The graphics card derives states from times, so any time costs the same.

import { BufferGeometry, DynamicDrawUsage, Float32BufferAttribute, Group, Points, ShaderMaterial, Vector3 } from "three";
import { EVENT } from "viewer/flight";
import { Lines } from "viewer/lines";
import { GREEN, ORANGE, SKY, rgb } from "viewer/palette";
import { RADIUS, across } from "viewer/satellites";

const VERTEX = `
attribute float priority; attribute float cloud; attribute vec3 times; attribute float number;
uniform float now; uniform float ratio; uniform vec3 eye; uniform float ground; uniform float flash; uniform float selected; uniform float scale;
varying vec3 vTint; varying float vAlpha; varying float vState; varying float vSize;
void main() {
  vState = now >= times.z ? 3.0 : now >= times.x ? 1.0 : now >= times.y ? 2.0 : 0.0;  // delivered, rewarded, unrewarded, not yet
  vec3 waiting = mix(vec3(0.97, 0.90, 0.70), vec3(0.66, 0.72, 0.82), cloud);
  vTint = vState > 2.5 ? vec3(${rgb(SKY)}) : vState > 1.5 ? vec3(${rgb(ORANGE)}) : vState > 0.5 ? vec3(${rgb(GREEN)}) : waiting;
  vAlpha = vState > 0.5 ? 1.0 : (0.42 + 0.5 * priority) * (1.0 - 0.45 * cloud);
  float size = vState > 0.5 ? 7.0 : 2.4 + 4.2 * priority;
  float since = now - min(times.x, times.y);
  if (flash > 0.0 && since >= 0.0) size += 14.0 * exp(-since / flash);
  if (abs(number - selected) < 0.5) size = 15.0;
  vSize = size * ratio * scale + 2.0;
  gl_PointSize = vSize;
  gl_Position = projectionMatrix * (modelViewMatrix * vec4(position, 1.0));
  bool hidden = ground > 0.5 && dot(normalize(eye), normalize(position)) < 1.0 / length(eye);   // behind the horizon
  if (hidden) gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
}`;

const FRAGMENT = `
varying vec3 vTint; varying float vAlpha; varying float vState; varying float vSize;
void main() {
  vec2 p = (gl_PointCoord - 0.5) * vSize;
  float reach = vSize * 0.5 - 1.0;
  float r = vState > 2.5 ? (abs(p.x) + abs(p.y)) * 0.85 : length(p);                   // delivered: a diamond
  float inside = clamp(reach - r + 0.5, 0.0, 1.0);
  if (vState > 0.5 && vState < 1.5) inside *= max(clamp(r - reach * 0.62, 0.0, 1.0), clamp(reach * 0.36 - r + 0.5, 0.0, 1.0));
  if (vState > 1.5 && vState < 2.5) inside *= clamp(r - reach * 0.55, 0.0, 1.0);       // without a reward: a ring
  if (inside * vAlpha < 0.02) discard;
  gl_FragColor = vec4(vTint, vAlpha * inside);
}`;

const STATION = `
uniform vec3 eye; uniform float ratio;
void main() {
  gl_PointSize = 9.0 * ratio;
  gl_Position = projectionMatrix * (modelViewMatrix * vec4(position, 1.0));
  if (dot(normalize(eye), normalize(position)) < 1.0 / length(eye)) gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
}`;

const SQUARE = `
void main() {
  vec2 p = abs(gl_PointCoord - 0.5);
  float r = max(p.x, p.y);
  gl_FragColor = r > 0.32 ? vec4(0.03, 0.07, 0.12, 0.85) : vec4(vec3(${rgb(SKY)}), 1.0);
}`;

/** Targets of a track; `group` turns with the Earth where they are on the ground. */
export class Targets {
  constructor(track) {
    const { scene, recording } = track;
    Object.assign(this, { track, scene, inOrbit: recording.places === "orbit", group: new Group() });
    this.group.matrixAutoUpdate = false;
    this.at = new Float64Array(scene.count * 3);
    if (!this.inOrbit) this.at.set(scene.targets);
    this.uniforms = { now: { value: 0 }, ratio: { value: 1 }, eye: { value: new Vector3() }, flash: { value: 0 }, selected: { value: -1 } };
    this.uniforms.ground = { value: this.inOrbit ? 0 : 1 };
    this.uniforms.scale = { value: scene.count > 2500 ? 0.7 : 1 };
    this.points = this.#points();
    this.group.add(this.points);
  }

  /** Show states at t; `eye` is the camera in the axes of the targets. */
  update(t, eye, { ratio, flash, selected }) {
    const u = this.uniforms;
    [u.now.value, u.ratio.value, u.flash.value, u.selected.value] = [t, ratio, flash, selected];
    u.eye.value.copy(eye);
    if (!this.inOrbit) return;
    this.track.objectsAt(t, this.at);
    const { position } = this.points.geometry.attributes;
    for (let k = 0; k < this.at.length; k++) position.array[k] = this.at[k] / RADIUS;
    position.needsUpdate = true;
  }

  /** Position of target j in radii, in the axes of `group`. */
  place(j) {
    return new Vector3(...this.at.subarray(3 * j, 3 * j + 3)).divideScalar(RADIUS);
  }

  #points() {
    const { track, scene } = this;
    const [paid, unpaid, delivered] = [EVENT.PAID, EVENT.UNPAID, EVENT.DELIVERED].map((kind) => track.firstEvents(kind));
    const most = scene.priority.reduce((a, b) => Math.max(a, b), 0) || 1;
    const never = 1e9;
    const geometry = new BufferGeometry();
    const position = new Float32BufferAttribute(Float32Array.from(this.at, (x) => x / RADIUS), 3);
    if (this.inOrbit) position.setUsage(DynamicDrawUsage);
    geometry.setAttribute("position", position);
    geometry.setAttribute("priority", new Float32BufferAttribute(Float32Array.from(scene.priority, (x) => x / most), 1));
    geometry.setAttribute("cloud", new Float32BufferAttribute(scene.cloud ?? new Float32Array(scene.count), 1));
    geometry.setAttribute("number", new Float32BufferAttribute(Float32Array.from({ length: scene.count }, (_, k) => k), 1));
    const times = Array.from({ length: scene.count }, (_, k) => [paid[k], unpaid[k], delivered[k]].map((x) => Math.min(x, never))).flat();
    geometry.setAttribute("times", new Float32BufferAttribute(times, 3));
    const material = new ShaderMaterial({ vertexShader: VERTEX, fragmentShader: FRAGMENT, uniforms: this.uniforms, transparent: true });
    material.depthWrite = false;
    material.depthTest = this.inOrbit; // on the ground, the horizon decides
    const points = new Points(geometry, material);
    points.frustumCulled = false;
    return points;
  }
}

/** Ground stations, and the region in which satellites of a radius, in radii of the Earth, rise above their least elevation. */
export class Stations {
  constructor(scene, elevation, radius) {
    this.group = new Group();
    this.group.matrixAutoUpdate = false;
    this.count = scene.stations.length / 3;
    this.placesP = Array.from({ length: this.count }, (_, k) => new Vector3(...scene.stations.subarray(3 * k, 3 * k + 3)).divideScalar(RADIUS));
    this.places = this.placesP.map((place) => place.clone());
    this.uniforms = { eye: { value: new Vector3() }, ratio: { value: 1 } };
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new Float32BufferAttribute(this.placesP.flatMap((place) => place.toArray()), 3));
    const marks = new Points(geometry, new ShaderMaterial({ vertexShader: STATION, fragmentShader: SQUARE, uniforms: this.uniforms, transparent: true, depthTest: false }));
    marks.frustumCulled = false;
    this.cones = new Lines(this.count * 90 + 1, { width: 1.1 });
    for (const place of this.placesP) this.#cone(place, elevation, radius);
    this.cones.commit();
    this.group.add(this.cones.mesh, marks);
  }

  /** Follow the Earth: `matrix` is that of the globe. */
  update(matrix, eye, ratio) {
    this.placesP.forEach((place, k) => this.places[k].copy(place).applyMatrix4(matrix));
    this.uniforms.eye.value.copy(eye);
    this.uniforms.ratio.value = ratio;
  }

  #cone(place, elevation, radius) {
    const up = place.clone().normalize();
    const angle = Math.acos(Math.min(Math.cos(elevation) / radius, 1)) - elevation; // seen from the center of the Earth
    const [u, w] = across(up);
    const edge = (k, r) => {
      const turn = (2 * Math.PI * k) / 60;
      const aside = u.clone().multiplyScalar(Math.cos(turn)).addScaledVector(w, Math.sin(turn));
      return up.clone().multiplyScalar(r * Math.cos(angle)).addScaledVector(aside, r * Math.sin(angle)).toArray();
    };
    for (let k = 0; k < 60; k++) {
      this.cones.add(edge(k, radius), edge(k + 1, radius), [...rgb(SKY), 0.3]);
      if (k % 5 === 0) this.cones.add(place.toArray(), edge(k, radius), [...rgb(SKY), 0.13]);
    }
  }
}
