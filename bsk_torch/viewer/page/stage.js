// The globe with one track, with others as ghosts over it, or with several tracks side by side; and labels over it.

import { Matrix4, Scene, Vector3, WebGLRenderer } from "three";
import { Backdrop } from "viewer/backdrop";
import { OrbitCamera } from "viewer/camera";
import { activityColor, hillAxes } from "viewer/flight";
import { Globe } from "viewer/globe";
import { Labels, shorten } from "viewer/labels";
import { RADIUS, TrackLayer } from "viewer/satellites";
import { Stations, Targets } from "viewer/targets";
import { TRACKS } from "viewer/palette";

const MOST_PIXELS = 2; // device pixels per CSS pixel
const NEAR = 24; // CSS pixels within which a click selects

export class Stage {
  constructor(canvas, overlay, land, onChange) {
    Object.assign(this, { canvas, overlay });
    this.renderer = new WebGLRenderer({ canvas, antialias: false, powerPreference: "high-performance" });
    this.renderer.setClearColor(0x070b14, 1);
    this.renderer.autoClear = false;
    this.scene = new Scene();
    this.globe = new Globe(land);
    this.backdrop = new Backdrop(this.globe);
    this.scene.add(this.backdrop.earth);
    this.control = new OrbitCamera(overlay, onChange);
    this.layers = new Map();
    this.stations = new Map();
    this.pen = overlay.getContext("2d");
    this.views = [];
    this.detail = 1; // share of the resolution that the globe is drawn with
  }

  get camera() {
    return this.control.camera;
  }

  /** Draw another recording from now on. */
  reset(recording) {
    this.recording = recording;
    for (const layer of this.layers.values()) {
      this.scene.remove(layer.group, layer.targets.group);
      for (const group of [layer.group, layer.targets.group]) group.traverse((part) => part.geometry?.dispose());
    }
    for (const stations of this.stations.values()) this.scene.remove(stations.group);
    this.layers.clear();
    this.stations.clear();
  }

  /** Turn the camera to the side of the Earth over which satellite s of a track flies, where it is day if possible. */
  face(track, s, t, frame = "inertial") {
    track.moveTo(t);
    const [x, y, z] = track.position.subarray(3 * s, 3 * s + 3);
    const PN = track.scene.earthAt(t);
    const turned = frame === "earth" ? Math.atan2(PN[1], PN[0]) : 0; // right ascension of the prime meridian
    const sun = Math.atan2(track.sun[1], track.sun[0]) - turned;
    const satellite = Math.atan2(y, x) - turned;
    const aside = Math.atan2(Math.sin(sun - satellite), Math.cos(sun - satellite));
    this.control.azimuth = satellite + Math.min(Math.max(aside * 0.5, -0.6), 0.6);
    this.control.elevation = 0.25 + 0.35 * Math.sign(z || 1) * Math.min(Math.abs(z) / RADIUS, 0.8);
  }

  resize() {
    const ratio = Math.min(window.devicePixelRatio || 1, MOST_PIXELS);
    const { clientWidth: width, clientHeight: height } = this.overlay;
    if (this.ratio === ratio && this.width === width && this.height === height && this.drawnDetail === this.detail) return;
    Object.assign(this, { ratio, width, height, drawnDetail: this.detail });
    this.renderer.setPixelRatio(ratio * this.detail);
    this.renderer.setSize(width, height, false);
    this.overlay.width = Math.round(width * ratio);
    this.overlay.height = Math.round(height * ratio);
  }

  layer(track) {
    if (!this.layers.has(track)) {
      const layer = new TrackLayer(track, orbitalPeriod(track));
      layer.targets = new Targets(track);
      this.layers.set(track, layer);
      this.scene.add(layer.group, layer.targets.group);
    }
    return this.layers.get(track);
  }

  stationsOf(track) {
    if (!this.stations.has(track.scene)) {
      const radius = Math.max(Math.hypot(...track.position.subarray(0, 3)) / RADIUS || 1.08, 1.02);
      const stations = new Stations(track.scene, this.recording.header.station_min_elevation, radius);
      this.stations.set(track.scene, stations);
      this.scene.add(stations.group);
    }
    return this.stations.get(track.scene);
  }

  /** Draw state: {time, track, ghosts, side, satellite, target, follow, frame, show, flash}. */
  draw(state) {
    this.resize();
    if (!this.width || !this.height) return;
    this.renderer.setScissorTest(true);
    this.pen.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    this.pen.clearRect(0, 0, this.width, this.height);
    const tracks = state.side.length ? [state.track, ...state.side] : [state.track];
    const columns = tracks.length === 1 ? 1 : this.width > 0.9 * this.height ? Math.min(tracks.length, 2) : 1;
    const rows = Math.ceil(tracks.length / columns);
    this.views = tracks.map((track, k) => {
      const view = { track, width: this.width / columns, height: this.height / rows };
      view.x = (k % columns) * view.width;
      view.y = Math.floor(k / columns) * view.height;
      return view;
    });
    for (const [k, view] of this.views.entries()) this.#drawView(state, view, k);
  }

