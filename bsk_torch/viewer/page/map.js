// The map view: plate carree, with night, ground tracks, targets and stations. Longitudes and latitudes are geocentric.

import { EVENT, activityColor } from "viewer/flight";
import { landPath } from "viewer/globe";
import { hermite, sized } from "viewer/interpolate";
import { Labels, shorten } from "viewer/labels";
import { GREEN, ORANGE, SKY, TRACKS } from "viewer/palette";

const EVERY = 20; // s between the points of a ground track
const TOOLS = 44; // CSS pixels above the map
const LEGEND = 34; // and below it
const WIDTH = 2048; // pixels of the land that is drawn in advance

export class WorldMap {
  constructor(canvas, land) {
    Object.assign(this, { canvas, land, pen: canvas.getContext("2d"), tracks: new Map() });
  }

  /** Place on the screen, CSS pixels, of a vector in P. */
  project([x, y, z]) {
    const longitude = Math.atan2(y, x);
    const latitude = Math.atan2(z, Math.hypot(x, y));
    return [this.left + (longitude / (2 * Math.PI) + 0.5) * this.width, this.top + (0.5 - latitude / Math.PI) * this.height];
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
    this.width = Math.min(width, 2 * (height - TOOLS - LEGEND));
    this.height = this.width / 2;
    this.left = (width - this.width) / 2;
    this.top = Math.max((height - this.height) / 2, TOOLS);
    const t = Math.min(state.time, state.track.duration);
    const { track } = state;
    track.moveTo(t);
    const PN = track.scene.earthAt(t);
    const sun = turn(PN, track.sun);
    pen.save();
    pen.beginPath();
    pen.rect(this.left, this.top, this.width, this.height);
    pen.clip();
    this.#ground();
    this.#night(sun);
    this.#grid();
    if (state.show.stations) this.#stations(track);
    if (state.show.targets && state.recording.places !== "points") this.#targets(state, t, PN);
    state.ghosts.forEach((ghost, k) => this.#groundTracks(state, ghost, Math.min(state.time, ghost.duration), TRACKS[(k + 1) % TRACKS.length]));
    track.moveTo(t);
    this.#groundTracks(state, track, t, null);
    this.#satellites(state, t, PN);
    pen.restore();
  }

  #ground() {
    if (!this.base) {
      this.base = document.createElement("canvas");
      [this.base.width, this.base.height] = [WIDTH, WIDTH / 2];
      const pen = this.base.getContext("2d");
      pen.fillStyle = "#1c3a5c";
      pen.fillRect(0, 0, WIDTH, WIDTH / 2);
      const path = landPath(this.land, WIDTH, WIDTH / 2);
      pen.fillStyle = "#5b6f69";
      pen.fill(path, "evenodd");
      pen.strokeStyle = "rgba(190, 210, 225, 0.45)";
      pen.stroke(path);
    }
    this.pen.drawImage(this.base, this.left, this.top, this.width, this.height);
  }

