"""What rules and the policies of the package reach in a suite, from files of ``bsk-torch bench``, and the suite's references.

Usage:
    bsk-torch bench random rule pretrained --presets NadirScan-v1 --out scan.json
    bsk-torch bench random hasty pretrained --presets AEOS-v1 --out aeos.json
    bsk-torch bench plan:rollout,base=rule --presets NadirScan-v1 --episodes 32 --out planned.json
    python benchmarks/suite.py scan.json aeos.json planned.json [--out FILE.json] [--references FILE.json]
        [--published FILE.json --method NAME=PATTERN ...]

The references are made once for a suite, from all of its episodes: 0 is what random actions return, 1 the best mean of all
policies in the files. Of planners, which play fewer episodes, the mean is that of the best other policy and their gain over it in
the episodes that both played, if this is significant. References belong to the suite as its episodes do, and are not made again
for better policies: tasks that have references keep them. Rows of tasks that no file has stay in FILE.json.

``--published`` writes what ``bsk-torch leaderboard --published`` shows: the returns of all policies, and of which policies each
``--method`` consists. The runs of a seed in all tasks, ``runs/NAME/seed_K``, become one policy ``ppo/seed_K``.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from bsk_torch.lab.commands.leaderboard import methods_of
from bsk_torch.lab.suites.suite import SUITES, ranking
from bsk_torch.lab.suites.suite import references as frozen


def merged(files: Sequence[Path]) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """What all files say of themselves, and the results by preset and policy; ValueError for files of unlike runs.

    Of the same policy, the results of the most episodes count, and then those of the last file; a certificate is kept.
    """
    head: dict[str, Any] = {}
    results: dict[str, dict[str, Any]] = {}
    for path in files:
        content = json.loads(path.read_text())
        policies = content.pop("policies")
        made = {name: content[name] for name in ("format", "suite", "bsk_torch", "torch", "machine")}
        if head and made != head:
            raise ValueError(f"{path} was made by {made}, the others by {head}")
        head = made
        for policy, presets in policies.items():
            for preset, row in presets.items():
                rows = results.setdefault(preset, {})
                known = rows.get(policy, row)
                shorter, longer = sorted((known, row), key=lambda one: len(one["returns"]))
                flights = [one["basilisk"] for one in (longer, shorter) if "basilisk" in one]
                rows[policy] = longer | ({"basilisk": flights[0]} if flights else {})
    return head, results


def episodes_of(suite: str) -> dict[str, int]:
    """Number of episodes of each task of a suite."""
    return {task.title: task.episodes for task in SUITES[suite]}


def references(head: Mapping[str, Any], results: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Lowest and highest returns by task, each with the policy, of tasks in which random actions and another one played all."""
    found, all_of = {}, episodes_of(head["suite"])
    for task, rows in results.items():
        played = [name for name, row in rows.items() if len(row["returns"]) == all_of[task]]
        if "random" not in played or len(played) < 2:
            continue
        best, gains = ranking({name: row["returns"] for name, row in rows.items()})
        ahead = [name for name, gain in gains.items() if gain.mean + gain.half_width < 0.0]
        top, source = (ahead or [best])[0], f"bsk_torch {head['bsk_torch']}"
        few = f", gain over {best} in {len(rows[top]['returns'])} episodes" if ahead else ""
        estimated = {"half_width": gains[top].half_width} if ahead else {}
        found[task] = {
            "low": {"return": rows["random"]["return"]["mean"], "source": f"random actions, {source}"},
            "high": {"return": rows[best]["return"]["mean"] - gains[top].mean, "source": f"{top}, {source}{few}"} | estimated,
        }
    return found


def summaries(
    results: Mapping[str, Mapping[str, Any]], known: Mapping[str, Any], all_of: Mapping[str, int]
) -> Iterator[dict[str, Any]]:
    """A row for each task and policy, the best first: score, return, paired gain of the best, survival and computation.

    See :func:`~bsk_torch.lab.suites.suite.ranking`. Policies that played fewer than all episodes have no score.
    """
    for preset, rows in results.items():
        whole = all_of[preset]
        _, gains = ranking({name: row["returns"] for name, row in rows.items()})
        for name, gain in gains.items():
            row = rows[name]
            summary = {
                "preset": preset,
                "policy": name,
                "episodes": len(row["returns"]),
                "score": None,
                "score_half": None,
                "value": row["return"]["mean"],
                "half": row["return"]["half_width"],
                "behind": gain.mean,
                "behind_half": gain.half_width,
                "survival": row["survival"],
                "milliseconds": 1e3 * row["seconds_per_decision"],
                "simulated": row.get("simulated_per_decision"),
                "basilisk": certificate(row),
            }
            if row.get("measures"):
                summary["measures"] = row["measures"]
            if preset in known and len(row["returns"]) == whole:
                low, high = (known[preset][end]["return"] for end in ("low", "high"))
                summary["score"] = (row["return"]["mean"] - low) / (high - low)
                summary["score_half"] = row["return"]["half_width"] / (high - low)
            yield summary