  #drawView(state, view, index) {
    const { track } = view;
    const t = Math.min(state.time, track.duration);
    track.moveTo(t);
    this.globe.moveTo(track.scene.earthAt(t), track.sun);
    this.#placeCamera(state, view, t);
    const { camera } = this;
    const ratio = this.ratio * this.detail; // pixels of the globe per CSS pixel
    this.globe.setView(camera, ratio);
    const { eyeP } = this.globe;
    const layer = this.layer(track);
    const stations = this.stationsOf(track);
    const shown = new Set([layer]);
    stations.update(this.globe.group.matrix, eyeP, ratio);
    for (const [scene, other] of this.stations) other.group.visible = scene === track.scene && state.show.stations;
    stations.cones.mesh.visible = state.show.cones;
    setSize(stations.cones, view);
    const mine = { selected: state.satellite, show: state.show, follow: state.follow, stations: state.show.stations ? stations.places : [] };
    layer.update(t, camera, mine);
    if (!layer.targets.inOrbit) layer.targets.group.matrix.copy(this.globe.group.matrix);
    stations.group.matrix.copy(this.globe.group.matrix);
    const eye = layer.targets.inOrbit ? camera.position : eyeP;
    layer.targets.update(t, eye, { ratio, flash: state.flash, selected: state.target });
    layer.targets.group.visible = state.show.targets && this.recording.places !== "points";
    const ghosts = state.side.length ? [] : state.ghosts;
    ghosts.forEach((ghost, k) => {
      const faint = this.layer(ghost);
      shown.add(faint);
      faint.update(Math.min(state.time, ghost.duration), camera, { ...mine, ghost: TRACKS[(k + 1) % TRACKS.length] });
      faint.targets.group.visible = false;
    });
    for (const other of this.layers.values()) {
      other.group.visible = shown.has(other);
      if (!shown.has(other)) other.targets.group.visible = false;
      for (const lines of [other.orbits, other.rays, other.threads, other.axes]) setSize(lines, view);
    }
    track.moveTo(t);
    const bottom = this.height - view.y - view.height;
    this.renderer.setViewport(view.x, bottom, view.width, view.height);
    this.renderer.setScissor(view.x, bottom, view.width, view.height);
    this.renderer.clearDepth();
    this.backdrop.update(this.renderer, camera, index, [view.x, bottom, view.width, view.height].map((x) => Math.round(x * ratio)));
    this.renderer.render(this.scene, camera);
    this.#label(state, view, layer, index, ghosts);
  }

  #placeCamera(state, view, t) {
    const axes = new Matrix4();
    const center = new Vector3();
    if (state.follow && view.track.isPresent(state.satellite)) {
      const [radial, along] = hillAxes(view.track.position, view.track.velocity, state.satellite).map((axis) => new Vector3(...axis));
      const behind = along.clone().negate();
      axes.makeBasis(behind, radial.clone().cross(behind), radial);
      center.set(...view.track.position.subarray(3 * state.satellite, 3 * state.satellite + 3)).divideScalar(RADIUS);
    } else if (state.frame === "earth") {
      axes.copy(this.globe.group.matrix);
    }
    this.control.place(center, axes, view.width, view.height, t);
    view.matrix = new Matrix4().multiplyMatrices(this.camera.projectionMatrix, this.camera.matrixWorldInverse);
    view.eye = this.camera.position.clone();
  }

  /** Place of a point of N, in radii, on the screen in CSS pixels, and whether the Earth leaves it visible. */
  project(point, view = this.views[0]) {
    const p = point.clone().applyMatrix4(view.matrix);
    const toward = point.clone().sub(view.eye);
    const front = toward.dot(new Vector3(view.matrix.elements[3], view.matrix.elements[7], view.matrix.elements[11])) > 0;
    const distance = toward.length();
    const ray = toward.divideScalar(distance);
    const along = view.eye.dot(ray);
    const square = along * along - view.eye.lengthSq() + 0.9985 ** 2;
    const hidden = square > 0 && along < 0 && -along - Math.sqrt(square) < distance;
    return {
      x: view.x + ((p.x + 1) / 2) * view.width,
      y: view.y + ((1 - p.y) / 2) * view.height,
      visible: front && !hidden && Math.abs(p.x) <= 1 && Math.abs(p.y) <= 1,
    };
  }

  /** What was clicked: {satellite} or {target}, by index, or null. */
  pick(x, y, state) {
    const view = this.views.find((one) => x >= one.x && x < one.x + one.width && y >= one.y && y < one.y + one.height);
    if (!view) return null;
    const layer = this.layer(view.track);
    const nearest = (count, place, reach) => {
      let [best, found] = [reach, -1];
      for (let k = 0; k < count; k++) {
        const { x: px, y: py, visible } = this.project(place(k), view);
        const distance = visible ? Math.hypot(px - x, py - y) : Infinity;
        if (distance < best) [best, found] = [distance, k];
      }
      return found;
    };
    const satellite = nearest(view.track.count, (k) => layer.places[k], NEAR);
    if (satellite >= 0) return { satellite };
    if (!state.show.targets || this.recording.places === "points") return null;
    const target = nearest(view.track.scene.count, (k) => this.targetPlace(layer, k), NEAR / 2);
    return target >= 0 ? { target } : null;
  }

  /** Position of a target in N, radii. */
  targetPlace(layer, k) {
    return layer.targets.place(k).applyMatrix4(layer.targets.group.matrix);
  }

  #label(state, view, layer, index, ghosts) {
    const labels = new Labels(this.pen, this.width, this.height);
    const edge = view.x + view.width;
    const order = [...layer.places.keys()].sort((a, b) => (b === state.satellite) - (a === state.satellite));
    for (const s of order) {
      if (!view.track.isPresent(s)) continue;
      const spot = this.project(layer.places[s], view);
      if (!spot.visible) continue;
      const chosen = s === state.satellite;
      labels.reserve(spot.x, spot.y, 7);
      if (chosen) this.#ring(spot, activityColor(view.track, s, view.track.now));
      if (!view.track.isAlive(s, view.track.now)) this.#cross(spot);
      if (state.show.labels || chosen) {
        labels.write(shorten(this.recording.satellites[s].name), spot.x, spot.y, { strong: chosen, aside: chosen ? 20 : 16, above: chosen ? 21 : 14, edge });
      }
    }
    if (state.show.axes && layer.axisTips && view.track.isPresent(state.satellite)) {
      for (const { tip, name, color } of layer.axisTips) {
        const { x, y, visible } = this.project(tip, view);
        if (visible) labels.write(name, x, y, { strong: true, color, aside: 3, above: 0 });
      }
    }
    if (state.target >= 0 && state.show.targets && this.recording.places !== "points") {
      const spot = this.project(this.targetPlace(layer, state.target), view);
      if (spot.visible) labels.write(this.recording.targetName(state.target, state.track.scene), spot.x, spot.y, { strong: true, color: "#F5EBC8", above: 0, edge });
    }
    if (this.views.length > 1) labels.write(shorten(view.track.label, 40), view.x + 2, view.y + 56, { strong: true, above: 0 });
    ghosts.forEach((ghost, k) => {
      const place = { strong: true, color: TRACKS[(k + 1) % TRACKS.length], above: 0, aside: 0 };
      labels.write(`compared: ${shorten(ghost.label, 60)}`, 12, 58 + 18 * k, place);
    });
    const { pen } = this;
    if (index > 0) {
      pen.fillStyle = "#33405a";
      if (view.x) pen.fillRect(view.x, view.y, 1, view.height);
      if (view.y) pen.fillRect(view.x, view.y, view.width, 1);
    }
  }

  #ring({ x, y }, color) {
    const { pen } = this;
    pen.lineWidth = 1.6;
    pen.strokeStyle = color;
    pen.beginPath();
    pen.arc(x, y, 15, 0, 2 * Math.PI);
    pen.stroke();
  }

  #cross({ x, y }) {
    const { pen } = this;
    pen.lineWidth = 2.5;
    pen.strokeStyle = "#E8702A";
    pen.beginPath();
    for (const [dx, dy] of [[7, 7], [7, -7]]) {
      pen.moveTo(x - dx, y - dy);
      pen.lineTo(x + dx, y + dy);
    }
    pen.stroke();
  }
}

function setSize(lines, view) {
  lines.uniforms.size.value.set(view.width, view.height); // widths are in CSS pixels
}

/** Period, s, of the two-body orbit of the first satellite that is present, or the length of the flight. */
function orbitalPeriod(track) {
  for (let s = 0; s < track.count; s++) {
    const [x, y, z] = track.r.subarray(3 * s, 3 * s + 3);
    const [u, v, w] = track.v.subarray(3 * s, 3 * s + 3);
    const energy = (u * u + v * v + w * w) / 2 - 3.986004415e14 / Math.hypot(x, y, z);
    if (energy < 0) return 2 * Math.PI * Math.sqrt((-3.986004415e14 / (2 * energy)) ** 3 / 3.986004415e14);
  }
  return track.duration;
}
