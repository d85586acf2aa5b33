// The Earth: land from coastlines, day and night, a graticule, the rim of the atmosphere, stars and the Sun.

import {
  AdditiveBlending, BufferGeometry, CanvasTexture, Float32BufferAttribute, Group, LinearMipmapNearestFilter, LineSegments, Mesh, Points,
  ShaderMaterial, Vector3, Vector4,
} from "three";
import { rgb } from "viewer/palette";
import { across } from "viewer/satellites";

const TEXTURE = [4096, 2048];
const TURNS = 96; // pieces of a parallel; the sphere lies at most 0.0011 radii below the true one
const ABOVE = 1.0012; // radii: lines lie over the sphere's flat pieces

const GRID = "#9fb6c9";

const HALO_RADIUS = 1.12; // radii: where the rim of the atmosphere is no longer seen
const BEYOND = 0.05; // rad beyond the horizon from which on the Earth hides lines on the ground: those are not drawn

// Behind the far plane, lines are dropped before they are rasterized, which takes software most of the time of a line
const LINE = {
  vertex: `
uniform vec4 horizon;
void main() {
  gl_Position = projectionMatrix * (modelViewMatrix * vec4(position, 1.0));
  if (dot(position, horizon.xyz) < horizon.w) gl_Position.z = 2.0 * gl_Position.w;
}`,
  fragment: "uniform vec3 tint; uniform float opacity; void main() { gl_FragColor = vec4(tint, opacity); }",
};

const SURFACE = {
  vertex: `
uniform vec3 eye; varying vec2 vUv; varying vec3 vUp; varying vec3 vToEye;
void main() {
  vUv = uv; vUp = position;
  vToEye = eye - position;
  gl_Position = projectionMatrix * (modelViewMatrix * vec4(position, 1.0));
}`,
  fragment: `
uniform sampler2D land; uniform vec3 sun;
varying vec2 vUv; varying vec3 vUp; varying vec3 vToEye;
void main() {
  float ground = texture2D(land, vUv).r;
  float height = dot(vUp, sun);
  float lit = smoothstep(-0.13, 0.16, height);            // civil twilight ends where the Sun is 6 degrees below the horizon
  vec3 day = mix(vec3(0.105, 0.225, 0.36), vec3(0.36, 0.43, 0.40), ground) * (0.72 + 0.42 * max(height, 0.0));
  vec3 night = mix(vec3(0.022, 0.040, 0.085), vec3(0.062, 0.084, 0.132), ground);
  vec3 color = mix(night, day, lit);
  color += vec3(0.085, 0.038, 0.010) * exp(-(height - 0.01) * (height - 0.01) * 178.0);
  float rim = 1.0 - max(dot(vUp, normalize(vToEye)), 0.0);
  rim *= rim * rim;
  color += vec3(0.22, 0.42, 0.72) * rim * (0.16 + 0.75 * lit);
  gl_FragColor = vec4(color, 1.0);
}`,
};

// On a ring around the horizon: position.z is 0 at its inner edge and 1 at its outer edge
const HALO = {
  vertex: `
uniform float reach; varying vec3 vPlace; varying vec3 vEye;
void main() {
  vPlace = (modelMatrix * vec4(position.xy * mix(0.98, reach, position.z), 0.0, 1.0)).xyz; vEye = cameraPosition;
  gl_Position = projectionMatrix * (viewMatrix * vec4(vPlace, 1.0));
}`,
  fragment: `
uniform vec3 sun; varying vec3 vPlace; varying vec3 vEye;
void main() {
  vec3 ray = normalize(vPlace - vEye);
  vec3 closest = vEye - ray * dot(vEye, ray);             // of the line of sight to the center of the Earth
  float height = length(closest) - 1.0;
  float glow = exp(-max(height, 0.0) / 0.022) * smoothstep(0.11, 0.0, height);
  float lit = smoothstep(-0.35, 0.45, dot(normalize(closest), sun));
  gl_FragColor = vec4(vec3(0.30, 0.55, 0.95), glow * (0.06 + 0.62 * lit));
}`,
};

const STAR = {
  vertex: `
attribute float bright; uniform float ratio; varying float vBright;
void main() { vBright = bright; gl_PointSize = (1.1 + 1.7 * bright) * ratio; gl_Position = projectionMatrix * (modelViewMatrix * vec4(position, 1.0)); }`,
  fragment: `
varying float vBright;
void main() { float r = length(gl_PointCoord - 0.5); gl_FragColor = vec4(0.78, 0.84, 1.0, vBright * 0.75 * smoothstep(0.5, 0.1, r)); }`,
};

const SUN = {
  vertex: `
uniform vec3 sun; uniform float ratio; uniform float far;
void main() {
  gl_PointSize = 150.0 * ratio;
  vec4 place = projectionMatrix * (viewMatrix * vec4(cameraPosition + sun * far * 0.9, 1.0));
  gl_Position = place;
}`,
  fragment: `
void main() {
  float r = length(gl_PointCoord - 0.5) * 2.0;
  float glow = smoothstep(0.11, 0.075, r) + 0.5 * exp(-r * 9.0) * (1.0 - r) + 0.06 * smoothstep(1.0, 0.0, r);
  gl_FragColor = vec4(1.0, 0.94, 0.80, clamp(glow, 0.0, 1.0));
}`,
};

