// One track over the globe: orbits, symbols, instruments with their footprints, links, passes and body axes.

import { BufferGeometry, DoubleSide, Float32BufferAttribute, Group, Mesh, MeshBasicMaterial, Vector3 } from "three";
import { activityColor } from "viewer/flight";
import { countUntil, hermite } from "viewer/interpolate";
import { Lines } from "viewer/lines";
import { Crafts } from "viewer/craft";
import { GREEN, ORANGE, SKY, VERMILION, rgb } from "viewer/palette";

export const RADIUS = 6378136.6; // m, one unit of length of the scene
const PARTS = 2; // pieces of an orbit between two keyframes
const RAYS = 28; // around the cone of an instrument
const REACH = 0.35; // radii: length of a line of sight that misses the Earth
const SYMBOL = 0.0105; // size of a symbol at the distance 1 from the camera
const AXES = [[VERMILION, "x"], [GREEN, "y"], [SKY, "z"]];

export class TrackLayer {
  constructor(track, period) {
    Object.assign(this, { track, group: new Group(), places: [], period, owner: [], ends: [] }); // of every piece: satellite, time
    this.orbits = this.#orbits();
    this.rays = new Lines(track.count * (RAYS + 2), { width: 1.6 });
    this.threads = new Lines(1024, { width: 1.8 });
    this.axes = new Lines(8, { width: 2.2 });
    this.cones = this.#coneMesh();
    this.group.add(this.orbits.mesh, this.rays.mesh, this.threads.mesh, this.axes.mesh, this.cones);
    this.crafts = new Crafts(track.recording.satellites, this.group);
    for (let s = 0; s < track.count; s++) this.places.push(new Vector3());
  }

  /** Show the track at t; `ghost` is a color, as which it appears faintly next to another one. */
  update(t, camera, { selected, show, follow = false, ghost = null, stations = [] }) {
    const { track } = this;
    track.moveTo(t);
    const orbits = this.orbits.uniforms;
    const [past, ahead] = [orbits.past.value, orbits.ahead.value];
    this.orbits.limit(countUntil(this.ends, t - past), countUntil(this.ends, t + ahead) + track.count);
    orbits.now.value = t;
    orbits.sun.value.set(...track.sun);
    orbits.opacity.value = ghost ? 0.7 : 1;
    this.orbits.mesh.visible = show.orbits;
    this.crafts.uniforms.sun.value.set(...track.sun);
    this.crafts.uniforms.ghostly.value = ghost ? 0.8 : 0;
    if (ghost) this.crafts.uniforms.ghost.value.set(...rgb(ghost));
    this.#tintOrbits(ghost, selected);
    for (const lines of [this.rays, this.threads, this.axes]) lines.clear();
    this.coneCount = 0;
    for (let s = 0; s < track.count; s++) {
      const place = this.places[s].set(...track.position.subarray(3 * s, 3 * s + 3)).divideScalar(RADIUS);
      const there = track.isPresent(s) && t <= track.duration + 1e-6;
      const size = SYMBOL * camera.position.distanceTo(place) * (s === selected && !ghost ? (follow ? 3 : 1.35) : 1);
      this.crafts.set(s, there ? place : new Vector3(), track.rotation[s], there ? (ghost ? 0.8 * size : size) : 0);
      if (!there || ghost) continue;
      if (show.instruments && track.isAlive(s, t)) this.#look(s, t);
      if (show.links) this.#downlink(s, t, stations);
      if (s === selected && show.axes) this.#bodyAxes(s, (follow ? 1.7 : 3.2) * size);
    }
    if (show.links && !ghost) for (const [a, b] of track.linksAt(t)) this.#thread(this.places[a], this.places[b], [...rgb(ORANGE), 0.85]);
    for (const lines of [this.rays, this.threads, this.axes]) lines.commit();
    this.cones.geometry.setDrawRange(0, this.coneCount);
    for (const name of this.coneCount ? ["position", "color"] : []) {
      const attribute = this.cones.geometry.attributes[name];
      attribute.clearUpdateRanges();
      attribute.addUpdateRange(0, this.coneCount * 3);
      attribute.needsUpdate = true;
    }
  }

