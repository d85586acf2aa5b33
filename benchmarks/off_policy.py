"""How well off-policy evaluation finds the value of a policy, scored against the returns of all actions.

Usage:
    python benchmarks/off_policy.py [--presets NadirScan-v1 AEOS-v1] [--seeds 3] [--episodes 48] [--share 0.004]
        [--iterations 200] [--time-limit S] [--backend compiled] [--out FILE.json]

For each preset and seed, ``bsk_torch.lab.offline.write_dataset`` writes a dataset of four behaviors in other episodes: random
actions, a rule, and the target with 30 % and 5 % random actions. The value of the target in the same episodes is estimated from
each behavior alone: by fitted Q evaluation, the same with traces, and weighted importance sampling per decision. The error of an
estimate is its difference from the mean return of the target. Values of actions are scored at the sampled decisions: the root
mean squared error, and the share of pairs of actions in the right order. Ranges are those of the seeds. Without a time limit,
episodes of NadirScan-v1 last two orbits, and those of AEOS-v1 half of one.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import harness
from tensordict.nn import TensorDictModuleBase

import bsk_torch
from bsk_torch.env import Tasking
from bsk_torch.lab.offline import Behavior, OfflineDataset, Recipe, open_dataset, write_dataset
from bsk_torch.lab.offline.off_policy import fitted_q, importance_sampling, score
from bsk_torch.rl.policies.pretrained import pretrained
from bsk_torch.rl.policies.shared_policy import rule

TARGETS = {"NadirScan-v1": ("pretrained", "rule"), "AEOS-v1": ("hasty", "nearest")}
"""The policy to judge, and another deterministic one that acts, by preset."""

LIMITS = {"NadirScan-v1": 11_400.0, "AEOS-v1": 2850.0}
"""Length of the episodes, s, by preset: two orbits, and half of one."""

SHARES = (0.3, 0.05)
"""Probabilities of random actions."""

FIRST = 5_200_000
"""First seed of the episodes; each dataset has the next ones."""

ESTIMATORS = {"fitted": 0.0, "traced": 1.0}
"""Traces of fitted Q evaluation."""

COLUMNS = {
    "preset": "{preset}",
    "behavior": "{behavior}",
    "its return": "{behavior_return}",
    "target": "{truth}",
    "error of fitted Q": "{fitted}",
    "with traces": "{traced}",
    "of importance sampling": "{importance}",
    "effective episodes": "{effective}",
    "rmse of actions": "{rmse}",
    "pairs in order": "{concordance}",
}

SIZES = {
    "preset": "{preset}",
    "decisions": "{decisions:,}",
    "with all actions": "{sampled:,}",
    "returns": "{returns:,}",
    "MB": "{megabytes:.1f}",
    "bytes per decision": "{bytes:,.0f}",
    "core-seconds": "{cpu:.0f}",
    "decisions per core-s": "{rate:,.0f}",
}


def policy(name: str, env: Tasking) -> TensorDictModuleBase:
    """Return the pretrained policy of NadirScan-v1, or a rule."""
    return pretrained("NadirScan-v1") if name == "pretrained" else rule(name, env)


def written(preset: str, seed: int, options: Any, folder: Path) -> tuple[OfflineDataset, TensorDictModuleBase, float]:
    """Write a dataset; return it with the target and its CPU time, s, without construction of the environment."""
    limit = {"time_limit": options.time_limit or LIMITS[preset]}
    n = options.episodes
    env = bsk_torch.make(preset, num_envs=n, env_ids=[0] * n, backend=options.backend, **limit)
    target, other = TARGETS[preset]
    judged = policy(target, env)
    acting = [Behavior("random", None, 1.0), Behavior(other, policy(other, env))]
    acting += [Behavior(f"{target},random={share:g}", judged, share) for share in SHARES]
    first = FIRST + seed * n
    recipe = Recipe(preset, acting, range(first, first + n), {target: judged}, share=options.share, options=limit)
    clock = time.process_time()
    write_dataset(folder, env, recipe)
    return open_dataset(folder), judged, time.process_time() - clock


def size(preset: str, data: OfflineDataset, cpu: float) -> dict[str, Any]:
    """Return the size of a dataset, and the time to write it."""
    parts = data.card["behaviors"].values()
    decisions, sampled = (sum(part[key] for part in parts) for key in ("decisions", "counterfactuals"))
    every = sum(path.stat().st_size for path in data.folder.rglob("*") if path.is_file())
    returns = int((~data.counterfactuals()["action_value", data.card["targets"][0]].isnan()).sum())
    rows = sum(path.stat().st_size for path in data.folder.glob("*/transitions/**/*.memmap"))
    return {
        "preset": preset,
        "decisions": decisions,
        "sampled": sampled,
        "returns": returns,
        "megabytes": every / 1e6,
        "bytes": rows / decisions,
        "cpu": cpu,
        "rate": decisions / cpu,
    }


def estimates(data: OfflineDataset, name: str, target: TensorDictModuleBase, seed: int, iterations: int) -> dict[str, float]:
    """Return the errors of all estimators from one behavior."""
    rows, starts, judged = data.transitions(name), data.starts(), data.card["targets"][0]
    truth = float(starts["action_value", judged].mean())
    sampled = importance_sampling(rows, target)
    found = {
        "behavior_return": data.card["behaviors"][name]["mean_return"],
        "truth": truth,
        "importance": sampled.weighted - truth,
        "effective": sampled.effective,
    }
    for label, trace in ESTIMATORS.items():
        fitted = fitted_q(rows, target, trace=trace, iterations=iterations, seed=seed)
        first = fitted.values(starts).gather(1, starts["target_action", judged].unsqueeze(1))
        found[label] = float(first.mean()) - truth
        if data.card["behaviors"][name]["counterfactuals"]:
            known = data.counterfactuals(name)
            points = score(fitted.values(known), known["action_value", judged])
            found |= {f"{label}_rmse": points.rmse, f"{label}_concordance": points.concordance, f"{label}_regret": points.regret}
    return found


def main() -> None:
    """Write datasets, estimate, and print two tables."""
    parsed = harness.parser(__doc__, presets=[*TARGETS], seeds=3, episodes=48, share=0.004, iterations=200, time_limit=0.0)
    parsed.add_argument("--backend", choices=("compiled", "eager"), default="compiled")
    options, described = harness.begin(parsed)
    found: dict[tuple[str, str], list[dict[str, float]]] = {}
    sizes, cpu = [], 0.0
    for preset in options.presets:
        for seed in range(options.seeds):
            with tempfile.TemporaryDirectory() as folder:
                data, target, seconds = written(preset, seed, options, Path(folder) / "data")
                sizes.append(size(preset, data, seconds))
                clock = time.process_time()
                for name in data.behaviors:
                    found.setdefault((preset, name), []).append(estimates(data, name, target, seed, options.iterations))
                cpu += time.process_time() - clock
                print(f"{preset}, seed {seed}: written in {seconds:.0f} s, {cpu:.0f} s of estimation so far", flush=True)
        rows = [{"preset": preset, "behavior": name, "seeds": runs} for (preset, name), runs in found.items()]
        harness.write(options, described, rows=rows, sizes=sizes, estimation_cpu=cpu)
    print(harness.table(COLUMNS, [shown(*names, runs) for names, runs in found.items()]))
    print(harness.table(SIZES, [joined([one for one in sizes if one["preset"] == preset]) for preset in options.presets]))


def shown(preset: str, behavior: str, runs: list[dict[str, float]]) -> dict[str, str]:
    """Return the cells of a behavior: means over seeds, with ranges."""
    forms = {"fitted": "{:+.3f}", "traced": "{:+.3f}", "importance": "{:+.3f}", "effective": "{:.1f}"}
    forms |= {"traced_rmse": "{:.3f}", "traced_concordance": "{:.0%}", "behavior_return": "{:.3f}", "truth": "{:.3f}"}
    known = {key: form for key, form in forms.items() if all(key in run for run in runs)}
    cells = {key.replace("traced_", ""): harness.of_seeds([run[key] for run in runs], form) for key, form in known.items()}
    return {"preset": preset, "behavior": behavior} | cells


def joined(sizes: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the mean size of the datasets of a preset."""
    means = {key: statistics.fmean(one[key] for one in sizes) for key in sizes[0] if key != "preset"}
    whole = {key: round(means[key]) for key in ("decisions", "sampled", "returns")}
    return {"preset": sizes[0]["preset"]} | means | whole


if __name__ == "__main__":
    main()
