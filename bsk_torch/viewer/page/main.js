// The page: its state, what changes it, and when it is drawn.

import { Vector3 } from "three";
import { UnreadableRecording, decode, fromBase64 } from "viewer/decode";
import { byId, make } from "viewer/dom";
import { Recording } from "viewer/flight";
import { HillView } from "viewer/hill";
import { listen } from "viewer/keys";
import { Live } from "viewer/live";
import { WorldMap } from "viewer/map";
import { GREEN, ORANGE, SKY, actionColor } from "viewer/palette";
import { Panels } from "viewer/panels";
import { RADIUS } from "viewer/satellites";
import { Stage } from "viewer/stage";
import { Timeline, clock } from "viewer/timeline";

const FRAME = 1000 / 31; // ms: about 30 frames a second, in the mean
const SLOW = 1.1; // times this long, frames are drawn with fewer pixels
const READ = 200; // ms: while playing, texts change no faster than they can be read
const LEAST_DETAIL = 0.36; // of the resolution, along both axes
const SPEEDS = [1, 5, 10, 30, 60, 120, 300, 600, 1200];
const PLAYED = 75; // s that a flight takes at the first speed, roughly
const LAYERS = { orbits: "Orbits", instruments: "Instruments", links: "Links and passes", targets: "Targets", stations: "Stations", cones: "Station cones", axes: "Body axes", labels: "Names" };

const json = (id) => JSON.parse(byId(id).textContent);
const reduced = window.matchMedia("(prefers-reduced-motion: reduce)");
const dark = window.matchMedia("(prefers-color-scheme: dark)");

class Viewer {
  constructor(settings, land) {
    Object.assign(this, { settings, land, playing: false, speed: 60, view: "globe", drawn: 0, read: 0 });
    this.live = settings.live ? new Live(settings.live) : null;
    this.show = Object.fromEntries(Object.keys(LAYERS).map((name) => [name, name !== "cones"]));
    Object.assign(this, { time: 0, satellite: 0, target: -1, follow: false, frame: "inertial", ghosts: [], side: [] });
    Object.assign(this, { version: 0, busy: "", said: "", flash: 0 });
    this.ready = this.#open();
  }

