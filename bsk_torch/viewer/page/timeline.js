// The timeline: decisions of all satellites, resources and intervals of the selected one, rewards and deaths; it is the scrubber.

import { number } from "viewer/dom";
import { interval } from "viewer/interpolate";
import { SKY, TRACKS, YELLOW, actionColor } from "viewer/palette";

const LEFT = 92; // CSS pixels for the names of lanes
const LEFT_NARROW = 62;
const RIGHT = 42; // for the scales of lanes
const RIGHT_NARROW = 10;
const AXIS = 20; // height of the axis of time
const STEPS = [1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 43200, 86400];

/** Time since reset as h:mm:ss. */
export function clock(t) {
  const whole = Math.max(0, Math.round(t));
  const [h, m, s] = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60, whole % 60];
  return `${h}:${String(m).padStart(2, "0")}:${String(s).padStart(2, "0")}`;
}

export class Timeline {
  constructor(canvas, playhead, { seek, select }) {
    Object.assign(this, { playhead, canvas, seek, select, pen: canvas.getContext("2d") });
    this.window = null; // [start, end] of the shown time, s; null: all of it
    canvas.addEventListener("pointerdown", (event) => this.#down(event));
    canvas.addEventListener("pointermove", (event) => this.dragging && this.#scrub(event));
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => (this.dragging = false));
    canvas.addEventListener("wheel", (event) => this.#zoom(event), { passive: false });
  }

  /** Lanes from top to bottom, for a state: {name, height, draw(y, height), satellite?}. */
  #lanes(state) {
    const { track, satellite } = state;
    const many = track.count;
    const row = many > 24 ? 5 : many > 6 ? 9 : many > 1 ? 13 : 20;
    const lanes = [];
    for (let s = 0; s < many; s++) {
      const name = many > 12 && s !== satellite ? "" : state.recording.satellites[s].name;
      lanes.push({ name, height: row, satellite: s, draw: (y, h) => this.#decisions(state, s, y, h), chosen: s === satellite });
    }
    for (const [k, ghost] of state.ghosts.entries()) {
      const other = { ...state, track: ghost };
      const color = TRACKS[(k + 1) % TRACKS.length];
      lanes.push({ name: `${ghost.index + 1}: ${ghost.label}`, height: Math.max(row, 9), color, draw: (y, h) => this.#decisions(other, satellite, y, h) });
    }
    lanes.push({ gap: 5 });
    const intervals = [["eclipse", track.eclipses[satellite], this.style("--eclipse")], ["pass", track.passes[satellite], SKY]];
    for (const [name, list, color] of intervals) {
      if (list.length) lanes.push({ name, height: 9, draw: (y, h) => this.#intervals(list, color, y, h) });
    }
    track.series.forEach((series, n) => {
      if (!track.hasSeries(satellite, n) || (series.name === "sunlit" && track.eclipses[satellite].length)) return;
      lanes.push({ name: series.label, height: many > 6 ? 23 : 30, draw: (y, h) => this.#series(state, n, y, h), scale: (y, h) => this.#scale(state, n, y, h) });
    });
    return lanes;
  }

  style(name) {
    return getComputedStyle(this.canvas).getPropertyValue(name).trim();
  }

  x(t) {
    const [start, end] = this.range;
    return this.left + ((t - start) / (end - start)) * (this.width - this.left - this.right);
  }

  time(x) {
    const [start, end] = this.range;
    return start + ((x - this.left) / (this.width - this.left - this.right)) * (end - start);
  }

  /** Height in CSS pixels that the lanes of a state need. */
  height(state) {
    const key = JSON.stringify([state.track.index, state.satellite, state.ghosts.map((g) => g.index), state.version]);
    if (key === this.fitted) return this.needed;
    this.fitted = key;
    return (this.needed = this.#lanes(state).reduce((sum, lane) => sum + (lane.gap ?? lane.height + 2), AXIS + 4));
  }

  draw(state) {
    const { canvas, pen } = this;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    this.whole = Math.max(state.track.duration, ...state.ghosts.map((ghost) => ghost.duration), 1);
    this.range = this.window ?? [0, this.whole];
    this.#follow(state);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    const key = JSON.stringify([state.track.index, state.satellite, this.range, width, height, ratio, state.ghosts.map((g) => g.index), state.dark, state.version]);
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    Object.assign(this, { width, tall: height, left: width < 560 ? LEFT_NARROW : LEFT, right: width < 560 ? RIGHT_NARROW : RIGHT });
    if (key !== this.key) this.#drawLanes(state, ratio);
    this.key = key;
    const x = this.x(state.time);
    this.playhead.hidden = x < this.left - 1;
    this.playhead.style.transform = `translateX(${x}px)`; // an element over the canvas, which is not drawn again
  }

  #drawLanes(state, ratio) {
    this.pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.pen.clearRect(0, 0, this.width, this.tall);
    this.#axis();
    this.lanes = this.#lanes(state);
    let y = AXIS + 2;
    for (const lane of this.lanes) {
      if (lane.gap) {
        y += lane.gap;
        continue;
      }
      lane.y = y;
      this.#name(lane, y);
      this.pen.save();
      this.pen.beginPath();
      this.pen.rect(this.left, y - 1, this.width - this.left - this.right + 1, lane.height + 2);
      this.pen.clip();
      lane.draw(y, lane.height);
      this.pen.restore();
      if (this.right === RIGHT) lane.scale?.(y, lane.height);
      y += lane.height + 2;
    }
    this.#branches(state);
    this.#deaths(state);
  }

  #axis() {
    const { pen } = this;
    const [start, end] = this.range;
    const room = (this.width - this.left - this.right) / 74;
    const step = STEPS.find((one) => (end - start) / one <= room) ?? STEPS.at(-1);
    pen.font = "11px system-ui, sans-serif";
    pen.textBaseline = "middle";
    for (let t = Math.ceil(start / step) * step; t <= end; t += step) {
      const x = this.x(t);
      pen.fillStyle = this.style("--line");
      pen.fillRect(Math.round(x), AXIS - 4, 1, this.tall);
      pen.fillStyle = this.style("--soft");
      pen.textAlign = x < this.left + 14 ? "left" : x > this.width - 30 ? "right" : "center";
      pen.fillText(clock(t), x, 8);
    }
  }

  #name({ name, height, chosen, color }, y) {
    const { pen } = this;
    if (!name) return;
    pen.font = `${chosen ? 600 : 400} ${height < 12 ? 9.5 : 11}px system-ui, sans-serif`;
    pen.fillStyle = this.style(chosen ? "--ink" : "--soft");
    if (color) {
      pen.save();
      pen.fillStyle = color;
      pen.fillRect(0, y, 3, height);
      pen.restore();
    }
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    let text = name;
    while (text.length > 1 && pen.measureText(text).width > this.left - 10) text = `${text.slice(0, -2)}…`;
    pen.fillText(text, this.left - 6, y + height / 2 + 0.5);
  }

  #decisions(state, s, y, h) {
    const { pen } = this;
    const { of, end, action } = state.track.decisions;
    const name = (d) => state.recording.actionName(s, action[d]);
    const [from, to] = this.range;
    const { times, indices } = of[s];
    pen.font = "10.5px system-ui, sans-serif";
    pen.textBaseline = "middle";
    pen.textAlign = "left";
    for (let k = times.length ? interval(times, from) : 0; k < times.length && times[k] <= to; k++) {
      const d = indices[k];
      const until = Math.min(Number.isFinite(end[d]) ? end[d] : state.track.duration, times[k + 1] ?? Infinity);
      const [a, b] = [this.x(times[k]), this.x(until)];
      const width = Math.max(b - a, 0.6);
      pen.fillStyle = actionColor(name(d), action[d]);
      pen.globalAlpha = s === state.satellite ? 0.95 : 0.55;
      pen.fillRect(a, y, width > 3 ? width - 1 : width, h);
      pen.globalAlpha = 1;
      const label = name(d);
      if (h >= 13 && width > 26 && pen.measureText(label).width < width - 8) {
        pen.fillStyle = "#10141c";
        pen.fillText(label, a + 4, y + h / 2 + 0.5);
      }
    }
  }

  #intervals(list, color, y, h) {
    this.pen.fillStyle = color;
    for (const [start, end] of list) this.pen.fillRect(this.x(start), y, Math.max(this.x(end) - this.x(start), 1), h);
  }

  #series(state, n, y, h) {
    const tracks = [...state.ghosts.map((track, k) => [track, TRACKS[(k + 1) % TRACKS.length]]), [state.track, this.style("--ink")]];
    const [low, high] = bounds(tracks.map(([track]) => track), state.satellite, n);
    const { pen } = this;
    pen.fillStyle = this.style("--lane");
    pen.fillRect(this.left, y, this.width - this.left - this.right, h);
    const { bad } = state.track.series[n];
    if (bad && low === 0 && high === 1) {
      pen.fillStyle = this.style("--bad");
      pen.fillRect(this.left, bad === "high" ? y : y + 0.8 * h, this.width - this.left - this.right, 0.2 * h);
    }
    for (const [track, color] of tracks) {
      if (n >= track.series.length) continue;
      this.#curve(track, state.satellite, n, color, (value) => y + h - 1 - ((value - low) / (high - low)) * (h - 2));
    }
  }

  /** Values at the top and at the bottom of a lane, at its right. */
  #scale(state, n, y, h) {
    const { pen } = this;
    const share = isShare(state.track, n);
    const [low, high] = bounds([state.track, ...state.ghosts], state.satellite, n);
    pen.font = "9.5px system-ui, sans-serif";
    pen.fillStyle = this.style("--soft");
    pen.textAlign = "left";
    for (const [value, at] of [[high, y + 6], [low, y + h - 4]]) pen.fillText(share ? `${100 * value} %` : number(value), this.width - this.right + 5, at);
  }

  #curve(track, s, n, color, place) {
    const { pen } = this;
    const { seriesTimes: times, seriesValues: values, count } = track;
    const width = track.series.length;
    const first = times.length > 1 ? interval(times, this.range[0]) : 0;
    const step = Math.max(1, Math.floor((times.length - first) / 4000));
    pen.strokeStyle = color;
    pen.lineWidth = 1.3;
    pen.lineJoin = "round";
    pen.beginPath();
    let drawn = false;
    for (let k = first; k < times.length && times[k] <= this.range[1] + 60; k += step) {
      const value = values[(k * count + s) * width + n];
      if (Number.isFinite(value)) pen[drawn ? "lineTo" : "moveTo"](this.x(times[k]), place(value));
      drawn = Number.isFinite(value);
    }
    pen.stroke();
  }

  /** A dashed line where a flight leaves the one that it repeats until then. */
  #branches(state) {
    const { pen } = this;
    for (const track of [state.track, ...state.ghosts]) {
      const x = track.branch ? this.x(track.branch.time) : -1;
      if (x < this.left || x > this.width - this.right) continue;
      pen.strokeStyle = this.style("--ink");
      pen.lineWidth = 1;
      pen.setLineDash([2, 3]);
      pen.beginPath();
      pen.moveTo(x, AXIS - 2);
      pen.lineTo(x, this.tall);
      pen.stroke();
      pen.setLineDash([]);
    }
  }

  #deaths(state) {
    const { pen } = this;
    for (const death of state.track.deaths) {
      const x = this.x(death.time);
      const lane = this.lanes.find((one) => one.satellite === death.satellite);
      if (!lane || x < this.left - 1 || x > this.width) continue;
      const y = lane.y + lane.height / 2;
      pen.strokeStyle = this.style("--alarm");
      pen.lineWidth = 2.5;
      pen.beginPath();
      for (const sign of [-1, 1]) {
        pen.moveTo(x - 4.5, y - 4.5 * sign);
        pen.lineTo(x + 4.5, y + 4.5 * sign);
      }
      pen.stroke();
    }
  }