/** The Earth of radius 1 in its own axes (`group` turns), and what stands around it. */
export class Globe {
  constructor(land) {
    this.sunP = new Vector3();
    this.sunN = new Vector3();
    this.eyeP = new Vector3();
    this.group = new Group();
    this.group.matrixAutoUpdate = false;
    this.sky = new Group();
    const whole = sphere(1, TURNS);
    this.surface = new Mesh(whole, shader(SURFACE, { land: { value: landTexture(land) }, sun: { value: this.sunP }, eye: { value: this.eyeP } }));
    this.horizon = new Vector4(); // lines on the ground are in front of this plane
    this.group.add(this.surface, coastlines(land, this.horizon), graticule(this.horizon));
    const uniforms = { sun: { value: this.sunN }, reach: { value: 1 } };
    this.halo = onHorizon(new Mesh(ring(), shader(HALO, uniforms, { transparent: true, depthWrite: false, blending: AdditiveBlending })));
    this.sky.add(stars(), this.#sunDisc(), this.halo);
  }

  /** Turn the Earth to the direction cosines PN, row-major, and light it from the unit vector `sun` in N. */
  moveTo(PN, sun) {
    const [a, b, c, d, e, f, g, h, i] = PN;
    this.group.matrix.set(a, d, g, 0, b, e, h, 0, c, f, i, 0, 0, 0, 0, 1); // from P to N: the transpose
    this.group.matrixWorldNeedsUpdate = true;
    this.sunN.set(...sun);
    this.sunP.set(a * sun[0] + b * sun[1] + c * sun[2], d * sun[0] + e * sun[1] + f * sun[2], g * sun[0] + h * sun[1] + i * sun[2]);
  }

  /** See from a camera, with so many pixels per CSS pixel. */
  setView(camera, ratio) {
    this.eyeP.copy(camera.position).applyMatrix4(this.group.matrix.clone().transpose());
    for (const part of this.sky.children) {
      if (part.material.uniforms.ratio) part.material.uniforms.ratio.value = ratio;
      if (part.material.uniforms.far) part.material.uniforms.far.value = camera.far;
    }
    const edge = Math.acos(Math.min(1 / this.eyeP.length(), 1)) + BEYOND;
    this.horizon.set(...this.eyeP.clone().normalize().toArray(), ABOVE * Math.cos(edge));
    placeOnHorizon(this.halo, camera.position);
    const square = camera.position.lengthSq();
    this.halo.material.uniforms.reach.value = HALO_RADIUS * Math.sqrt((square - 1) / Math.max(square - HALO_RADIUS ** 2, 1e-3));
    this.sky.children[0].position.copy(camera.position);
    this.sky.children[0].scale.setScalar(camera.far * 0.95);
  }

  #sunDisc() {
    const geometry = new BufferGeometry().setAttribute("position", new Float32BufferAttribute([0, 0, 0], 3));
    const uniforms = { sun: { value: this.sunN }, ratio: { value: 1 }, far: { value: 10 } };
    const disc = new Points(geometry, shader(SUN, uniforms, { transparent: true, depthWrite: false }));
    disc.frustumCulled = false;
    return disc;
  }
}

function shader({ vertex, fragment }, uniforms, options = {}) {
  return new ShaderMaterial({ vertexShader: vertex, fragmentShader: fragment, uniforms, ...options });
}

/** Unit vector of a longitude and latitude in degrees, times a radius. */
export function onGround(longitude, latitude, radius = 1) {
  const [l, b] = [(longitude * Math.PI) / 180, (latitude * Math.PI) / 180];
  return [radius * Math.cos(b) * Math.cos(l), radius * Math.cos(b) * Math.sin(l), radius * Math.sin(b)];
}

function sphere(radius, turns) {
  const [places, uvs, index] = [[], [], []];
  const rows = turns / 2;
  for (let i = 0; i <= rows; i++) {
    for (let j = 0; j <= turns; j++) {
      places.push(...onGround((360 * j) / turns - 180, 90 - (180 * i) / rows, radius));
      uvs.push(j / turns, 1 - i / rows);
    }
  }
  for (let i = 0; i < rows; i++) {
    for (let j = 0; j < turns; j++) {
      const k = i * (turns + 1) + j;
      index.push(k, k + turns + 1, k + 1, k + 1, k + turns + 1, k + turns + 2);
    }
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new Float32BufferAttribute(places, 3));
  geometry.setAttribute("uv", new Float32BufferAttribute(uvs, 2));
  geometry.setIndex(index);
  return geometry;
}

