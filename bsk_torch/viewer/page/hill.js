// The Hill view: places relative to one satellite, radial up, along-track to the right, orbit normal toward the viewer at first.

import { Quaternion, Vector3 } from "three";
import { EVENT, activityColor, hillAxes } from "viewer/flight";
import { hermite, sized } from "viewer/interpolate";
import { Labels, shorten } from "viewer/labels";
import { GREEN, ORANGE, SKY, TRACKS, VERMILION } from "viewer/palette";

const SAMPLES = 240; // points of a path
const SEEN = 38; // CSS pixels: smaller spacecraft are drawn with at least this radius, and their enlargement is written

export class HillView {
  constructor(canvas) {
    Object.assign(this, { canvas, pen: canvas.getContext("2d"), azimuth: 0.5, elevation: 0.35, zoom: 1, paths: new Map() });
  }

  turn(azimuth, elevation) {
    this.azimuth += azimuth;
    this.elevation = Math.min(Math.max(this.elevation + elevation, -1.55), 1.55);
  }

  /** The satellite that the others are seen from: the one that bears points, otherwise the selected one. */
  origin(state) {
    return state.track.scene.pointsOf ?? state.satellite;
  }

  draw(state) {
    const { pen, canvas } = this;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.fillStyle = "#070b14";
    pen.fillRect(0, 0, width, height);
    const t = Math.min(state.time, state.track.duration);
    const origin = this.origin(state);
    this.middle = [width / 2, height / 2 + 10];
    const extent = this.#extent(state.track, origin);
    this.scale = (0.42 * Math.min(width, height) * this.zoom) / extent;
    this.#rings(extent, width);
    const tracks = [...state.ghosts.map((track, k) => [track, TRACKS[(k + 1) % TRACKS.length]]), [state.track, null]];
    for (const [track, ghost] of tracks) this.#flights(state, track, origin, Math.min(t, track.duration), ghost);
    state.track.moveTo(t);
    if (state.recording.places === "points" && state.show.targets) this.#points(state, t, origin);
    this.#bodies(state, t, origin);
  }

  /** Place on the screen, CSS pixels, and depth of (radial, along-track, normal), m. */
  project([radial, along, normal]) {
    const [ca, sa] = [Math.cos(this.azimuth), Math.sin(this.azimuth)];
    const [ce, se] = [Math.cos(this.elevation), Math.sin(this.elevation)];
    const x = ca * along - sa * normal;
    const depth = sa * along + ca * normal;
    const y = ce * radial - se * depth;
    return [this.middle[0] + this.scale * x, this.middle[1] - this.scale * y, se * radial + ce * depth];
  }

  /** Components in the Hill frame of satellite `origin` of the places of all satellites at t, m, [S, 3]. */
  relative(track, origin, t, out = new Float64Array(3 * track.count)) {
    this.r = sized(this.r, 3 * track.count);
    this.v = sized(this.v, 3 * track.count);
    hermite(track.keys, track.r, track.v, track.count, t, this.r, this.v);
    const axes = track.scene.hasEarth ? hillAxes(this.r, this.v, origin) : [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
    for (let s = 0; s < track.count; s++) {
      const d = [0, 1, 2].map((j) => this.r[3 * s + j] - this.r[3 * origin + j]);
      axes.forEach((axis, j) => (out[3 * s + j] = axis[0] * d[0] + axis[1] * d[1] + axis[2] * d[2]));
    }
    return out;
  }

  #path(track, origin) {
    const key = `${track.index} ${origin}`;
    if (!this.paths.has(key)) {
      const samples = Math.max(SAMPLES, Math.min(4 * track.keys.length, 2000));
      const times = Float64Array.from({ length: samples }, (_, k) => (k * track.duration) / (samples - 1));
      this.paths.set(key, { times, places: Array.from(times, (t) => this.relative(track, origin, t)) });
    }
    return this.paths.get(key);
  }

