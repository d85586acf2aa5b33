// Draws frames of every view without a browser: canvases keep what is drawn on them, and the globe's renderer what it is given.
// Usage: node first_frames.mjs FOLDER_OF_THE_PAGE RECORDING TIMES; prints JSON, for every time the first and a second frame.

import { readFileSync } from "node:fs";
import { register } from "node:module";
import { pathToFileURL } from "node:url";

const [, , folder, recordingFile, times] = process.argv;
const page = pathToFileURL(`${folder}/`).href;
const asModule = (text) => `data:text/javascript,${encodeURIComponent(text)}`;
const THREE = asModule(`
  export * from "${page}vendor/three.js";
  const nothing = new Proxy(() => nothing, { get: () => nothing });
  export const rendered = [];
  export function WebGLRenderer() {
    return new Proxy(this, { get: (_, name) => (name === "render" ? (scene, camera) => rendered.push({ scene, camera }) : nothing), set: () => true });
  }`);
register(asModule(`
  export const resolve = (name, context, next) =>
    name === "three" ? { url: ${JSON.stringify(THREE)}, shortCircuit: true }
    : name.startsWith("viewer/") ? { url: "${page}" + name.slice(7) + ".js", format: "module", shortCircuit: true }
    : name.endsWith("vendor/three.js") ? { url: name, format: "module", shortCircuit: true }
    : next(name, context);`));

/** A canvas whose pen keeps circles and texts, [x, y]. */
function canvas(width = 1200, height = 800) {
  const drawn = { circles: [], texts: [] };
  const keep = {
    arc: (x, y) => drawn.circles.push([x, y]),
    fillText: (text, x, y) => drawn.texts.push([text, x, y]),
    measureText: (text) => ({ width: 7 * text.length }),
    createRadialGradient: () => ({ addColorStop() {} }),
  };
  const pen = new Proxy({}, { get: (_, name) => keep[name] ?? (() => {}), set: () => true });
  return { drawn, clientWidth: width, clientHeight: height, width, height, getContext: () => pen, addEventListener() {} };
}

globalThis.window = { devicePixelRatio: 1 };
globalThis.document = { createElement: () => canvas() };
globalThis.Path2D = class { moveTo() {} lineTo() {} closePath() {} };

const [{ rendered }, { decode }, { Recording }, { WorldMap }, { HillView }, { Stage }] = await Promise.all(
  ["three", "viewer/decode", "viewer/flight", "viewer/map", "viewer/hill", "viewer/stage"].map((name) => import(name)),
);
const land = { coordinates: [] };
const show = { orbits: true, instruments: true, links: true, targets: true, stations: true, cones: false, axes: true, labels: true };

const views = {
  map: (overlay) => {
    const map = new WorldMap(overlay, land);
    const degrees = ([x, y]) => [360 * ((x - map.left) / map.width - 0.5), 180 * (0.5 - (y - map.top) / map.height)];
    return { draw: (state) => map.draw(state), shown: () => ({ circles: overlay.drawn.circles.map(degrees), texts: overlay.drawn.texts }) };
  },
  hill: (overlay) => {
    const hill = new HillView(overlay);
    return { draw: (state) => hill.draw(state), shown: () => overlay.drawn };
  },
  globe: (overlay, recording) => {
    const stage = new Stage(canvas(), overlay, land, () => {});
    stage.reset(recording);
    const seen = (track) => {
      const { earth, crafts } = { earth: stage.globe.group.matrix.elements, crafts: stage.layer(track).places };
      return { earth: Array.from(earth), crafts: crafts.map((place) => place.toArray()), camera: rendered.at(-1).camera.matrixWorld.elements.slice() };
    };
    return { draw: (state) => stage.draw(state), shown: (state) => ({ ...seen(state.track), texts: overlay.drawn.texts }) };
  },
};

const found = {};
for (const t of times.split(",").map(Number)) {
  for (const [name, make] of Object.entries(views)) {
    const recording = new Recording(await decode(new Uint8Array(readFileSync(recordingFile))));
    const [track, ...others] = recording.tracks;
    const state = { recording, track, time: t, satellite: 0, target: -1, follow: false, frame: "inertial", ghosts: others, side: [], show, flash: 0 };
    const overlay = canvas();
    const view = make(overlay, recording);
    found[`${name} ${t}`] = [0, 1].map(() => {
      Object.assign(overlay.drawn, { circles: [], texts: [] });
      view.draw(state);
      return JSON.parse(JSON.stringify(view.shown(state)));
    });
  }
}
console.log(JSON.stringify(found));