/** White land on black sea, plate carree. */
function landTexture(land) {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = TEXTURE;
  const pen = canvas.getContext("2d");
  pen.fillRect(0, 0, canvas.width, canvas.height);
  pen.fillStyle = "#fff";
  pen.fill(landPath(land, canvas.width, canvas.height), "evenodd");
  const texture = new CanvasTexture(canvas);
  texture.minFilter = LinearMipmapNearestFilter; // software takes half the time of blending two levels
  return texture;
}

/** Outlines of all land as a path of a plate carree map of a size in pixels. */
export function landPath(land, width, height) {
  const path = new Path2D();
  for (const ring of land.coordinates.flat()) {
    ring.forEach(([x, y], k) => path[k ? "lineTo" : "moveTo"](((x + 180) / 360) * width, ((90 - y) / 180) * height));
    path.closePath();
  }
  return path;
}

/** The horizon, as a disc of radius 1 with its center in the origin: it hides what the whole Earth hides, with few triangles. */
export function disc(material) {
  const places = Array.from({ length: TURNS }, (_, k) => [...circle(k), 0]).flat();
  const geometry = new BufferGeometry().setAttribute("position", new Float32BufferAttribute(places, 3));
  geometry.setIndex(Array.from({ length: TURNS - 2 }, (_, k) => [0, k + 1, k + 2]).flat());
  return onHorizon(new Mesh(geometry, material));
}

function ring() {
  const places = Array.from({ length: TURNS + 1 }, (_, k) => [...circle(k), 0, ...circle(k), 1]).flat();
  const geometry = new BufferGeometry().setAttribute("position", new Float32BufferAttribute(places, 3));
  geometry.setIndex(Array.from({ length: TURNS }, (_, k) => [0, 1, 2, 2, 1, 3].map((corner) => 2 * k + corner)).flat());
  return geometry;
}

function circle(k) {
  return [Math.cos((2 * Math.PI * k) / TURNS), Math.sin((2 * Math.PI * k) / TURNS)];
}

function onHorizon(mesh) {
  mesh.matrixAutoUpdate = false;
  mesh.frustumCulled = false;
  return mesh;
}

/** Place a disc or a ring on the circle in which lines of sight from `eye`, in radii, touch the Earth. */
export function placeOnHorizon(mesh, eye) {
  const distance = Math.max(eye.length(), 1.0001);
  const up = eye.clone().normalize();
  const radius = Math.sqrt(1 - 1 / distance ** 2);
  const [u, w] = across(up).map((axis) => axis.multiplyScalar(radius));
  mesh.matrix.makeBasis(u, w, up.clone()).setPosition(up.divideScalar(distance));
  mesh.matrixWorldNeedsUpdate = true;
}

/** Lines along rows of places, as one draw call in which neighbors share vertices. */
function lines(rows, opacity, horizon) {
  const [places, index] = [[], []];
  for (const row of rows) {
    row.forEach(([x, y, drawn = true], k) => {
      if (k && drawn) index.push(places.length / 3 - 1, places.length / 3);
      places.push(...onGround(x, y, ABOVE));
    });
  }
  const geometry = new BufferGeometry().setAttribute("position", new Float32BufferAttribute(places, 3)).setIndex(index);
  const uniforms = { tint: { value: new Vector3(...rgb(GRID)) }, opacity: { value: opacity }, horizon: { value: horizon } };
  return new LineSegments(geometry, shader(LINE, uniforms, { transparent: true, depthWrite: false }));
}

function coastlines(land, horizon) {
  const rows = land.coordinates.flat().map((ring) =>
    ring.map(([x, y], k) => {
      const before = ring[Math.max(k - 1, 0)][0];
      const edge = Math.abs(x) > 179.9 && Math.abs(before) > 179.9; // of the map, not a coast
      return [x, y, !edge && y > -89.9];
    }));
  return lines(rows, 0.42, horizon);
}

function graticule(horizon) {
  const rows = [];
  const range = (from, to) => Array.from({ length: (to - from) / 3 + 1 }, (_, k) => from + 3 * k);
  for (let line = -180; line < 180; line += 15) {
    const end = line % 90 ? 75 : 90;
    rows.push(range(-end, end).map((y) => [line, y]));
    if (Math.abs(line) < 90) rows.push(range(-180, 180).map((x) => [x, line]));
  }
  return lines(rows, 0.11, horizon);
}

/** Faint points; their places come from a fixed sequence, so that pictures are the same each time. */
function stars(count = 1400) {
  const [places, bright] = [[], []];
  for (let k = 0; k < count; k++) {
    const z = 1 - (2 * (k + 0.5)) / count;
    const angle = k * 2.399963 + Math.sin(k * 12.9898) * 40;
    const flat = Math.sqrt(1 - z * z);
    places.push(flat * Math.cos(angle), flat * Math.sin(angle), z);
    bright.push(0.22 + 0.78 * Math.abs(Math.sin(k * 78.233)) ** 6);
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new Float32BufferAttribute(places, 3));
  geometry.setAttribute("bright", new Float32BufferAttribute(bright, 1));
  const points = new Points(geometry, shader(STAR, { ratio: { value: 1 } }, { transparent: true, depthWrite: false }));
  points.frustumCulled = false;
  return points;
}
