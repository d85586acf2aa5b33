"""What rules and the policies of the package reach in a suite, from files of ``bsk-torch bench``, and the suite's references.

Usage:
    bsk-torch bench random rule pretrained --presets NadirScan-v1 --out scan.json
    bsk-torch bench random hasty pretrained --presets AEOS-v1 --out aeos.json
    python benchmarks/suite.py scan.json aeos.json [--out FILE.json] [--references FILE.json]

The references are made once for a suite, from all of its episodes: 0 is what random actions return, 1 the best mean of all
policies in the files. They belong to the suite as its episodes do, and are not made anew for better policies: presets that have
references keep them.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from bsk_torch.rl.evaluation.statistics import confidence
from bsk_torch.rl.evaluation.suite import EPISODES
from bsk_torch.rl.evaluation.suite import references as frozen


def merged(files: Sequence[Path]) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """What all files say of themselves, and the results by preset and policy; ValueError for files of unlike runs."""
    head: dict[str, Any] = {}
    results: dict[str, dict[str, Any]] = {}
    for path in files:
        content = json.loads(path.read_text())
        policies = content.pop("policies")
        made = {name: content[name] for name in ("format", "suite", "episodes", "bsk_torch", "torch", "machine")}
        if head and made != head:
            raise ValueError(f"{path} was made by {made}, the others by {head}")
        head = made
        for policy, presets in policies.items():
            for preset, row in presets.items():
                results.setdefault(preset, {})[policy] = row
    return head, results


def references(head: Mapping[str, Any], results: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Lowest and highest returns by preset, each with the policy."""
    found = {}
    for preset, rows in results.items():
        best = max(rows, key=lambda name: rows[name]["return"]["mean"])
        source = f"bsk_torch {head['bsk_torch']}"
        found[preset] = {
            "low": {"return": rows["random"]["return"]["mean"], "source": f"random actions, {source}"},
            "high": {"return": rows[best]["return"]["mean"], "source": f"{best}, {source}"},
        }
    return found


def summaries(results: Mapping[str, Mapping[str, Any]], known: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """A row for each preset and policy, the best first: score, return, paired gain of the best, survival and computation."""
    for preset, rows in results.items():
        order = sorted(rows, key=lambda name: -rows[name]["return"]["mean"])
        best = torch.tensor(rows[order[0]]["returns"], dtype=torch.float64)
        for name in order:
            row, returns = rows[name], torch.tensor(rows[name]["returns"], dtype=torch.float64)
            gain, low, high = confidence(best - returns), *(known[preset][end]["return"] for end in ("low", "high"))
            yield {
                "preset": preset,
                "policy": name,
                "score": (row["return"]["mean"] - low) / (high - low),
                "score_half": row["return"]["half_width"] / (high - low),
                "value": row["return"]["mean"],
                "half": row["return"]["half_width"],
                "behind": gain.mean,
                "behind_half": gain.half_width,
                "survival": row["survival"],
                "milliseconds": 1e3 * row["seconds_per_decision"],
            }


def main() -> None:
    """Write what the command line asks for, and print the rows."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE")
    parser.add_argument("--out", type=Path, help="JSON file for the rows of all presets and policies")
    parser.add_argument("--references", type=Path, help="JSON file for the references of the suite")
    given = parser.parse_args()
    head, results = merged(given.files)
    known = references(head, results) | {name: kept for name, kept in frozen(head["suite"]).items() if name in results}
    rows = list(summaries(results, known))
    for row in rows:
        print(
            "| {preset} | {policy} | {score:.3f} +- {score_half:.3f} | {value:.3f} +- {half:.3f} | {survival:.1%} |".format(**row)
        )
    if given.references is not None:
        if head["episodes"] != EPISODES:
            parser.error(f"references need all {EPISODES} episodes of each task; the files have {head['episodes']}")
        given.references.write_text(json.dumps(known, indent=1) + "\n")
    if given.out is not None:
        given.out.write_text(json.dumps(head | {"rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
