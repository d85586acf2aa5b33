// A track of a recording: what it holds at a time, looked up without a pass over the flight.

import { countUntil, earthAttitude, hermite, interval, linear, mixMrp, quaternionOfMrp, sized } from "viewer/interpolate";
import { GRAY, actionColor } from "viewer/palette";
import { Quaternion } from "three";

const NOT_A_NUMBER = -32768; // as which recording.py stores NaN in 16-bit numbers
const BUCKET = 60; // s: links are listed by such intervals

export const EVENT = { PAID: 0, UNPAID: 1, DELIVERED: 2 };

/** All flights of a file, with what they have in common. */
export class Recording {
  constructor({ header, arrays }) {
    Object.assign(this, { header, arrays, satellites: header.satellites, places: header.places });
    this.scenes = header.scenes.map((_, index) => new Scene(this, index));
    this.tracks = header.tracks.map((_, index) => new Track(this, index));
  }

  /** Label of an action as it is read: "image 0" for "action_image_0". */
  actionName(s, action) {
    const label = this.satellites[s].actions[action];
    return label === undefined ? "continuous control" : label.replace(/^action_/, "").replaceAll("_", " ");
  }

  targetName(j, scene = this.scenes[0]) {
    return scene?.targetNames[j] ?? `${{ points: "Point", orbit: "Object" }[this.places] ?? "Target"} ${j}`;
  }
}

/** Surroundings of the tracks of one episode: stations, targets, and how the Earth turns. */
export class Scene {
  constructor(recording, index) {
    const own = (name) => recording.arrays[`s${index}/${name}`];
    const { PN0, rate, station_names, points_of, target_names } = recording.header.scenes[index];
    Object.assign(this, { hasEarth: PN0.length > 0, PN0, rate, pointsOf: points_of, stationNames: station_names });
    this.targetNames = target_names ?? [];
    this.stations = own("stations_P").data;
    this.targets = own("targets_P").data; // m, [T, 3], in P or in the frame of the inspected spacecraft
    this.count = own("targets_P").shape[0];
    this.priority = own("priority").data;
    this.cloud = own("cloud")?.data ?? null;
  }

  /** Direction cosines of P relative to N at t, row-major. */
  earthAt(t) {
    return this.hasEarth ? earthAttitude(this.PN0, this.rate, t) : [1, 0, 0, 0, 1, 0, 0, 0, 1];
  }
}

export class Track {
  constructor(recording, index) {
    const own = (name) => recording.arrays[`t${index}/${name}`] ?? { data: [], shape: [0], scale: 1 };
    Object.assign(this, recording.header.tracks[index], { recording, index });
    this.count = recording.satellites.length;
    this.scene = recording.scenes[recording.header.tracks[index].scene];
    this.keys = own("key_times").data;
    this.r = own("r_N").data;
    this.v = own("v_N").data;
    this.sunKeys = own("sun_N").data;
    this.sigma = own("sigma");
    this.seriesTimes = own("series_times").data;
    this.seriesValues = own("series").data;
    this.decisions = this.#decisions(own);
    this.observation = own("observation");
    this.events = { time: own("event_time").data, satellite: own("event_satellite").data };
    Object.assign(this.events, { target: own("event_target").data, kind: own("event_kind").data });
    this.links = { start: own("link_start").data, end: own("link_end").data, a: own("link_a").data, b: own("link_b").data };
    this.linkBuckets = this.#bucketLinks();
    this.passes = this.#intervals(own, "passes");
    this.eclipses = this.#intervals(own, "eclipses");
    this.objects = { times: own("object_times").data, r: own("object_r_N").data, v: own("object_v_N").data };
    this.position = new Float64Array(this.count * 3);
    this.velocity = new Float64Array(this.count * 3);
    this.rotation = Array.from({ length: this.count }, () => new Quaternion());
    this.sun = [1, 0, 0];
    this.deathOf = new Map((this.deaths ?? []).map((death) => [death.satellite, death]));
    this.now = NaN;
  }

  /** Interpolate positions, velocities (N; m, m/s), rotations from B to N and the direction of the Sun at t. */
  moveTo(t) {
    if (this.now === t) return;
    this.now = t;
    hermite(this.keys, this.r, this.v, this.count, t, this.position, this.velocity);
    if (this.sunKeys.length) {
      const sun = [0, 1, 2].map((j) => linear(this.keys, this.sunKeys, 3, j, t));
      const norm = Math.hypot(...sun);
      this.sun = sun.map((x) => x / norm);
    }
    for (let s = 0; s < this.count; s++) this.#turn(s, t);
  }

  isPresent(s) {
    return Number.isFinite(this.position[3 * s]);
  }

  /** Whether satellite s has not died until t. */
  isAlive(s, t) {
    return !(this.deathOf.get(s)?.time <= t);
  }

  /** Index of the decision in force for satellite s at t, or -1. */
  decisionAt(s, t) {
    const own = this.decisions.of[s];
    const k = countUntil(own.times, t + 1e-6) - 1;
    return k < 0 ? -1 : own.indices[k];
  }

  /** Value of series n of satellite s at t. */
  seriesAt(s, n, t) {
    const width = this.series.length;
    return linear(this.seriesTimes, this.seriesValues, this.count * width, s * width + n, t);
  }

