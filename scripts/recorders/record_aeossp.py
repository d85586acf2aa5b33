"""Record the verifier of aeossp_standard on a part of one of its cases: python record_aeossp.py REPOSITORY SOLUTION OUT.

Needs brahe 1.8.0. REPOSITORY is a copy of github.com/Mtrya/astro-reason (MIT license), commit ffd1e89; SOLUTION is a plan for its
case test/case_0001. OUT gets the part (three satellites, of all templates, and the tasks which the plan has them observe by
06:00, with as many others), their observations, and the verifier's verdicts: on these, and on the same plan with one observation
moved.
"""

import argparse
import json
import sys
from pathlib import Path

import yaml

CASE = "benchmarks/aeossp_standard/dataset/cases/test/case_0001"
SATELLITES = ("sat_003", "sat_004", "sat_017")
UNTIL = "2026-04-14T06:00:00Z"
MOVES = (-60, -30, -15, -10, -5, 5, 10, 15, 30, 60)


def part_of(case, actions):
    """Return the files of the part, by name, and its actions."""
    files = {name: yaml.safe_load((case / name).read_text()) for name in ("mission.yaml", "satellites.yaml", "tasks.yaml")}
    kept = [action for action in actions if action["satellite_id"] in SATELLITES and action["end_time"] <= UNTIL]
    observed = {action["task_id"] for action in kept}
    others = [task for task in files["tasks.yaml"]["tasks"] if task["task_id"] not in observed][: len(observed)]
    named = observed | {task["task_id"] for task in others}
    files["tasks.yaml"]["tasks"] = [task for task in files["tasks.yaml"]["tasks"] if task["task_id"] in named]
    satellites = [entry for entry in files["satellites.yaml"]["satellites"] if entry["satellite_id"] in SATELLITES]
    files["satellites.yaml"]["satellites"] = satellites
    return files, kept


def moved(actions, number, seconds):
    """Return actions of which one is some seconds later."""
    from datetime import datetime, timedelta

    changed = [dict(action) for action in actions]
    for name in ("start_time", "end_time"):
        time = datetime.fromisoformat(changed[number][name].replace("Z", "+00:00")) + timedelta(seconds=seconds)
        changed[number][name] = time.isoformat().replace("+00:00", "Z")
    return changed


def main():
    """Write the files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("repository", "solution", "out"):
        parser.add_argument(name, type=Path)
    args = parser.parse_args()
    sys.path.insert(0, str(args.repository))
    from benchmarks.aeossp_standard.verifier.engine import verify_solution

    files, actions = part_of(args.repository / CASE, json.loads(args.solution.read_text())["actions"])
    args.out.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (args.out / name).write_text(yaml.safe_dump(content, sort_keys=False))

    def verdict(plan):
        (args.out / "solution.json").write_text(json.dumps({"actions": plan}, indent=0) + "\n")
        return verify_solution(args.out, args.out / "solution.json")

    moves = [(k % len(actions), MOVES[k % len(MOVES)]) for k in range(0, 7 * 20, 7)]
    verdicts = [[number, seconds, verdict(moved(actions, number, seconds)).valid] for number, seconds in moves]
    report = verdict(actions)
    kept = ("per_task", "maneuver_windows", "per_satellite_resource_summary")
    content = {"valid": report.valid, "metrics": report.metrics, "violations": report.violations, "moved": verdicts}
    content |= {name: report.diagnostics[name] for name in kept}
    (args.out / "report.json").write_text(json.dumps(content, separators=(",", ":")) + "\n")


if __name__ == "__main__":
    main()
