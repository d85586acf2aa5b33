// Symbols of satellites: a body, solar panels across their normal, and an instrument along its axis, in body axes.

import { BufferGeometry, DynamicDrawUsage, Float32BufferAttribute, InstancedMesh, Matrix4, ShaderMaterial, Vector3 } from "three";

const BODY = [0.86, 0.87, 0.9];
const PANEL = [0.16, 0.3, 0.62];
const EYE = [0.95, 0.72, 0.25];

const VERTEX = `
attribute vec3 paint; varying vec3 vPaint; varying vec3 vUp;
void main() {
  vPaint = paint; vUp = normalize(mat3(instanceMatrix) * normal);
  gl_Position = projectionMatrix * (viewMatrix * (instanceMatrix * vec4(position, 1.0)));
}`;

const FRAGMENT = `
uniform vec3 sun; uniform vec3 ghost; uniform float ghostly; varying vec3 vPaint; varying vec3 vUp;
void main() {
  float light = 0.5 + 0.5 * max(dot(normalize(vUp), sun), 0.0) + 0.12 * abs(vUp.z);
  gl_FragColor = vec4(mix(vPaint * light, ghost, ghostly), mix(1.0, 0.75, ghostly));
}`;

/** Corners of a box, by its center and its half edges along three unit vectors. */
function box(out, center, edges, half, paint) {
  for (let axis = 0; axis < 3; axis++) {
    for (const sign of [-1, 1]) {
      const [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
      const corner = (a, b) =>
        center.clone().addScaledVector(edges[axis], sign * half[axis]).addScaledVector(edges[u], a * half[u]).addScaledVector(edges[v], b * half[v]);
      const face = [corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, -1), corner(1, 1), corner(-1, 1)];
      if (sign < 0) face.reverse();
      for (const place of face) {
        out.position.push(...place.toArray());
        out.normal.push(...edges[axis].clone().multiplyScalar(sign).toArray());
        out.paint.push(...paint);
      }
    }
  }
}

/** Unit vectors of which the first is given. */
function triad(direction) {
  const first = new Vector3(...direction).normalize();
  const helper = Math.abs(first.z) < 0.9 ? new Vector3(0, 0, 1) : new Vector3(1, 0, 0);
  const second = helper.clone().cross(first).normalize();
  return [first, second, first.clone().cross(second)];
}

function symbol({ panel_normal_B: normal, instrument }) {
  const out = { position: [], normal: [], paint: [] };
  const edges = triad(normal ?? [0, 0, 1]);
  box(out, new Vector3(), edges, [0.42, 0.42, 0.42], BODY);
  if (normal) {
    for (const side of [-1, 1]) box(out, edges[1].clone().multiplyScalar(side * 1.35), edges, [0.04, 0.8, 0.38], PANEL);
  }
  if (instrument) {
    const axes = triad(instrument.axis_B);
    box(out, axes[0].clone().multiplyScalar(0.6), axes, [0.22, 0.2, 0.2], EYE);
  }
  const geometry = new BufferGeometry();
  for (const [name, values] of Object.entries(out)) geometry.setAttribute(name, new Float32BufferAttribute(values, 3));
  return geometry;
}

/** Instanced symbols: satellites with the same description share one draw call. */
export class Crafts {
  constructor(satellites, group) {
    this.uniforms = { sun: { value: new Vector3(1, 0, 0) }, ghost: { value: new Vector3(1, 1, 1) }, ghostly: { value: 0 } };
    const material = new ShaderMaterial({ vertexShader: VERTEX, fragmentShader: FRAGMENT, uniforms: this.uniforms, transparent: true });
    const kinds = new Map();
    this.place = satellites.map((craft) => {
      const key = JSON.stringify([craft.panel_normal_B, craft.instrument?.axis_B]);
      if (!kinds.has(key)) kinds.set(key, { craft, count: 0 });
      return { key, slot: kinds.get(key).count++ };
    });
    this.meshes = new Map();
    for (const [key, { craft, count }] of kinds) {
      const mesh = new InstancedMesh(symbol(craft), material, count);
      mesh.instanceMatrix.setUsage(DynamicDrawUsage);
      mesh.frustumCulled = false;
      this.meshes.set(key, mesh);
      group.add(mesh);
    }
    this.matrix = new Matrix4();
  }

  /** Draw satellite k at a place with a rotation and a scale; a scale of 0 hides it. */
  set(k, place, rotation, scale) {
    const { key, slot } = this.place[k];
    const mesh = this.meshes.get(key);
    mesh.setMatrixAt(slot, this.matrix.compose(place, rotation, new Vector3(scale, scale, scale)));
    mesh.instanceMatrix.needsUpdate = true;
  }
}