  /** Darken where the Sun is below the horizon, in three steps of twilight. */
  #night([x, y, z]) {
    const { pen } = this;
    const declination = Math.asin(z);
    const noon = Math.atan2(y, x);
    for (const depth of [0, 0.105, 0.21]) {
      pen.fillStyle = "rgba(5, 9, 22, 0.34)";
      for (let column = 0; column < this.width; column += 2) {
        const hour = (column / this.width - 0.5) * 2 * Math.PI - noon;
        const [from, to] = darkLatitudes(declination, hour, depth);
        if (from >= to) continue;
        const top = this.top + (0.5 - to / Math.PI) * this.height;
        pen.fillRect(this.left + column, top, 2, ((to - from) / Math.PI) * this.height);
      }
    }
  }

  #grid() {
    const { pen } = this;
    pen.strokeStyle = "rgba(180, 200, 220, 0.13)";
    pen.lineWidth = 1;
    pen.beginPath();
    for (let k = 1; k < 12; k++) {
      pen.moveTo(this.left + (k / 12) * this.width, this.top);
      pen.lineTo(this.left + (k / 12) * this.width, this.top + this.height);
      if (k < 6) {
        pen.moveTo(this.left, this.top + (k / 6) * this.height);
        pen.lineTo(this.left + this.width, this.top + (k / 6) * this.height);
      }
    }
    pen.stroke();
  }

  #stations(track) {
    const { pen } = this;
    const { stations } = track.scene;
    for (let k = 0; k < stations.length; k += 3) {
      const [x, y] = this.project(stations.subarray(k, k + 3));
      pen.fillStyle = SKY;
      pen.strokeStyle = "#0a1422";
      pen.fillRect(x - 3, y - 3, 6, 6);
      pen.strokeRect(x - 3.5, y - 3.5, 7, 7);
    }
  }

  #targets(state, t, PN) {
    const { track } = state;
    const { scene } = track;
    track.eventTimes ??= [EVENT.PAID, EVENT.UNPAID, EVENT.DELIVERED].map((kind) => track.firstEvents(kind));
    const [paid, unpaid, delivered] = track.eventTimes;
    const inOrbit = state.recording.places === "orbit";
    const places = inOrbit ? (this.scratch = sized(this.scratch, scene.count * 3)) : scene.targets;
    if (inOrbit) track.objectsAt(t, places);
    const size = scene.count > 2500 ? 1.6 : 2.4;
    for (let j = 0; j < scene.count; j++) {
      const place = places.subarray(3 * j, 3 * j + 3);
      const [x, y] = this.project(inOrbit ? turn(PN, place) : place);
      const color = t >= delivered[j] ? SKY : t >= paid[j] ? GREEN : t >= unpaid[j] ? ORANGE : null;
      this.pen.fillStyle = color ?? "rgba(245, 232, 195, 0.6)";
      const half = (j === state.target ? 3 : 1) * (color ? size * 1.25 : size * 0.75);
      this.pen.fillRect(x - half, y - half, 2 * half, 2 * half);
    }
  }

  /** Latitude and longitude over the whole flight, as places on a map of width 1, kept by track. */
  #path(track) {
    if (this.tracks.has(track)) return this.tracks.get(track);
    const count = Math.floor(track.duration / EVERY) + 1;
    const path = { x: new Float32Array(count * track.count), y: new Float32Array(count * track.count), count };
    const [place, speed] = [new Float64Array(3 * track.count), new Float64Array(3 * track.count)];
    const home = { left: this.left, top: this.top, width: this.width, height: this.height };
    Object.assign(this, { left: 0, top: 0, width: 1, height: 1 });
    for (let k = 0; k < count; k++) {
      hermite(track.keys, track.r, track.v, track.count, k * EVERY, place, speed);
      const attitude = track.scene.earthAt(k * EVERY);
      for (let s = 0; s < track.count; s++) {
        [path.x[k * track.count + s], path.y[k * track.count + s]] = this.project(turn(attitude, place.subarray(3 * s, 3 * s + 3)));
      }
    }
    Object.assign(this, home);
    this.tracks.set(track, path);
    return path;
  }

  #groundTracks(state, track, t, ghost) {
    const { pen } = this;
    const { x, y, count } = this.#path(track);
    const span = Math.round(2900 / EVERY);
    const now = Math.floor(t / EVERY);
    for (let s = 0; s < track.count; s++) {
      const chosen = s === state.satellite;
      const piece = (from, to, alpha) => {
        pen.globalAlpha = alpha;
        pen.strokeStyle = ghost ?? (chosen ? "#F5DBA0" : "#9DB4CE");
        pen.lineWidth = chosen ? 2 : 1.2;
        pen.beginPath();
        let last = NaN;
        for (let k = Math.max(from, 0); k <= Math.min(to, count - 1); k++) {
          const at = x[k * track.count + s];
          const joined = Math.abs(at - last) < 0.5;
          pen[joined ? "lineTo" : "moveTo"](this.left + at * this.width, this.top + y[k * track.count + s] * this.height);
          last = at;
        }
        pen.stroke();
      };
      piece(now - span, now, chosen ? 0.95 : 0.45);
      if (chosen) piece(now, now + span, 0.35);
    }
    pen.globalAlpha = 1;
  }

  #satellites(state, t, PN) {
    const { pen } = this;
    const { track, recording } = state;
    const labels = new Labels(pen, this.left + this.width, this.top + this.height);
    const order = Array.from({ length: track.count }, (_, s) => s).sort((a, b) => (b === state.satellite) - (a === state.satellite));
    for (const s of order) {
      if (!track.isPresent(s)) continue;
      const [x, y] = this.project(turn(PN, track.position.subarray(3 * s, 3 * s + 3)));
      const chosen = s === state.satellite;
      pen.fillStyle = track.isAlive(s, t) ? activityColor(track, s, t) : "#555f70";
      pen.strokeStyle = chosen ? "#fff" : "#0a1422";
      pen.lineWidth = chosen ? 2 : 1.2;
      pen.beginPath();
      pen.arc(x, y, chosen ? 6.5 : 4.5, 0, 2 * Math.PI);
      pen.fill();
      pen.stroke();
      labels.reserve(x, y, 6);
      if (state.show.labels || chosen) labels.write(shorten(recording.satellites[s].name), x, y, { strong: chosen });
    }
  }
}

/** Components in P of a vector in N. */
function turn(PN, [x, y, z]) {
  return [PN[0] * x + PN[1] * y + PN[2] * z, PN[3] * x + PN[4] * y + PN[5] * z, PN[6] * x + PN[7] * y + PN[8] * z];
}

/** Latitudes between which the Sun is more than `depth` below the horizon, at an hour angle; rad. */
function darkLatitudes(declination, hour, depth) {
  // sin(elevation) = a sin(latitude) + b cos(latitude) = c cos(latitude - peak), with the Sun highest at the latitude `peak`
  const [a, b] = [Math.sin(declination), Math.cos(declination) * Math.cos(hour)];
  const c = Math.hypot(a, b);
  const ratio = -Math.sin(depth) / c;
  const half = Math.PI / 2;
  if (ratio >= 1) return [-half, half];
  if (ratio <= -1) return [half, -half];
  const peak = Math.atan2(a, b);
  const width = Math.acos(ratio);
  const wrap = (angle) => Math.atan2(Math.sin(angle), Math.cos(angle));
  // Dark is beyond `width` from the peak, on either side: the part of it that latitudes reach is next to one of the poles
  const south = wrap(peak - width);
  const north = wrap(peak + width);
  if (Math.abs(south) <= half && Math.abs(north) > half) return [-half, south];
  if (Math.abs(north) <= half && Math.abs(south) > half) return [north, half];
  return Math.cos(half - peak) < ratio || Math.cos(peak) < ratio ? [-half, half] : [half, -half];
}