  /** Keep the playhead in a part of the flight that is shown larger. */
  #follow(state) {
    if (!this.window || (state.time >= this.range[0] && state.time <= this.range[1])) return;
    const span = this.range[1] - this.range[0];
    const start = Math.min(Math.max(state.time - 0.1 * span, 0), this.whole - span);
    this.window = this.range = [start, start + span];
  }

  #down(event) {
    const y = event.offsetY;
    const lane = this.lanes?.find((one) => one.satellite !== undefined && y >= one.y && y < one.y + one.height + 2);
    if (lane) this.select(lane.satellite);
    if (event.offsetX < this.left) return;
    this.canvas.setPointerCapture(event.pointerId);
    this.dragging = true;
    this.#scrub(event);
  }

  #scrub(event) {
    this.seek(Math.min(Math.max(this.time(event.offsetX), 0), this.whole));
  }

  #zoom(event) {
    if (!event.ctrlKey && !event.shiftKey && Math.abs(event.deltaX) < Math.abs(event.deltaY) && !event.altKey) return; // the page scrolls
    event.preventDefault();
    this.scale(Math.exp((event.deltaY || event.deltaX) * 0.004), this.time(event.offsetX));
  }

  /** Show `factor` times as much time around t. */
  scale(factor, t) {
    const [start, end] = this.range;
    const span = Math.min(Math.max((end - start) * factor, 60), this.whole);
    const share = Math.min(Math.max((t - start) / (end - start), 0), 1);
    const from = Math.min(Math.max(t - share * span, 0), this.whole - span);
    this.window = span >= this.whole ? null : [from, from + span];
    this.seek(null);
  }
}

/** Least and largest value of a series; 0 and 1 for what lies between them. */
export function bounds(tracks, s, n) {
  let [low, high] = [0, 0];
  for (const track of tracks) {
    const width = track.series.length;
    for (let k = 0; k < track.seriesTimes.length; k++) {
      const value = track.seriesValues[(k * track.count + s) * width + n];
      if (value < low) low = value;
      if (value > high) high = value;
    }
  }
  const sum = /reward|return/.test(tracks[0].series[n].name); // not a level between 0 and 1
  if (!sum && low >= 0 && high <= 1.0001) return [0, 1];
  return high > low ? [low, high] : [low, low + 1];
}

/** Whether all values of a series lie from 0 to 1, and it is a level rather than a sum. */
export function isShare(track, n) {
  track.shares ??= track.series.map((series, k) => {
    if (/reward|return/.test(series.name)) return false;
    const width = track.series.length;
    for (let j = k; j < track.seriesValues.length; j += width) if (track.seriesValues[j] > 1.001 || track.seriesValues[j] < -1e-6) return false;
    return true;
  });
  return track.shares[n];
}