  async #open() {
    try {
      const baked = byId("recording").textContent.trim();
      const bytes = baked ? fromBase64(baked) : this.live ? await this.live.recording() : null;
      if (!bytes) throw new UnreadableRecording("This page has no recording.");
      await this.load(bytes);
      byId("message").hidden = true;
    } catch (error) {
      byId("message").textContent = error instanceof UnreadableRecording || this.live ? error.message : `The recording cannot be shown: ${error.message}`;
      byId("message").hidden = false;
      this.failed = error.message;
    }
  }

  /** Show a recording, from its bytes; `track` is the flight to show. */
  async load(bytes, track = 0) {
    this.recording = new Recording(await decode(bytes));
    this.track = this.recording.tracks[Math.min(track, this.recording.tracks.length - 1)];
    this.narrow = window.innerWidth < 760;
    const { header } = this.recording;
    byId("title").textContent = header.title;
    document.title = header.title;
    byId("subtitle").textContent = [header.preset, header.policy].filter((text) => text && !header.title.includes(text)).join(" · ");
    this.#build();
    this.changed();
  }

  #build() {
    const first = !this.timeline;
    const canvas = byId("overlay");
    if (first) this.stage = this.#stage(canvas);
    this.stage.reset(this.recording);
    this.map = new WorldMap(canvas, this.land);
    this.hill = new HillView(canvas);
    if (first) {
      this.panels = new Panels(byId("panels"), this);
      this.timeline = new Timeline(byId("timeline"), byId("playhead"), { seek: (t) => this.seek(t ?? this.time), select: (s) => this.select(s) });
      this.speed = SPEEDS.reduce((a, b) => (Math.abs(b - this.track.duration / PLAYED) < Math.abs(a - this.track.duration / PLAYED) ? b : a));
      this.#controls();
      const decided = this.track.decisions.of.map(({ times }) => times.length);
      this.satellite = decided.indexOf(Math.max(...decided)); // the first one of those with the most decisions
      this.#restore();
      if (!this.track.scene.hasEarth || (this.recording.places === "points" && !this.viewChosen)) this.setView("hill");
    }
    document.querySelector("[data-view=hill]").hidden = !this.hasNeighbors;
    this.#trackMenu();
    this.#legend();
  }

  #stage(canvas) {
    try {
      return new Stage(byId("globe"), canvas, this.land, () => this.changed());
    } catch {
      throw new UnreadableRecording("This browser cannot draw the globe: WebGL 2 is off or missing. Turn it on, or use another browser.");
    }
  }

  /** What all parts draw from. */
  get state() {
    const { recording, track, time, satellite, target, follow, frame, ghosts, side, show, version, busy, said, live, flash, narrow } = this;
    return { recording, track, time, satellite, target, follow, frame, ghosts, side, show, version, busy, said, live: !!live, flash, narrow, dark: dark.matches };
  }

  /** Draw soon; nothing is drawn as long as nothing changes. */
  changed() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame((now) => this.#frame(now));
  }

  #frame(now) {
    this.waiting = false;
    if (!this.recording) return;
    if (this.playing) {
      if (now < this.due) return this.changed();
      this.due = Math.max(this.due + FRAME, now - FRAME); // the frame after a late one comes earlier, so that the mean is kept
      const passed = Math.min(now - this.last, 250);
      this.last = now;
      this.#adapt(passed);
      this.time = Math.min(this.time + (passed / 1000) * this.speed, this.end);
      if (this.time >= this.end) this.play(false);
    }
    this.flash = this.playing && !reduced.matches ? 0.45 * this.speed : 0;
    this.draw();
    if (this.playing) this.changed();
  }

  /** While playing, draw the globe with fewer pixels if frames take too long, as without a graphics card. */
  #adapt(passed) {
    this.pace = 0.9 * this.pace + 0.1 * passed;
    if (this.pace < SLOW * FRAME || this.stage.detail <= LEAST_DETAIL) return;
    this.stage.detail = Math.max(this.stage.detail * 0.84, LEAST_DETAIL);
    this.pace = FRAME;
  }

  get end() {
    return Math.max(this.track.duration, ...this.ghosts.map((ghost) => ghost.duration), ...this.side.map((track) => track.duration));
  }

  draw() {
    byId("working").hidden = !this.busy;
    byId("working").textContent = this.busy;
    this.narrow = window.innerWidth < 760;
    const { state } = this;
    byId("globe").hidden = this.view !== "globe";
    if (this.view === "globe") this.stage.draw(state);
    else this[this.view].draw(state);
    const height = this.timeline.height(state);
    if (height !== this.tall) byId("timeline").style.height = `${(this.tall = height)}px`;
    this.timeline.draw(state);
    const now = performance.now();
    this.drawn++;
    if (this.playing && now - this.read < READ) return;
    this.read = now;
    this.panels.draw(state);
    byId("clock").textContent = clock(this.time);
    const scrubber = byId("scrubber");
    scrubber.setAttribute("aria-valuemax", Math.round(this.end));
    scrubber.setAttribute("aria-valuenow", Math.round(this.time));
    scrubber.setAttribute("aria-valuetext", clock(this.time));
  }

  seek(t) {
    this.time = Math.min(Math.max(t, 0), this.end);
    this.changed();
  }

  play(on = !this.playing) {
    if (on && this.time >= this.end) this.time = 0;
    this.playing = on;
    this.pace = FRAME;
    if (!on && this.stage) this.stage.detail = 1;
    this.last = this.due = performance.now();
    byId("play").classList.toggle("on", on);
    byId("play").setAttribute("aria-label", on ? "Pause" : "Play");
    this.changed();
  }

  /** Go to the next (1) or previous (-1) decision of the selected satellite. */
  step(by) {
    this.play(false);
    const { times } = this.track.decisions.of[this.satellite];
    const next = by > 0 ? times.find((t) => t > this.time + 0.01) : times.findLast((t) => t < this.time - 0.01);
    this.seek(next ?? (by > 0 ? this.end : 0));
  }

  select(satellite) {
    this.satellite = satellite;
    this.target = -1;
    byId("picked").hidden = true;
    this.changed();
  }

  /** Show a satellite at a time. */
  visit(satellite, time) {
    this.play(false);
    this.select(satellite);
    this.seek(time);
    this.stage.face(this.track, satellite, this.time, this.frame);
  }

  setTrack(index) {
    if (!this.recording.tracks[index]) return;
    this.track = this.recording.tracks[index];
    this.ghosts = this.ghosts.filter((track) => track !== this.track);
    this.side = this.side.filter((track) => track !== this.track);
    this.seek(this.time);
    this.#trackMenu();
  }

  /** Draw flights together: those of the same episode as ghosts, others side by side; without flights, only one. */
  compare(on) {
    const others = on ? this.recording.tracks.filter((track) => track !== this.track) : [];
    this.ghosts = others.filter((track) => track.scene === this.track.scene).slice(0, 6);
    this.side = this.ghosts.length ? [] : others.slice(0, 3);
    this.#trackMenu();
    this.changed();
  }

  get comparing() {
    return this.ghosts.length + this.side.length > 0;
  }

  setView(view) {
    if (view !== "hill" && !this.track.scene.hasEarth) return;
    if (view === "hill" && !this.hasNeighbors) return;
    this.view = view;
    for (const button of document.querySelectorAll("#views button")) button.setAttribute("aria-pressed", button.dataset.view === view);
    byId("tools").hidden = view === "hill" && this.recording.places === "none";
    for (const id of ["follow", "frame"]) byId(id).hidden = view !== "globe";
    this.changed();
  }

  /** Whether there is anything to see near a satellite: others, or what it images or inspects in space. */
  get hasNeighbors() {
    return this.recording.satellites.length > 1 || ["points", "orbit"].includes(this.recording.places);
  }

  setFollow(on = !this.follow) {
    const { control } = this.stage;
    if (on && !this.follow) this.before = [control.azimuth, control.elevation, control.distance];
    if (on) [control.azimuth, control.elevation, control.distance] = [0.35, 0.5, 0.24];
    else if (this.before) [control.azimuth, control.elevation, control.distance] = this.before;
    this.follow = on;
    byId("follow").setAttribute("aria-pressed", on);
    this.changed();
  }

  setFrame(frame = this.frame === "earth" ? "inertial" : "earth") {
    this.frame = frame;
    byId("frame").setAttribute("aria-pressed", frame === "earth");
    this.stage.face(this.track, this.satellite, this.time, frame);
    this.changed();
  }

  turn(azimuth, elevation) {
    (this.view === "hill" ? this.hill : this.stage.control).turn(azimuth, elevation);
    this.changed();
  }

  zoom(factor) {
    if (this.view === "hill") this.hill.zoom /= factor;
    else this.stage.control.zoom(factor);
    this.changed();
  }

  setSpeed(speed) {
    this.speed = speed;
    byId("speed").value = speed;
  }

  changeSpeed(by) {
    this.setSpeed(SPEEDS[Math.min(Math.max(SPEEDS.indexOf(this.speed) + by, 0), SPEEDS.length - 1)]);
  }

  /** Ask the server for the values of all actions of decision d. */
  values(d) {
    return this.#ask("All actions are flown …", async () => {
      const { action_value: found, how } = await this.live.values(this.track.index, d);
      const { data, shape } = this.track.decisions.actionValue;
      data.set(found.map((value) => value ?? NaN), d * shape[1]);
      this.said = how;
    });
  }

  /** Let the server fly on with another action from decision d, and show both flights. */
  branch(d, action) {
    return this.#ask("The other future is flown …", async () => {
      const time = this.track.decisions.time[d];
      await this.load(await this.live.branch(this.track.index, d, action), Infinity);
      this.ghosts = [this.recording.tracks[this.track.parent]];
      this.#trackMenu();
      this.seek(time);
    });
  }

  episode() {
    return this.#ask("Another episode is flown …", async () => {
      await this.load(await this.live.episode(), Infinity);
      [this.ghosts, this.side] = [[], []];
      this.seek(0);
    });
  }

  async #ask(busy, work) {
    this.play(false);
    Object.assign(this, { busy, said: "" });
    this.changed();
    try {
      await work();
    } catch (error) {
      this.said = error.message;
    }
    this.busy = "";
    this.version++;
    this.changed();
  }

  #controls() {
    const click = (id, action) => byId(id).addEventListener("click", action);
    click("play", () => this.play());
    click("before", () => this.step(-1));
    click("after", () => this.step(1));
    click("follow", () => this.setFollow());
    click("frame", () => this.setFrame());
    click("closer", () => this.timeline.scale(0.5, this.time));
    click("wider", () => this.timeline.scale(2, this.time));
    for (const button of document.querySelectorAll("#views button")) button.addEventListener("click", () => this.setView(button.dataset.view));
    byId("speed").append(...SPEEDS.map((speed) => make("option", { value: speed }, `${speed}×`)));
    byId("speed").addEventListener("change", () => (this.speed = Number(byId("speed").value)));
    this.setSpeed(this.speed);
    for (const [name, label] of Object.entries(LAYERS)) {
      const box = make("input", { type: "checkbox", checked: this.show[name] });
      box.addEventListener("change", () => {
        this.show[name] = box.checked;
        this.changed();
      });
      byId("shown").append(make("label", {}, box, label));
    }
    this.#pointer(byId("overlay"));
    listen(this);
    for (const query of [dark, reduced]) query.addEventListener("change", () => this.changed());
    new ResizeObserver(() => this.changed()).observe(byId("stage"));
  }

  #pointer(overlay) {
    let start = null;
    overlay.addEventListener("pointerdown", (event) => (start = [event.offsetX, event.offsetY]));
    overlay.addEventListener("pointermove", (event) => {
      if (this.view === "hill" && event.buttons) this.turn(-event.movementX * 0.008, event.movementY * 0.008);
    });
    overlay.addEventListener("wheel", (event) => {
      if (this.view === "hill") this.zoom(Math.exp(event.deltaY * 0.0015));
    }, { passive: true });
    overlay.addEventListener("pointerup", (event) => {
      if (this.view !== "globe" || !start || Math.hypot(event.offsetX - start[0], event.offsetY - start[1]) > 5) return;
      const found = this.stage.pick(event.offsetX, event.offsetY, this.state);
      if (found?.satellite >= 0) this.select(found.satellite);
      else this.#pick(found?.target ?? -1);
    });
  }

  #pick(target) {
    this.target = target;
    const note = byId("picked");
    note.hidden = target < 0;
    if (target >= 0) note.textContent = this.#describe(target);
    this.changed();
  }

  /** What is known about a target in the shown flight. */
  #describe(target) {
    const { scene, events } = this.track;
    const parts = [`${this.recording.targetName(target, scene)}: priority ${scene.priority[target].toFixed(2)}`];
    if (scene.cloud) parts.push(`clouds ${(100 * scene.cloud[target]).toFixed(0)} %`);
    const words = ["imaged", "imaged without a reward", "delivered"];
    for (let k = 0; k < events.time.length; k++) {
      if (events.target[k] !== target || parts.length > 5) continue;
      parts.push(`${words[events.kind[k]]} at ${clock(events.time[k])} by ${this.recording.satellites[events.satellite[k]].name}`);
    }
    return parts.join("; ");
  }

  #trackMenu() {
    const { tracks } = this.recording;
    const nav = byId("tracks");
    nav.hidden = tracks.length < 2;
    const options = tracks.map((track, k) => make("option", { value: k, selected: track === this.track }, `${k + 1}: ${track.label}`));
    const select = make("select", { "aria-label": "Flight" }, ...options);
    select.addEventListener("change", () => this.setTrack(Number(select.value)));
    const button = make("button", { type: "button", id: "compare", "aria-pressed": String(this.comparing), title: "Draw the flights together (C)" }, "Compare");
    button.addEventListener("click", () => this.compare(!this.comparing));
    nav.replaceChildren(select, button);
  }

  #legend() {
    const { places, tracks } = this.recording;
    const entries = [];
    if (places !== "none") {
      const noun = places === "points" ? "inspected" : "imaged";
      entries.push(["#F5E8C3", "", `not yet ${noun}`], [GREEN, places === "points" ? "" : "ring", noun]);
      const kinds = new Set(tracks.flatMap((track) => Array.from(track.events.kind)));
      if (kinds.has(1)) entries.push([ORANGE, "ring", `${noun} without a reward`]);
      if (kinds.has(2)) entries.push([SKY, "diamond", "delivered"]);
    }
    if (this.track.scene.stations.length) entries.push([SKY, "square", "ground station"]);
    if (tracks.some((track) => track.links.start.length)) entries.push([ORANGE, "line", "communication"]);
    if (this.recording.satellites.some(({ instrument }) => instrument?.half_angle)) entries.push([GREEN, "ring", "field of view, in the color of the action"]);
    const item = ([color, shape, text]) =>
      make("li", {}, make("span", { className: `mark ${shape}`, style: { background: color, borderColor: color } }), text);
    byId("legend").replaceChildren(...entries.map(item));
    byId("modes").replaceChildren(...this.#modes().map(([text, color]) => item([color, "square", text])));
  }

  /** Actions in the timeline with their colors; numbered ones, such as images of targets, are one. */
  #modes() {
    const names = this.recording.satellites.flatMap((satellite, s) => satellite.actions.map((_, action) => [this.recording.actionName(s, action), action]));
    const modes = new Map(names.map(([name, action]) => [name.replace(/ \d+$/, ""), actionColor(name, action)]));
    return modes.size > 8 ? [] : [...modes];
  }

  /** Start as the address says: #t=1200&satellite=3&view=map&track=2&compare=1&follow=1&play=1. */
  #restore() {
    const wanted = new URLSearchParams(window.location.hash.slice(1));
    const whole = (name, count) => Math.min(Math.max(Math.trunc(Number(wanted.get(name)) || 0), 0), count - 1);
    if (wanted.has("track")) this.track = this.recording.tracks[whole("track", this.recording.tracks.length)];
    if (wanted.has("satellite")) this.satellite = whole("satellite", this.recording.satellites.length);
    this.time = Math.min(Math.max(Number(wanted.get("t")) || 0, 0), this.track.duration);
    this.stage.face(this.track, this.satellite, this.time);
    this.viewChosen = ["globe", "map", "hill"].includes(wanted.get("view"));
    if (this.viewChosen) this.setView(wanted.get("view"));
    if (wanted.get("compare")) this.compare(true);
    if (wanted.get("follow")) this.setFollow(true);
    if (wanted.get("play")) this.play(true);
  }
}

const viewer = new Viewer(json("settings"), json("land"));

/** For tests and for pages that embed this one: times in s, places on the screen in CSS pixels of the scene. */
window.bskViewer = {
  ready: viewer.ready,
  viewer,
  seek: (t) => {
    viewer.seek(t);
    viewer.draw();
  },
  state: () => {
    const { time, view, playing, satellite, target, track, speed, failed, drawn } = viewer;
    if (!track) return { failed };
    const layer = viewer.stage.layer(track);
    const project = (place) => (viewer.view === "globe" ? viewer.stage.project(place) : null);
    const ofEarth = (place) => project(place.applyMatrix4(viewer.stage.globe.group.matrix));
    return {
      time, view, playing, satellite, target, speed, failed, drawn, track: track.index, comparing: viewer.comparing,
      camera: viewer.stage.camera.position.toArray().map((x) => x * RADIUS),
      satellites: layer.places.map((place) => project(place)),
      below: layer.places.map((place) => project(place.clone().normalize())),
      targets: (indices) => indices.map((j) => project(viewer.stage.targetPlace(layer, j))),
      subSolar: project(new Vector3(...track.sun)),
      ground: (x, y, z) => ofEarth(new Vector3(x, y, z).normalize()),
    };
  },
};