def with_others(path: Path, head: Mapping[str, Any], rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows of a file, of which those of the presets of ``rows`` are replaced in their place; ValueError for unlike runs."""
    if not path.exists():
        return rows
    before = json.loads(path.read_text())
    if unlike := [name for name in ("format", "suite") if before[name] != head[name]]:
        raise ValueError(f"{path} has rows of another {unlike[0]}: {before[unlike[0]]!r}, not {head[unlike[0]]!r}")
    mine: dict[str, list[dict[str, Any]]] = {row["preset"]: [] for row in (*before["rows"], *rows)}
    new = {row["preset"] for row in rows}
    for row in (*(row for row in before["rows"] if row["preset"] not in new), *rows):
        mine[row["preset"]].append(row)
    return [row for group in mine.values() for row in group]


def certificate(row: Mapping[str, Any]) -> dict[str, Any] | None:
    """What a row says of its flights on Basilisk: their number, how many are the same, and the largest difference of a return."""
    flown = row.get("basilisk")
    if flown is None:
        return None
    return {"episodes": len(flown["returns"])} | {name: flown[name] for name in ("same", "largest_difference", "decided")}


RUN = re.compile(r"runs/[^/]+/(seed_\d+)")
"""Folder of a run of ``bsk-torch train``."""

DIGITS = 7
"""Digits of published returns; scores are told to three."""


def public(head: Mapping[str, Any], results: Mapping[str, Mapping[str, Any]], methods: Sequence[str]) -> dict[str, Any]:
    """Return the content of a file of published results, see :func:`~bsk_torch.lab.suites.suite.published`."""
    policies: dict[str, dict[str, Any]] = {}
    for task, rows in results.items():
        for name, row in rows.items():
            known = policies.setdefault(RUN.sub(r"ppo/\1", name), {})
            if task in known:
                raise ValueError(f"two runs of the same seed in {task}: {name} and another one")
            others = {key: row[key] for key in ("library", "training", "basilisk") if key in row}
            known[task] = {"returns": [float(f"{value:.{DIGITS}g}") for value in row["returns"]]} | others
    return {**head, "methods": methods_of(policies, methods), "policies": policies}


def line(row: Mapping[str, Any]) -> str:
    """A row as it is printed."""
    score = "-" if row["score"] is None else "{score:.3f} +- {score_half:.3f}".format(**row)
    return "| {preset} | {policy} | {episodes} | {score} | {value:.3f} +- {half:.3f} | {survival:.1%} |".format(
        **{**row, "score": score}
    )


def main() -> None:
    """Write what the command line asks for, and print the rows."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE")
    parser.add_argument("--out", type=Path, help="JSON file for the rows of all presets and policies")
    parser.add_argument("--references", type=Path, help="JSON file for the references of the suite")
    parser.add_argument("--published", type=Path, help="JSON file for the returns of all policies")
    parser.add_argument(
        "--method", action="append", default=[], metavar="NAME=PATTERN", help="the policies of a published method"
    )
    given = parser.parse_args()
    head, results = merged(given.files)
    known = references(head, results) | frozen(head["suite"])
    rows = list(summaries(results, known, episodes_of(head["suite"])))
    for row in rows:
        print(line(row))
    if given.references is not None:
        if missing := [preset for preset in results if preset not in known]:
            parser.error(f"references need all episodes of random actions and of another policy in {', '.join(missing)}")
        given.references.write_text(json.dumps(dict(sorted(known.items())), indent=1) + "\n")
    if given.published is not None:
        given.published.write_text(json.dumps(public(head, results, given.method)).replace('}, "', '},\n "') + "\n")
    if given.out is not None:
        given.out.write_text(json.dumps(head | {"rows": with_others(given.out, head, rows)}, indent=1) + "\n")


if __name__ == "__main__":
    main()
