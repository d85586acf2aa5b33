// The keyboard, and the help that lists it.

import { byId, make } from "viewer/dom";

const KEYS = [
  ["space", "play or pause", [" "], (viewer) => viewer.play()],
  ["← →", "previous or next decision of the selected satellite", ["ArrowLeft", "ArrowRight"], (viewer, key) => viewer.step(key === "ArrowLeft" ? -1 : 1)],
  ["shift ← →", "10 seconds back or forth", [], null],
  ["↑ ↓", "previous or next satellite", ["ArrowUp", "ArrowDown"], (viewer, key) => {
    const count = viewer.recording.satellites.length;
    viewer.select((viewer.satellite + (key === "ArrowUp" ? count - 1 : 1)) % count);
  }],
  ["home, end", "start or end of the flight", ["Home", "End"], (viewer, key) => viewer.seek(key === "Home" ? 0 : viewer.end)],
  ["1 to 9", "flight of that number", [..."123456789"], (viewer, key) => viewer.setTrack(Number(key) - 1)],
  ["C", "draw all flights together, or only one", ["c"], (viewer) => viewer.compare(!viewer.comparing)],
  ["G, M, H", "globe, map, Hill frame", ["g", "m", "h"], (viewer, key) => viewer.setView({ g: "globe", m: "map", h: "hill" }[key])],
  ["F", "follow the selected satellite", ["f"], (viewer) => viewer.setFollow()],
  ["E", "turn with the Earth, or not", ["e"], (viewer) => viewer.setFrame()],
  ["A, D, W, S", "turn the view; drag does it too", ["a", "d", "w", "s"], (viewer, key) => {
    const [azimuth, elevation] = { a: [-0.1, 0], d: [0.1, 0], w: [0, 0.1], s: [0, -0.1] }[key];
    viewer.turn(azimuth, elevation);
  }],
  ["Z, X", "closer, farther; the wheel does it too", ["z", "x"], (viewer, key) => viewer.zoom(key === "z" ? 0.85 : 1 / 0.85)],
  ["+, −", "faster, slower", ["+", "=", "-"], (viewer, key) => viewer.changeSpeed(key === "-" ? -1 : 1)],
  ["?", "this help", ["?"], () => byId("help").showModal()],
];

const WRITES = new Set(["INPUT", "SELECT", "TEXTAREA"]);

/** Let keys act on a viewer, except where an element needs them. */
export function listen(viewer) {
  const list = KEYS.flatMap(([keys, effect]) => [make("dt", {}, keys), make("dd", {}, effect)]);
  const more = "Click a satellite or a target to select it. In the timeline, click or drag to move in time; with shift or ctrl, the wheel shows more or less time.";
  byId("help").append(make("h2", {}, "Keys"), make("dl", {}, ...list), make("p", { className: "note" }, more));
  byId("help-button").addEventListener("click", () => byId("help").showModal());
  document.addEventListener("keydown", (event) => {
    const { tagName } = event.target;
    if (event.ctrlKey || event.metaKey || event.altKey || byId("help").open) return;
    if (WRITES.has(tagName) || (event.key === " " && (tagName === "BUTTON" || tagName === "SUMMARY"))) return;
    if (event.shiftKey && event.key.startsWith("Arrow")) {
      event.preventDefault();
      viewer.seek(viewer.time + { ArrowLeft: -10, ArrowRight: 10, ArrowUp: 60, ArrowDown: -60 }[event.key]);
      return;
    }
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const found = KEYS.find(([, , keys]) => keys.includes(key));
    if (!found) return;
    event.preventDefault();
    found[3](viewer, key);
  });
}