  /** Whether satellite s has series n. */
  hasSeries(s, n) {
    this.having ??= new Map();
    const key = s * this.series.length + n;
    if (!this.having.has(key)) {
      let found = false;
      for (let k = key; k < this.seriesValues.length && !found; k += this.count * this.series.length) found = Number.isFinite(this.seriesValues[k]);
      this.having.set(key, found);
    }
    return this.having.get(key);
  }

  /** Pairs of satellites that are linked at t. */
  linksAt(t) {
    return (this.linkBuckets.get(Math.floor(t / BUCKET)) ?? [])
      .filter((k) => this.links.start[k] <= t && t < this.links.end[k])
      .map((k) => [this.links.a[k], this.links.b[k]]);
  }

  /** First time, s, of an event of a kind by target; Infinity where there is none. */
  firstEvents(kind) {
    const times = new Float32Array(this.scene.count).fill(Infinity);
    for (let k = this.events.time.length - 1; k >= 0; k--) {
      if (this.events.kind[k] === kind && this.events.target[k] >= 0) times[this.events.target[k]] = this.events.time[k];
    }
    return times;
  }

  /** Positions of objects in orbit at t, m, written to out, [T, 3]. */
  objectsAt(t, out) {
    this.scratch = sized(this.scratch, out.length);
    hermite(this.objects.times, this.objects.r, this.objects.v, out.length / 3, t, out, this.scratch);
  }

  #decisions(own) {
    const d = { mask: own("decision_mask"), probability: own("decision_probability") };
    d.actionValue = own("decision_action_value");
    d.control = own("decision_control");
    d.targets = own("decision_action_target"); // of each action
    d.opens = own("decision_action_opens"); // s, when the target's window opens
    for (const name of ["time", "end", "satellite", "action", "target", "reward"]) d[name] = own(`decision_${name}`).data;
    d.of = Array.from({ length: this.recording.satellites.length }, () => ({ times: [], indices: [] }));
    for (let k = 0; k < d.time.length; k++) {
      d.of[d.satellite[k]].times.push(d.time[k]);
      d.of[d.satellite[k]].indices.push(k);
    }
    return d;
  }

  #intervals(own, name) {
    const bounds = own(name).data;
    const satellites = own(`${name}_satellite`).data;
    const lists = Array.from({ length: this.recording.satellites.length }, () => []);
    for (let k = 0; k < satellites.length; k++) lists[satellites[k]].push([bounds[2 * k], bounds[2 * k + 1]]);
    return lists;
  }

  #bucketLinks() {
    const buckets = new Map();
    for (let k = 0; k < this.links.start.length; k++) {
      const last = Math.floor(this.links.end[k] / BUCKET);
      for (let bucket = Math.floor(this.links.start[k] / BUCKET); bucket <= last; bucket++) {
        if (!buckets.has(bucket)) buckets.set(bucket, []);
        buckets.get(bucket).push(k);
      }
    }
    return buckets;
  }

  #turn(s, t) {
    const count = this.sigma.shape[0];
    if (!count) return this.#towardEarth(s);
    const place = Math.min(Math.max((t - (this.attitude_start ?? 0)) / this.attitude_step, 0), count - 1);
    const k = Math.min(Math.floor(place), Math.max(count - 2, 0));
    const [a, b, mixed] = [[], [], []];
    for (let j = 0; j < 3; j++) {
      a.push(this.sigma.data[(k * this.count + s) * 3 + j]);
      b.push(this.sigma.data[(Math.min(k + 1, count - 1) * this.count + s) * 3 + j]);
    }
    if (a[0] === NOT_A_NUMBER || b[0] === NOT_A_NUMBER) return this.#towardEarth(s);
    for (let j = 0; j < 3; j++) {
      a[j] *= this.sigma.scale;
      b[j] *= this.sigma.scale;
    }
    mixMrp(a, b, place - k, mixed);
    return quaternionOfMrp(...mixed, this.rotation[s]);
  }

  /** Satellites without a recorded attitude point their third axis at the Earth. */
  #towardEarth(s) {
    const [x, y, z] = this.position.subarray(3 * s, 3 * s + 3);
    const norm = Math.hypot(x, y, z) || 1;
    const w = 1 - z / norm;
    this.rotation[s].set(y / norm, -x / norm, 0, w);
    if (w < 1e-9) this.rotation[s].set(1, 0, 0, 0);
    return this.rotation[s].normalize();
  }
}

/** Color of what satellite s does at t. */
export function activityColor(track, s, t) {
  const d = track.decisionAt(s, t);
  if (d < 0) return GRAY;
  const action = track.decisions.action[d];
  return actionColor(track.recording.actionName(s, action), action);
}

/** Hill axes of a satellite as unit vectors in N: radial, along-track, orbit normal. */
export function hillAxes(position, velocity, s) {
  const r = Array.from(position.subarray(3 * s, 3 * s + 3));
  const v = Array.from(velocity.subarray(3 * s, 3 * s + 3));
  const unit = (a) => a.map((x) => x / (Math.hypot(...a) || 1));
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const radial = unit(r);
  const normal = unit(cross(r, v));
  return [radial, cross(normal, radial), normal];
}
