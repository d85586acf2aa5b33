"""Tables of policies, planners and what they learn from."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from docs._ext.markdown import code, digits, table, whole
from docs._ext.results import ROOT, load, made, spread, with_command


def pretrained() -> str:
    """Return how the policies of the package were made, and what they reach."""
    makings = json.loads((ROOT / "bsk_torch" / "rl" / "policies" / "policies.json").read_text())
    rows = []
    for preset, made_by in makings.items():
        score = made_by["score"]
        minutes, seconds = divmod(round(made_by["seconds"]), 60)
        reached = f"{score['return']:.3f} ±\u00a0{score['half_width']:.3f}"
        time = f"{minutes} min {seconds} s"
        rows.append([code(preset), code(made_by["command"]), whole(made_by["frames"]), time, reached, f"{score['survival']:.1%}"])
    machines = sorted({entry["machine"] for entry in makings.values()})
    episodes = {entry["score"]["episodes"] for entry in makings.values()}
    note = f"Returns of {', '.join(map(str, episodes))} unseen episodes. Trained on: {'; '.join(machines)}."
    return f"{table(['preset', 'command', 'decisions', 'wall time', 'return', 'survival'], rows)}\n\n{note}\n"


def pretrained_short() -> str:
    """Return what the policies of the package reach, and how long their training took."""
    makings = json.loads((ROOT / "bsk_torch" / "rl" / "policies" / "policies.json").read_text())
    rows = []
    for preset, made_by in makings.items():
        score = made_by["score"]
        reached = f"{score['return']:.2f} ± {score['half_width']:.2f}"
        cells = [whole(made_by["frames"]), f"{made_by['seconds'] / 60.0:.0f} min", reached, f"{score['survival']:.1%}"]
        rows.append([code(preset), *cells])
    return f"{table(['preset', 'decisions in training', 'time', 'return', 'survival'], rows)}\n"


def inspections(*names: str) -> str:
    """Return the results of rules and trained policies in the presets of inspection, a table for each preset."""
    head = ["policy, actions", "complete", "hours", "fuel, m/s", "inspected", "lit", "inspectors died", "collisions"]
    parts = []
    for name in names:
        rows, [preset] = [], {row["preset"] for row in load(name)["rows"]}
        for row in load(name)["rows"]:
            share, low, high = (100.0 * value for value in (row["complete"], *row["complete_interval"]))
            rows.append(
                [
                    f"{player(row)}, {row['actions']}",
                    f"{share:.1f} % ({low:.1f} to {high:.1f})",
                    f"{row['hours']:.2f}" if share else "-",
                    f"{row['fuel']:.2f}",
                    f"{row['inspected']:.1f}",
                    f"{row['lit']:.1f}",
                    f"{100.0 * row['died']:.1f} %",
                    str(row["collisions"]),
                    f"{row['value']:.3f} ±\u00a0{row['half']:.3f}",
                    f"{row['gain']:+.3f} ±\u00a0{row['gain_half']:.3f}" if "gain" in row else "-",
                ]
            )
        parts += [f"### {preset}", table([*head, "return", "gain over survey"], rows), made(name)]
    return "\n\n".join(parts)


def player(row: Mapping[str, Any]) -> str:
    """Return the name of a rule, or that of a training with its length."""
    if "frames" not in row:
        return Path(row["policy"]).name
    minutes, seconds = divmod(round(row["seconds"]), 60)
    return f"trained ({Path(row['policy']).name}, {whole(row['frames'])} steps, {minutes} min {seconds} s)"


def safe_autonomy(*names: str) -> str:
    """Return the results of rules with and without run-time assurance in the presets of linear motion, and the speeds."""
    rows, rates = [], []
    for name in names:
        for row in load(name)["rows"]:
            rows.append(
                [
                    row["preset"],
                    f"{row['policy']}, {'no filter' if row['filter'] == 'none' else row['filter']}",
                    f"{100.0 * row['success']:.1f} %",
                    f"{100.0 * row['inspected']:.2f} %" if "inspected" in row else "-",
                    f"{100.0 * row['crashed']:.1f} %",
                    f"{row['speeding']:.2f}",
                    f"{row['blinded']:.1f}" if "blinded" in row else "-",
                    f"{row['interventions']:.1f}" if "interventions" in row else "-",
                    f"{row['value']:.3f} ±\u00a0{row['half']:.3f}",
                ]
            )
        for row in load(name)["rates"]:
            spread = " to ".join(whole(row[key]) for key in ("rate_low", "rate_high"))
            rates.append([row["preset"], row["side"], whole(row["batch"]), f"{whole(row['rate'])} ({spread})"])
    head = [
        "preset",
        "policy",
        "success",
        "inspected, IQM",
        "crashed",
        "above the safe speed",
        "blinded",
        "interventions",
        "return",
    ]
    parts = [table(head, rows)]
    if rates:
        parts.append(table(["preset", "program", "episodes at once", "decisions per core-s"], rates))
    return "\n\n".join([*parts, *(made(name) for name in names)])


def thruster_rules(*names: str) -> str:
    """Return what the rules of linear motion and policies return, and how far below an upper bound they are."""
    rows, tunings = [], []
    for content in map(load, names):
        tuning = content["tuning"]
        numbers = ", ".join(f"{key} {value:.3g}" for key, value in tuning["thresholds"].items())
        spent = f"{tuning['episodes']:,} episodes and {tuning['core_seconds']:.0f} core-seconds"
        tunings.append(f"Numbers of the tuned rule of `{content['options']['preset']}`, after {spent}: {numbers}.")
        for row in content["rows"]:
            gain = f"{row['gain']:+.4f} ±\u00a0{row['gain_half']:.4f}" if row["gain"] else "-"
            share = f"{row['share']:+.4f} ±\u00a0{row['share_half']:.4f}" if row["gain"] else "-"
            cells = [f"{row['return']:.4f} ±\u00a0{row['half']:.4f}", gain, share]
            rows.append([content["options"]["preset"], row["entrant"], *cells])
        rows.append([content["options"]["preset"], "upper bound", f"{content['bound']:.4f}", "-", f"{content['room']:+.4f}"])
    head = ["preset", "entrant", "return", "minus the tuned rule", "share of the way"]
    return "\n\n".join([table(head, rows), *tunings, *(made(name) for name in names)])


def planners(name: str) -> str:
    """Return what planners gain and cost."""
    head = ["preset", "policy", "return", "gain over the rule", "decisions", "simulated s per decision", "wall s per episode"]
    rows = []
    for row in load(name)["rows"]:
        gain = f"{row['gain']:+.3f} ± {row['gain_half']:.3f} ({row['relative']:+.1%})" if "gain" in row else "-"
        simulated = whole(row["simulated"]) if "simulated" in row else "-"
        value = f"{row['value']:.3f} ± {row['half']:.3f}"
        rows.append([code(row["preset"]), row["policy"], value, gain, whole(row["decisions"]), simulated, digits(row["wall"])])
    return with_command(name, head, rows)


def computation(name: str) -> str:
    """Return what methods gain in a task, with the CPU time of a decision."""
    rows = []
    for row in load(name)["rows"]:
        of_rule = f"{row['relative']:+.1%} ± {row['relative_half']:.1%}" if row["policy"] != "rule" else "-"
        value = f"{row['value']:.3g} ± {row['half']:.2g}"
        seconds = milliseconds(row["seconds"]), milliseconds(row["longest"])
        rows.append([row["policy"], row["size"] or "-", value, of_rule, whole(row["episodes"]), *seconds])
    head = ["policy", "size", "return", "gain over the rule", "episodes", "ms per decision", "longest"]
    return with_command(name, head, rows)


def milliseconds(seconds: float) -> str:
    """Return seconds as milliseconds, in the digits that matter."""
    return digits(1e3 * seconds)


def distillations(name: str) -> str:
    """Return what networks keep of a planner's gain."""
    rows = []
    for row in load(name)["rows"]:
        gain = f"{row['gain']:+.3f} ± {row['gain_half']:.3f}" if row["policy"] != "network" else "-"
        kept = f"{row['share']:.0%} ± {row['share_half']:.0%}" if "training" in row else "-"
        spent = [digits(row[key]) if key in row else "-" for key in ("collecting", "training")]
        learned = whole(row["decisions"]) if "decisions" in row else "-"
        rows.append([code(row["task"]), row["policy"], f"{row['value']:.3f} ± {row['half']:.3f}", gain, kept, learned, *spent])
    head = [
        "task",
        "policy",
        "return",
        "gain over the network",
        "share of the planner's",
        "decisions",
        "collection, core-s",
        "training, core-s",
    ]
    return with_command(name, head, rows)


