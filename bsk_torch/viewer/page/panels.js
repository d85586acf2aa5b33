// What the selected satellite does, has, observes and could do instead.

import { make, number } from "viewer/dom";
import { actionColor } from "viewer/palette";
import { clock, isShare } from "viewer/timeline";

const LIMITS = { low: 0.2, high: 0.8 }; // shares from which on a resource is shown as an alarm

export class Panels {
  constructor(root, actions) {
    Object.assign(this, { root, actions });
    this.key = null;
  }

  /** Show a state; parts that depend only on the decision are built again only when it changes. */
  draw(state) {
    const { track, satellite } = state;
    const decision = track.decisionAt(satellite, state.time);
    const key = JSON.stringify([track.index, satellite, decision, state.version, state.busy]);
    if (key !== this.key) this.#build(state, decision);
    this.key = key;
    this.#doing(state, decision);
    this.#gauges(state);
    this.#episode(state);
  }

  #build(state, decision) {
    const open = this.root.querySelector("details")?.open ?? false;
    this.now = make("div");
    this.resources = make("div", { className: "panel" }, make("h2", {}, "Resources"));
    this.bars = state.track.series.map((series) => {
      const bar = make("i");
      const value = make("b");
      const row = make("div", { className: "gauge" }, make("span", {}, series.label), value, make("div", { className: "bar" }, bar));
      this.resources.append(row);
      return { row, bar, value };
    });
    this.sums = make("div", { className: "panel" });
    this.root.replaceChildren(
      make("div", { className: "panel" }, this.#picker(state), this.now),
      this.resources,
      this.#decision(state, decision),
      this.#observation(state, decision, open),
      this.sums,
    );
    const line = this.root.querySelector(".decision .chosen");
    const list = line?.closest(".scroll");
    if (list) list.scrollTop = line.offsetTop - list.clientHeight / 2; // only in the list: the page stays where it is
  }