  #extent(track, origin) {
    const distances = this.#path(track, origin).places.flatMap((place) => {
      return Array.from({ length: track.count }, (_, s) => Math.hypot(...place.subarray(3 * s, 3 * s + 3))).filter(Number.isFinite);
    });
    return Math.max(1, distances.reduce((a, b) => Math.max(a, b), 0));
  }

  #rings(extent, width) {
    const { pen } = this;
    const step = niceStep(extent / this.zoom / 2);
    pen.font = "11px system-ui, sans-serif";
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    for (let ring = 1; ring * step < (1.6 * extent) / this.zoom && ring < 8; ring++) {
      pen.strokeStyle = "rgba(160, 182, 210, 0.16)";
      pen.beginPath();
      for (let k = 0; k <= 90; k++) {
        const angle = (k / 90) * 2 * Math.PI;
        const [x, y] = this.project([ring * step * Math.sin(angle), ring * step * Math.cos(angle), 0]);
        pen[k ? "lineTo" : "moveTo"](x, y);
      }
      pen.stroke();
      const [x, y] = this.project([0, -ring * step, 0]);
      pen.fillStyle = "#8d9cb3";
      if (x > 40 && x < width - 40) pen.fillText(distance(ring * step), x, y - 7);
    }
    const reach = (1.12 * extent) / this.zoom;
    for (const [axis, color, name] of [[[reach, 0, 0], VERMILION, "radial"], [[0, reach, 0], GREEN, "along-track"], [[0, 0, reach], SKY, "orbit normal"]]) {
      const [x, y] = this.project(axis);
      pen.strokeStyle = pen.fillStyle = color;
      pen.globalAlpha = 0.7;
      pen.beginPath();
      pen.moveTo(...this.middle);
      pen.lineTo(x, y);
      pen.stroke();
      pen.globalAlpha = 1;
      pen.fillText(name, x, y - 8);
    }
  }

  #flights(state, track, origin, t, ghost) {
    const { pen } = this;
    const { times, places } = this.#path(track, origin);
    for (let s = 0; s < track.count; s++) {
      if (s === origin) continue;
      for (const part of ["past", "ahead"]) {
        pen.beginPath();
        let drawn = false;
        for (let k = 0; k < times.length; k++) {
          if (part === "past" ? times[k] > t : times[k] < t) continue;
          const place = places[k].subarray(3 * s, 3 * s + 3);
          if (!Number.isFinite(place[0])) continue;
          const [x, y] = this.project(place);
          pen[drawn ? "lineTo" : "moveTo"](x, y);
          drawn = true;
        }
        pen.strokeStyle = ghost ?? (s === state.satellite ? "#F5DBA0" : "#9DB4CE");
        pen.globalAlpha = part === "past" ? 0.9 : 0.28;
        pen.lineWidth = part === "past" ? 1.8 : 1.1;
        pen.stroke();
      }
    }
    pen.globalAlpha = 1;
  }

  /** Points of the inspected spacecraft, drawn at a size that can be seen, by who has inspected them. */
  #points(state, t, origin) {
    const { track } = state;
    const { targets, count } = track.scene;
    track.eventTimes ??= [EVENT.PAID, EVENT.UNPAID, EVENT.DELIVERED].map((kind) => track.firstEvents(kind));
    const [paid, unpaid, delivered] = track.eventTimes;
    const body = bodyToHill(track, origin);
    let largest = 1e-9;
    for (let j = 0; j < targets.length; j++) largest = Math.max(largest, Math.abs(targets[j]));
    const factor = Math.max(1, SEEN / (largest * this.scale));
    this.reach = largest * factor * this.scale;
    const points = Array.from({ length: count }, (_, j) => {
      const [x, y, depth] = this.project(body(targets.subarray(3 * j, 3 * j + 3)).map((value) => value * factor));
      return { x, y, depth, color: t >= delivered[j] ? SKY : t >= paid[j] ? GREEN : t >= unpaid[j] ? ORANGE : null };
    });
    points.sort((a, b) => a.depth - b.depth);
    for (const { x, y, depth, color } of points) {
      this.pen.globalAlpha = depth < 0 ? 0.35 : 1;
      this.pen.fillStyle = color ?? "#C9B98E";
      this.pen.beginPath();
      this.pen.arc(x, y, color ? 3.4 : 2.3, 0, 2 * Math.PI);
      this.pen.fill();
    }
    this.pen.globalAlpha = 1;
    if (factor < 1.05) return;
    this.pen.fillStyle = "#8d9cb3";
    this.pen.textAlign = "right";
    this.pen.fillText(`points drawn ${factor.toFixed(factor < 10 ? 1 : 0)} times as large`, this.canvas.clientWidth - 12, 20);
  }

  #bodies(state, t, origin) {
    const { pen } = this;
    const { track, recording } = state;
    const places = this.relative(track, origin, t);
    const labels = new Labels(pen, this.canvas.clientWidth, this.canvas.clientHeight);
    const order = Array.from({ length: track.count }, (_, s) => s).sort((a, b) => (b === state.satellite) - (a === state.satellite));
    for (const s of order) {
      const place = places.subarray(3 * s, 3 * s + 3);
      if (!Number.isFinite(place[0])) continue;
      const [x, y] = this.project(place);
      if (s !== origin || recording.places !== "points") {
        pen.fillStyle = activityColor(track, s, t);
        pen.strokeStyle = s === state.satellite ? "#fff" : "#0a1422";
        pen.lineWidth = 2;
        pen.beginPath();
        pen.arc(x, y, 6, 0, 2 * Math.PI);
        pen.fill();
        pen.stroke();
      }
      const far = s === origin ? "" : ` · ${distance(Math.hypot(...place))}`;
      const above = s === origin && recording.places === "points" ? -this.reach - 14 : 11;
      if (s !== origin) labels.reserve(x, y, 6);
      labels.write(shorten(recording.satellites[s].name) + far, x, y, { strong: s === state.satellite, above });
    }
    if (!track.scene.hasEarth) return;
    const axes = hillAxes(track.position, track.velocity, origin);
    const sun = axes.map((axis) => axis[0] * track.sun[0] + axis[1] * track.sun[1] + axis[2] * track.sun[2]);
    const reach = 70 / this.scale;
    const [x, y] = this.project(sun.map((value) => value * reach));
    pen.strokeStyle = pen.fillStyle = "#F0E442";
    pen.setLineDash([3, 3]);
    pen.lineWidth = 1.4;
    pen.beginPath();
    pen.moveTo(...this.middle);
    pen.lineTo(x, y);
    pen.stroke();
    pen.setLineDash([]);
    pen.textAlign = "center";
    pen.fillText("to the Sun", x, y - 9);
  }
}

/** A function from components in the body frame of a satellite to its Hill frame. */
function bodyToHill(track, s) {
  const rotation = track.rotation[s] ?? new Quaternion();
  const axes = track.scene.hasEarth ? hillAxes(track.position, track.velocity, s) : null;
  return (place) => {
    const inN = new Vector3(...place).applyQuaternion(rotation);
    return axes ? axes.map((axis) => axis[0] * inN.x + axis[1] * inN.y + axis[2] * inN.z) : inN.toArray();
  };
}

function niceStep(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return [1, 2, 5].map((digit) => digit * power).filter((step) => step <= value).at(-1) ?? power;
}

/** A distance in m or km. */
function distance(meters) {
  return meters >= 1000 ? `${(meters / 1000).toFixed(meters < 1e4 ? 1 : 0)} km` : `${meters.toFixed(meters < 10 ? 1 : 0)} m`;
}