def by_condition(name: str, what: str) -> str:
    """Return survival or return (``what``) of rules and of trainings with several seeds, by condition."""
    found = load(name)["found"]
    form = "{:.1%}" if what == "survival" else "{:.3f}"
    conditions = list(next(iter(found.values()))[0])
    rows = [
        [training, *(spread([result[condition][what] for result in results], form) for condition in conditions)]
        for training, results in found.items()
    ]
    return f"{table(['policy', *conditions], rows)}\n"


def headroom(name: str) -> str:
    """Return what policies and planners gain over a rule in the same episodes."""
    rows = [
        [
            row["policy"],
            whole(row["episodes"]),
            f"{row['return']:.3f} ±\u00a0{row['half']:.3f}",
            f"{row['gain']:+.3f} ±\u00a0{row['gain_half']:.3f}" if row["gain_half"] else "-",
            f"{row['survival']:.1%} ({row['survival_low']:.1%} to {row['survival_high']:.1%})",
        ]
        for row in load(name)["rows"]
    ]
    return with_command(name, ["policy", "episodes", "return", "gain over cautious", "survival"], rows)


def own_environments() -> str:
    """Return what trainings without settings reach, and random and constant actions."""
    head = [
        "environment",
        "time limit, s",
        "at the limit",
        "random actions",
        "best constant action",
        "trained, each seed",
        "decisions",
    ]
    rows = []
    for row in load("own_environments")["rows"]:
        results = zip(row["trained"], row["half_widths"], strict=True)
        trained = ", ".join(f"{value:.3g} ± {half:.2g}" for value, half in results)
        decisions = whole(max(row["curves"][0]["frames"]))
        rows.append([row["name"], whole(row["limit"]), row["ends"], f"{row['random']:.3g}", row["best"], trained, decisions])
    return with_command("own_environments", head, rows)


