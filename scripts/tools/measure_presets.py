"""Measure what random actions, all rules and the pretrained policy of each preset return, for ``bsk-torch list`` and ``train``.

    python scripts/tools/measure_presets.py
    python scripts/tools/measure_presets.py --presets AEOS-v1,NadirScan-v1

All policies of a preset play the same episodes, the seeds from :data:`FIRST` on, which no training, tuning or evaluation of the
package uses; ``bsk-torch eval RULE --preset PRESET --seeds A:B`` repeats a row. Rules act in the views that they need
(:data:`VIEWS`). Presets that are not named keep their entries.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import asdict
from datetime import datetime, timezone
from pathlib import Path

import torch

import bsk_torch
from bsk_torch._listed import LISTED, SCORES, makings, scores
from bsk_torch.files import write_file
from bsk_torch.rl.evaluation.evaluate import Evaluation, evaluate
from bsk_torch.rl.policies.files import read_card
from bsk_torch.rl.policies.pretrained import pretrained, pretrained_file
from bsk_torch.rl.policies.shared_policy import rule, shared

FIRST = 9_000_000
"""Seed of the first episode."""

EPISODES = 256
"""Number of episodes of each preset."""

FEWER = {
    **dict.fromkeys(("AreasTeam-v1", "AEOSConstellation-v1", "RelayConstellation-v1", "MultiInspection-v1", "Services-v1"), 64),
    **dict.fromkeys(("Constellation-v1", "HeteroCluster-v1", "ThreeSensors-v1", "Walker4-v1"), 16),
    "AEOSBench-v1": 8,
}
"""The same of presets whose episodes take longer."""

AT_ONCE = 64
"""Episodes at once."""

VIEWS: dict[str, dict[str, object]] = {
    "candidate_rate_ahead": {"as_set": True, "outlook": True},
    "prompt": {"as_set": True},
    "prompt_ahead": {"as_set": True, "outlook": True},
    "centralized": {"information": "ideal"},
    "nearest_task": {"sensor": "on"},
    "soonest_task": {"candidates": True, "step_duration": 10.0},
}
"""Options of presets that rules need, where the preset itself does not have them."""

CANDIDATES = {"candidates": True}
"""View of AEOSBench-v1 in which ``nearest`` chooses."""

WAYPOINTS = {"actions": "waypoints"}


def players(preset: str) -> Iterator[tuple[str, str, dict[str, object]]]:
    """Yield the name in the table, the rule or ``pretrained``, and the options of the environment, for each policy."""
    yield "random", "random", {}
    for name in LISTED[preset].rules:
        yield name, name, CANDIDATES if (preset, name) == ("AEOSBench-v1", "nearest") else VIEWS.get(name, {})
        if "survey" in name:
            yield f"{name},actions=waypoints", name, WAYPOINTS
    if preset in makings():
        yield "pretrained", "pretrained", read_card(pretrained_file(preset))["options"]


def played(preset: str, name: str, options: dict[str, object], episodes: int) -> tuple[Evaluation, float]:
    """Return the results of a policy, and the CPU time of its episodes, s."""
    size = min(AT_ONCE, episodes)
    env = bsk_torch.make(preset, num_envs=size, env_ids=[0] * size, **options)
    policy = shared(pretrained(preset), env) if name == "pretrained" else rule(name, env)
    begin = time.process_time()
    with torch.no_grad():
        result = evaluate(policy, env, seeds=range(FIRST, FIRST + episodes))
    return result, time.process_time() - begin


def measured(preset: str, episodes: int) -> dict[str, object]:
    """Return the entry of a preset in a number of episodes."""
    results: dict[str, Evaluation] = {}
    rows = {}
    for title, name, options in players(preset):
        results[title], seconds = played(preset, name, options, episodes)
        rows[title] = asdict(results[title].mean_return) | {
            "survival": results[title].survival,
            "options": options,
            "core_seconds": round(seconds, 1),
        }
        print(f"{preset:22} {title:30} {results[title].mean_return}  {seconds:.1f} core-s", flush=True)
    best = max((name for name in rows if name not in ("random", "pretrained")), key=lambda name: rows[name]["mean"])
    gain = asdict(results["pretrained"].gain_over(results[best])) if "pretrained" in results else None
    return {"episodes": episodes, "best_rule": best, "gain": gain, "policies": rows}


def main() -> None:
    """Measure presets, and write the table after each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--presets", default=",".join(LISTED), help="names, separated by commas; default: all")
    parser.add_argument("--episodes", type=int, help=f"default: {EPISODES}, or fewer where they are expensive")
    parser.add_argument("--out", type=Path, default=SCORES, help="the table")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    for preset in arguments.presets.split(","):
        entry = measured(preset, arguments.episodes or FEWER.get(preset, EPISODES))
        entry |= {"bsk_torch": bsk_torch.__version__, "date": datetime.now(timezone.utc).date().isoformat()}
        scores.cache_clear()
        entries = scores() | {preset: entry}
        rows = ",\n".join(f'  "{name}": {json.dumps(entries[name])}' for name in LISTED if name in entries)
        head = f'"command": "python scripts/tools/measure_presets.py", "first_seed": {FIRST}'
        write_file(arguments.out, f'{{{head},\n "presets": {{\n{rows}\n }}\n}}\n')


if __name__ == "__main__":
    main()