  #orbits() {
    const { track } = this;
    const { keys, r, v, count } = track;
    const lines = new Lines(Math.max((keys.length - 1) * PARTS * count, 1), { width: 1.7, orbit: true });
    const [place, speed] = [new Float64Array(3 * count), new Float64Array(3 * count)];
    let before = null;
    for (let k = 0; k + 1 < keys.length; k++) {
      const h = (keys[k + 1] - keys[k]) / PARTS;
      if (h <= 0) continue;
      for (let part = before ? 1 : 0; part <= PARTS; part++) {
        const t = keys[k] + part * h;
        hermite(keys, r, v, count, t, place, speed);
        const now = { t, at: Float64Array.from(place, (x) => x / RADIUS) };
        for (let s = 0; before && s < count; s++) this.#orbitPiece(lines, before, now, s);
        before = now;
      }
    }
    lines.commit();
    lines.uniforms.past.value = this.period * 0.62;
    lines.uniforms.ahead.value = this.period * 0.5;
    return lines;
  }

  #orbitPiece(lines, a, b, s) {
    if (!Number.isFinite(a.at[3 * s]) || !Number.isFinite(b.at[3 * s])) return;
    this.owner.push(s);
    this.ends.push(b.t);
    lines.add(a.at.subarray(3 * s, 3 * s + 3), b.at.subarray(3 * s, 3 * s + 3), [0.6, 0.7, 0.82, 0.5], [a.t, b.t]);
  }

  /** Recolor orbits only where something has changed: they are many. */
  #tintOrbits(ghost, selected) {
    const key = `${ghost} ${selected}`;
    if (this.tinted === key) return;
    this.tinted = key;
    const plain = ghost ? [...rgb(ghost), 0.75] : [0.62, 0.72, 0.85, this.track.count > 4 ? 0.42 : 0.6];
    const chosen = ghost ? plain : [0.96, 0.86, 0.62, 0.95];
    this.owner.forEach((s, k) => this.orbits.paint(k, s === selected ? chosen : plain));
    this.orbits.mesh.geometry.attributes.tint.needsUpdate = true;
  }

  #coneMesh() {
    const size = this.track.count * RAYS * 3;
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new Float32BufferAttribute(new Float32Array(size * 3), 3));
    geometry.setAttribute("color", new Float32BufferAttribute(new Float32Array(size * 3), 3));
    const material = new MeshBasicMaterial({ vertexColors: true, transparent: true, opacity: 0.16, depthWrite: false, side: DoubleSide });
    const mesh = new Mesh(geometry, material);
    mesh.frustumCulled = false;
    return mesh;
  }

  /** The cone of an instrument to where it meets the ground, and the footprint. */
  #look(s, t) {
    const { instrument } = this.track.recording.satellites[s];
    if (!instrument) return;
    const color = rgb(activityColor(this.track, s, t));
    const place = this.places[s];
    const axis = new Vector3(...instrument.axis_B).normalize().applyQuaternion(this.track.rotation[s]);
    const center = meet(place, axis);
    this.rays.add(place.toArray(), (center ?? place.clone().addScaledVector(axis, REACH)).toArray(), [...color, 0.55]);
    if (!instrument.half_angle) return;
    const [u, w] = across(axis);
    const ring = [];
    let whole = true;
    for (let k = 0; k < RAYS; k++) {
      const angle = (2 * Math.PI * k) / RAYS;
      const tilt = Math.tan(instrument.half_angle);
      const ray = axis.clone().addScaledVector(u, tilt * Math.cos(angle)).addScaledVector(w, tilt * Math.sin(angle)).normalize();
      const ground = meet(place, ray);
      whole &&= ground !== null;
      ring.push((ground ?? place.clone().addScaledVector(ray, REACH)).toArray());
    }
    for (let k = 0; k < RAYS; k++) {
      const next = ring[(k + 1) % RAYS];
      if (whole) this.rays.add(ring[k], next, [...color, 0.95]);
      this.#face(place.toArray(), ring[k], next, color);
    }
  }

  #face(a, b, c, color) {
    const { position, color: tint } = this.cones.geometry.attributes;
    for (const corner of [a, b, c]) {
      position.array.set(corner, 3 * this.coneCount);
      tint.array.set(color, 3 * this.coneCount++);
    }
  }

  /** A line to the nearest station while a pass lasts. */
  #downlink(s, t, stations) {
    if (!this.track.passes[s].some(([start, end]) => start <= t && t < end)) return;
    let nearest = null;
    for (const station of stations) {
      if (!nearest || station.distanceToSquared(this.places[s]) < nearest.distanceToSquared(this.places[s])) nearest = station;
    }
    if (nearest) this.#thread(this.places[s], nearest, [...rgb(SKY), 0.75]);
  }

  #thread(a, b, color) {
    this.threads.add(a.toArray(), b.toArray(), color);
  }

  #bodyAxes(s, length) {
    this.axisTips = AXES.map(([color, name], k) => {
      const axis = new Vector3(k === 0, k === 1, k === 2).applyQuaternion(this.track.rotation[s]);
      const tip = this.places[s].clone().addScaledVector(axis, length);
      this.axes.add(this.places[s].toArray(), tip.toArray(), [...rgb(color), 1]);
      return { tip, name, color };
    });
  }
}

/** Where a ray from a place outside of the unit sphere meets it, slightly above, or null. */
export function meet(place, ray) {
  const along = place.dot(ray);
  const square = along * along - place.lengthSq() + 1;
  if (along >= 0 || square < 0) return null;
  return place.clone().addScaledVector(ray, -along - Math.sqrt(square)).multiplyScalar(1.0015);
}

/** Two unit vectors that complete a unit vector to a triad. */
export function across(axis) {
  const helper = Math.abs(axis.z) < 0.9 ? new Vector3(0, 0, 1) : new Vector3(1, 0, 0);
  const u = helper.cross(axis).normalize();
  return [u, axis.clone().cross(u)];
}