def learners() -> str:
    """Return what learners of other libraries reach, by training."""
    rows = [
        [
            row["learner"],
            whole(row["seed"]),
            whole(row["steps"]),
            whole(row["core_seconds"]),
            f"{row['return']['mean']:.3f} ±\u00a0{row['return']['half_width']:.3f}",
            f"{row['gain']['mean']:+.3f} ±\u00a0{row['gain']['half_width']:.3f}",
            f"{row['survival']:.1%}",
        ]
        for row in load("learners")["rows"]
    ]
    head = ["learner", "seed", "decisions", "core-seconds", "return", "gain over the best rule", "survival"]
    return with_command("learners", head, rows)


def suite_learners() -> str:
    """Return what learners of other libraries reach in tasks of the suite v3."""
    within = "{value:.2f} [{low:.2f}, {high:.2f}]"
    rows = [
        [
            code(row["task"]),
            row["learner"],
            whole(row["seeds"]),
            within.format(**row["return"]),
            within.format(**row["gain"]),
            f"{row['survival']:.1%}",
            whole(row["core_seconds"]),
        ]
        for row in load("learners_suite_v3")["summaries"]
    ]
    head = ["task", "learner", "seeds", "return", "minus the rule", "survival", "core-seconds of a training"]
    return with_command("learners_suite_v3", head, rows)


def of_runs(runs: Sequence[Mapping[str, float]], key: str, form: str) -> str:
    """Return the mean of a figure over runs, with the smallest and the largest; a dash if a run has none."""
    if not all(key in run for run in runs):
        return "-"
    values = [run[key] for run in runs]
    mean, low, high = (form.format(value) for value in (sum(values) / len(values), min(values), max(values)))
    return f"{mean} ({low} to {high})"


