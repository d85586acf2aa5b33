// Lines of a width in pixels with soft edges: one quadrilateral per piece, and one draw call for all. Software renderers draw
// quadrilaterals much faster than instances.

import { BufferAttribute, BufferGeometry, DynamicDrawUsage, Mesh, ShaderMaterial, Vector2, Vector3 } from "three";

const VERTEX = `
attribute vec2 corner; attribute vec3 end; attribute vec4 tint; attribute vec2 moment;
uniform vec2 size; uniform float width;
varying vec4 vTint; varying float vSide; varying float vMoment; varying vec3 vPlace;
void main() {
  vec4 a = projectionMatrix * (modelViewMatrix * vec4(position, 1.0));
  vec4 b = projectionMatrix * (modelViewMatrix * vec4(end, 1.0));
  float nearest = 1e-4;                                   // pieces that pass the camera are cut off in front of it
  if (a.w < nearest && b.w >= nearest) a = mix(b, a, (b.w - nearest) / (b.w - a.w));
  if (b.w < nearest && a.w >= nearest) b = mix(a, b, (a.w - nearest) / (a.w - b.w));
  vec2 along = (b.xy / b.w - a.xy / a.w) * size;
  along = length(along) > 1e-6 ? normalize(along) : vec2(1.0, 0.0);
  vec4 place = mix(a, b, corner.x);
  float reach = width * 0.5 + 1.0;
  place.xy += (vec2(-along.y, along.x) * corner.y * reach) / size * 2.0 * place.w;
  gl_Position = place;
  vTint = tint; vSide = corner.y * reach; vMoment = mix(moment.x, moment.y, corner.x); vPlace = mix(position, end, corner.x);
}`;

const FRAGMENT = `
uniform float width; uniform float opacity;
varying vec4 vTint; varying float vSide; varying float vMoment; varying vec3 vPlace;
#ifdef ORBIT
uniform float now; uniform float past; uniform float ahead; uniform vec3 sun;
#endif
void main() {
  float alpha = vTint.a * opacity * clamp(width * 0.5 + 0.5 - abs(vSide), 0.0, 1.0);
  vec3 color = vTint.rgb;
#ifdef ORBIT
  float age = now - vMoment;
  alpha *= age >= 0.0 ? 1.0 - smoothstep(0.35, 1.0, age / past) : 0.38 * (1.0 - smoothstep(0.2, 1.0, -age / ahead));
  float along = dot(vPlace, sun);
  bool dark = along < 0.0 && length(vPlace - along * sun) < 1.0;  // in the shadow of the Earth
  if (dark) { color = mix(color, vec3(0.25, 0.32, 0.55), 0.75); alpha *= 0.8; }
#endif
  if (alpha < 0.004) discard;
  gl_FragColor = vec4(color, alpha);
}`;

/** Up to `capacity` pieces; with `orbit`, they appear around the time `now`, and darker in the shadow of the Earth. */
export class Lines {
  constructor(capacity, { width = 1.5, opacity = 1, orbit = false } = {}) {
    const geometry = new BufferGeometry();
    const attribute = (name, items) => {
      const made = new BufferAttribute(new Float32Array(capacity * 4 * items), items);
      made.setUsage(DynamicDrawUsage);
      geometry.setAttribute(name, made);
      return made.array;
    };
    this.start = attribute("position", 3);
    for (const [name, items] of [["end", 3], ["tint", 4], ["moment", 2]]) this[name] = attribute(name, items);
    const corner = attribute("corner", 2);
    const index = new Uint32Array(capacity * 6);
    for (let k = 0; k < capacity; k++) {
      corner.set([0, -1, 0, 1, 1, -1, 1, 1], 8 * k);
      index.set([0, 2, 1, 1, 2, 3].map((vertex) => 4 * k + vertex), 6 * k);
    }
    geometry.setIndex(new BufferAttribute(index, 1));
    this.uniforms = { size: { value: new Vector2(1, 1) }, width: { value: width }, opacity: { value: opacity } };
    if (orbit) Object.assign(this.uniforms, { now: { value: 0 }, past: { value: 1 }, ahead: { value: 1 }, sun: { value: new Vector3() } });
    const material = new ShaderMaterial({
      vertexShader: VERTEX, fragmentShader: FRAGMENT, uniforms: this.uniforms, transparent: true, depthWrite: false,
      defines: orbit ? { ORBIT: 1 } : {},
    });
    this.mesh = new Mesh(geometry, material);
    this.mesh.frustumCulled = false;
    this.capacity = capacity;
    this.sent = ["position", "end", "tint", ...(orbit ? ["moment"] : [])];
    this.clear();
  }

  clear() {
    this.count = 0;
    this.mesh.geometry.setDrawRange(0, 0);
  }

  /** Add a piece from a to b, of the color [r, g, b, alpha]; with `moment`, the times of both ends. Full lines drop pieces. */
  add(a, b, color, moment) {
    if (this.count >= this.capacity) return;
    for (let k = 4 * this.count; k < 4 * this.count + 4; k++) {
      this.start.set(a, 3 * k);
      this.end.set(b, 3 * k);
      this.tint.set(color, 4 * k);
      if (moment) this.moment.set(moment, 2 * k);
    }
    this.count++;
  }

  /** Color of piece k. */
  paint(k, color) {
    for (let vertex = 4 * k; vertex < 4 * k + 4; vertex++) this.tint.set(color, 4 * vertex);
  }

  /** Draw the pieces from `first` to `last` only. */
  limit(first, last) {
    this.mesh.geometry.setDrawRange(6 * first, 6 * Math.max(last - first, 0));
  }

  /** Send what was added to the graphics card. */
  commit() {
    this.limit(0, this.count);
    for (const name of this.count ? this.sent : []) {
      const attribute = this.mesh.geometry.attributes[name];
      attribute.clearUpdateRanges();
      attribute.addUpdateRange(0, 4 * this.count * attribute.itemSize);
      attribute.needsUpdate = true;
    }
  }
}