  #picker(state) {
    const options = state.recording.satellites.map((craft, s) => make("option", { value: s, selected: s === state.satellite }, craft.name));
    const select = make("select", { "aria-label": "Satellite" }, ...options);
    select.addEventListener("change", () => this.actions.select(Number(select.value)));
    const step = (by, sign, label) => {
      const button = make("button", { type: "button", "aria-label": label, title: label }, sign);
      button.addEventListener("click", () => this.actions.select((state.satellite + by + options.length) % options.length));
      return button;
    };
    return make("div", { className: "pick" }, step(-1, "‹", "Previous satellite"), select, step(1, "›", "Next satellite"));
  }

  #doing(state, d) {
    const { track, satellite, time, recording } = state;
    const death = track.deathOf.get(satellite);
    const parts = [];
    if (d >= 0 && track.isAlive(satellite, time)) {
      const { action, target, end } = track.decisions;
      const label = recording.actionName(satellite, action[d]);
      const priority = track.scene.priority[target[d]];
      const aim = target[d] >= 0 ? ` · ${recording.targetName(target[d], track.scene)}${priority > 0 ? `, priority ${priority.toFixed(2)}` : ""}` : "";
      const left = end[d] - time;
      const mark = make("span", { className: "mark square", style: { background: actionColor(label, action[d]) } });
      const rest = left > 0 && Number.isFinite(left) ? `${clock(left)} left` : "";
      parts.push(make("div", { className: "doing" }, mark, make("b", {}, label + aim), make("span", {}, rest)));
    }
    if (death && death.time <= time + 1e-6) {
      parts.push(make("p", { className: "dead" }, `Dead since ${clock(death.time)}: ${death.causes.join(", ")}`));
    }
    this.now.replaceChildren(...parts);
  }

  #gauges({ track, satellite, time }) {
    let any = false;
    track.series.forEach((series, n) => {
      const value = track.seriesAt(satellite, n, Math.min(time, track.duration));
      const { row, bar, value: text } = this.bars[n];
      const share = isShare(track, n);
      row.hidden = !Number.isFinite(value);
      any ||= !row.hidden;
      text.textContent = share ? `${(100 * value).toFixed(0)} %` : number(value);
      bar.parentElement.hidden = !share;
      bar.style.width = `${Math.min(Math.max(100 * value, 0), 100)}%`;
      row.classList.toggle("bad", share && (series.bad === "low" ? value < LIMITS.low : series.bad === "high" && value > LIMITS.high));
    });
    this.resources.hidden = !any;
  }

  #decision(state, d) {
    const { track, satellite, recording } = state;
    const own = track.decisions.of[satellite];
    if (d < 0) return make("div", { className: "panel" }, make("h2", {}, "Decision"), make("p", { className: "note" }, "None until now."));
    const { actions, controls } = recording.satellites[satellite];
    const title = `Decision ${own.indices.indexOf(d) + 1} of ${own.indices.length}`;
    const head = make("h2", {}, title, make("span", {}, `at ${clock(track.decisions.time[d])}`));
    const panel = make("div", { className: "panel decision" }, head);
    panel.append(actions.length ? this.#actionTable(state, d, actions) : this.#controlTable(track, d, controls ?? []));
    const told = actions.length ? opinion(track.decisions, d, state.said) : "";
    if (told) panel.append(make("p", { className: "note opinion" }, told));
    panel.append(make("p", { className: "note" }, `Reward of this step: ${number(track.decisions.reward[d])}.`));
    if (state.live) panel.append(this.#liveTools(state, d));
    return panel;
  }

  #actionTable(state, d, actions) {
    const { decisions } = state.track;
    const row = (array) => rowOf(array, d);
    const [mask, probability, values] = [row(decisions.mask), row(decisions.probability), row(decisions.actionValue)];
    const chances = probability.some(Number.isFinite);
    const flown = values.some(Number.isFinite);
    const best = flown ? Math.max(...values.filter(Number.isFinite)) : NaN;
    const headings = ["action", chances ? "policy" : null, flown ? "value" : null, state.live ? "" : null].filter((x) => x !== null);
    const table = make("table", {}, make("tr", {}, ...headings.map((text) => make("th", { scope: "col" }, text))));
    actions.forEach((_, a) => {
      const label = state.recording.actionName(state.satellite, a);
      const allowed = mask[a] === 1;
      const chosen = a === decisions.action[d];
      const cells = [make("td", {}, label, offer(state, d, a))];
      if (chances) cells.push(chanceCell(probability[a], allowed));
      if (flown) cells.push(make("td", { className: values[a] === best ? "best" : "" }, number(values[a])));
      if (state.live) cells.push(make("td", {}, allowed && !chosen ? this.#flyButton(state, d, a, label) : chosen ? "flown" : ""));
      const line = make("tr", { className: `${chosen ? "chosen" : ""} ${allowed ? "" : "masked"}`.trim() }, ...cells);
      if (!allowed) line.title = "The mask does not allow this action here";
      table.append(line);
    });
    return make("div", { className: "scroll" }, table);
  }

  #controlTable(track, d, controls) {
    const { control } = track.decisions;
    const rows = controls.map((name, c) => make("tr", {}, make("td", {}, name), make("td", {}, number(control.data[d * controls.length + c]))));
    return make("table", {}, ...rows);
  }

  #flyButton(state, d, a, label) {
    const button = make("button", { type: "button", disabled: state.busy, title: `Fly on with: ${label}` }, "fly");
    button.addEventListener("click", () => this.actions.branch(d, a));
    return button;
  }

  #liveTools(state, d) {
    const ask = make("button", { type: "button", disabled: state.busy, id: "values" }, "Values of all actions");
    ask.addEventListener("click", () => this.actions.values(d));
    const episode = make("button", { type: "button", disabled: state.busy, id: "episode" }, "Another episode");
    episode.addEventListener("click", () => this.actions.episode());
    const note = state.busy || state.said;
    return make("div", { className: "live" }, ask, episode, note ? make("p", { className: "note", role: "status" }, note) : null);
  }

  #observation(state, d, open) {
    const { observation, recording, satellite } = { ...state, observation: state.track.observation };
    const names = recording.satellites[satellite].observation;
    const width = observation.shape[1] ?? 0;
    const rows = d < 0 ? [] : names.map((name, k) => make("tr", {}, make("td", {}, name), make("td", {}, number(observation.data[d * width + k]))));
    const title = `Observation at the decision (${names.length})`;
    const body = make("div", { className: "scroll" }, make("table", {}, ...rows));
    return make("details", { className: "panel", open, hidden: !rows.length }, make("summary", {}, title), body);
  }

  #episode({ track, recording }) {
    if (this.sums.dataset.track === String(track.index)) return;
    this.sums.dataset.track = track.index;
    const list = make("dl", { className: "counts" });
    const line = (name, value) => list.append(make("dt", {}, name), make("dd", {}, value));
    line("return", number(track.total));
    line("length", clock(track.duration));
    for (const [name, count] of Object.entries(track.counts)) line(name.replaceAll("_", " "), String(count));
    this.sums.replaceChildren(make("h2", {}, "Flight"), list);
    for (const death of track.deaths) {
      const text = `${recording.satellites[death.satellite].name} died at ${clock(death.time)}: ${death.causes.join(", ")}`;
      const button = make("button", { type: "button", className: "link" }, text);
      button.addEventListener("click", () => this.actions.visit(death.satellite, death.time));
      this.sums.append(make("p", {}, button));
    }
  }
}

/** The target of action `a` at decision `d`: its name, its priority, and the time until its window opens; null without one. */
function offer({ recording, track }, d, a) {
  const { targets, opens, time } = track.decisions;
  const target = targets.shape[0] ? rowOf(targets, d)[a] : -1;
  if (!(target >= 0)) return null;
  const priority = track.scene.priority[target];
  const wait = rowOf(opens, d)[a] - time[d];
  const parts = [recording.targetName(target, track.scene)];
  if (priority > 0) parts.push(`priority ${priority.toFixed(2)}`);
  if (Number.isFinite(wait)) parts.push(wait > 0 ? `in ${clock(wait)}` : "now");
  return make("small", {}, parts.join(", "));
}

function rowOf(array, d) {
  return array.data.subarray(d * array.shape[1], (d + 1) * array.shape[1]);
}

/** What the policy has computed for decision d; `said` is what the server has said about values that were asked for. */
function opinion({ probability, actionValue }, d, said) {
  if (rowOf(actionValue, d).some(Number.isFinite)) {
    return said ? "" : "Value: of a planner, the return up to its horizon; of a rule, its ranking; if asked for, the rest of the return.";
  }
  return rowOf(probability, d).some(Number.isFinite) ? "" : "This policy computes neither probabilities nor values of actions.";
}

function chanceCell(chance, allowed) {
  if (!Number.isFinite(chance)) return make("td", {}, allowed ? "–" : "masked");
  const bar = make("span", { className: "share" }, make("i", { style: { width: `${100 * chance}%` } }));
  return make("td", { style: { whiteSpace: "nowrap" } }, allowed ? bar : "", allowed ? `${(100 * chance).toFixed(chance < 0.0995 ? 1 : 0)} %` : "masked");
}