def off_policy(preset: str) -> str:
    """Return the errors of estimators of a policy's value in a preset, by the behavior whose episodes they have."""
    rows = []
    for row in load("off_policy")["rows"]:
        if row["preset"] == preset:
            forms = {"behavior_return": "{:.2f}", "fitted": "{:+.2f}", "traced": "{:+.2f}", "importance": "{:+.2f}"}
            cells = [of_runs(row["seeds"], key, form) for key, form in (forms | {"effective": "{:.1f}"}).items()]
            rows.append([code(row["behavior"]), *cells])
    head = ["behavior", "its return", "fitted Q", "fitted Q with traces", "importance sampling", "effective episodes"]
    return table(head, rows) + "\n"


def expert_iteration() -> str:
    """Return what training on audited decisions gains, with the command."""
    rows = [
        [
            row["policy"],
            f"{row['return']:.2f} ±\u00a0{row['half']:.2f}",
            f"{row['gain']:+.2f} ±\u00a0{row['gain_half']:.2f}" if row["gain_half"] else "-",
            f"{row['regret']:.3f}" if "regret" in row else "-",
            whole(row["decisions"]) if "decisions" in row else "-",
            whole(row["cpu"]) if row["cpu"] else "-",
            whole(row["episodes"]),
        ]
        for row in load("expert_iteration")["rows"]
    ]
    head = ["policy", "return", "gain", "regret of a decision", "decisions", "core-seconds", "unseen episodes"]
    return with_command("expert_iteration", head, rows)


def action_scores() -> str:
    """Return the scores of estimated action values against the returns of all actions."""
    forms = {"rmse": "{:.2f}", "concordance": "{:.0%}", "regret": "{:.3f}"}
    rows = []
    for row in load("off_policy")["rows"]:
        for label, words in (("fitted", "fitted Q"), ("traced", "with traces")):
            cells = [of_runs(row["seeds"], f"{label}_{key}", form) for key, form in forms.items()]
            rows.append([row["preset"], code(row["behavior"]), words, *cells])
    return table(["preset", "behavior", "estimator", "error of values", "pairs in order", "loss of one decision"], rows) + "\n"


def dataset_sizes() -> str:
    """Return the sizes of datasets and the time to write them, with the command."""
    found: dict[str, list[dict[str, float]]] = {}
    for one in load("off_policy")["sizes"]:
        found.setdefault(one["preset"], []).append(one)
    forms = {"decisions": "{:,.0f}", "sampled": "{:,.0f}", "returns": "{:,.0f}", "megabytes": "{:.1f}", "bytes": "{:,.0f}"}
    rows = []
    for preset, runs in found.items():
        means = {key: sum(run[key] for run in runs) / len(runs) for key in (*forms, "cpu")}
        rows.append([preset, *(form.format(means[key]) for key, form in forms.items()), of_runs(runs, "cpu", "{:.0f}")])
    head = ["preset", "decisions", "sampled", "returns of actions", "MB", "bytes per decision", "core-seconds"]
    return with_command("off_policy", head, rows)


def clouds(name: str) -> str:
    """Return what policies reach under clouds, by what they see of them."""
    rows = []
    for world, policies in load(name)["found"].items():
        for policy, results in policies.items():
            gains = ", ".join(f"{row['gain']:+.2f} ± {row['gain_half']:.2f}" for row in results)
            decisions = whole(results[0]["frames"]) if results[0]["frames"] else "-"
            rows.append([world, policy, decisions, spread([row["return"] for row in results], "{:.2f}"), gains])
    head = ["forecasts", "policy", "decisions in training", "return", "gain over hasty, each seed"]
    return with_command(name, head, rows)


TABLES: dict[str, Callable[..., str]] = {
    "by_condition": by_condition,
    "headroom": headroom,
    "own_environments": own_environments,
    "learners": learners,
    "suite_learners": suite_learners,
    "off_policy": off_policy,
    "expert_iteration": expert_iteration,
    "action_scores": action_scores,
    "dataset_sizes": dataset_sizes,
    "clouds": clouds,
    "pretrained": pretrained,
    "pretrained_short": pretrained_short,
    "inspections": inspections,
    "planners": planners,
    "computation": computation,
    "distillations": distillations,
    "safe_autonomy": safe_autonomy,
    "thruster_rules": thruster_rules,
}
"""Tables by name."""
