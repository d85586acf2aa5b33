"""Replay the recordings of Basilisk and write the largest differences, together with the bounds of the tests.

    python scripts/validation/truth.py --out benchmarks/results/truth.json
    python scripts/validation/truth.py --only nominal shared

Recordings, replays and bounds are those of tests/basilisk, whose README describes each recording. Basilisk is not needed.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import torch

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from tests.basilisk import constellation, imaging, replay  # noqa: E402
from tests.basilisk import test_constellation_parity as constellations  # noqa: E402
from tests.basilisk import test_imaging_parity as images  # noqa: E402
from tests.basilisk import test_models_parity as models  # noqa: E402
from tests.basilisk import test_parity as scanning  # noqa: E402

Result = tuple[dict[str, float], dict[str, bool]]
"""Largest differences by quantity, and whether what must be equal is equal."""

INTEGRATED = "integrated"


class Case(NamedTuple):
    """A replay: the group of its table, name of the recording, a function that replays it, and the bounds of its test."""

    group: str
    recording: str
    play: Callable[[], Result]
    bounds: dict[str, float]

    @property
    def name(self) -> str:
        """Recording and group, which together are unique."""
        return f"{self.recording} ({self.group})"


def scan(name: str, **options: Any) -> Result:
    """Replay a recording of the scanning satellite."""
    recording = replay.load(name)
    found = replay.replay(recording, replay.environment(recording, **options))
    return found.largest, found.exact


def image(name: str, **options: Any) -> Result:
    """Replay a recording of point imaging."""
    recording = imaging.load(name)
    found = imaging.replay(recording, imaging.environment(recording, **options))
    return found.largest, found.exact


def together(name: str) -> Result:
    """Replay a recording of several satellites."""
    recording = constellation.load(name)
    found = constellation.replay(recording, constellation.environment(recording))
    return found.largest, found.exact


def cases() -> list[Case]:
    """Return every replay of tests/basilisk with its bounds; mixed precision has none, because no test promises any."""
    arc, integrated = ({**scanning.BOUNDS, "r": scanning.POSITION[orbit]} for orbit in ("arc", INTEGRATED))
    ahead = {"r": scanning.POSITION["arc"]}
    names = ("nominal", "saturation", "full", "desat_sun", "desat_none", "integral", "integral_clip", "all_modes", "eccentric")
    found = [Case("scanning", name, lambda name=name: scan(name), arc) for name in (*names, "half_second", "two_seconds")]
    found += [Case(INTEGRATED, name, lambda name=name: scan(name, orbit=INTEGRATED), integrated) for name in ("nominal", "low")]
    found += [Case("mixed", "nominal", lambda: scan("nominal", sim_dtype=torch.float32), {})]
    bounds = dict.fromkeys(images.FEEDBACK, images.IMAGING) | {"steering": images.STEERING, "padded": images.DAYS}
    for name, bound in bounds.items():
        group = "days" if bound is images.DAYS else "imaging"
        found += [Case(group, name, lambda name=name: image(f"imaging_{name}"), {**bound, **ahead})]
    found += [
        Case("constellations", name, lambda name=name: together(name), {**constellations.CONSTELLATION, **ahead})
        for name in constellations.NAMES
    ]
    small = {"pointing": models.BOUNDS, "spinning": models.BOUNDS, "passive_crew": models.WHEELED, "scanner": models.WHEELED}
    for name, bound in small.items():
        play = lambda name=name: (models.differences(f"models_{name}", backend="eager"), {})  # noqa: E731
        found += [Case("models", name, play, bound)]
    return found


def described(case: Case) -> dict[str, Any]:
    """Replay one recording and return its entry."""
    largest, exact = case.play()
    exact = {name: bool(value) for name, value in exact.items()}
    return {"group": case.group, "recording": case.recording, "bounds": case.bounds, "largest": largest, "exact": exact}


def recorded_with() -> dict[str, str]:
    """Versions of what made the recordings."""
    import numpy as np

    return json.loads(str(np.load(replay.RECORDINGS / "nominal.npz")["versions"]))


def commit() -> str:
    """Return the commit of this checkout, with a mark where it has changes."""
    command = ["git", "-C", str(ROOT), "describe", "--always", "--dirty", "--abbrev=7", "--exclude=*"]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()


def main() -> None:
    """Read the command line, replay, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="JSON file to write")
    parser.add_argument("--only", nargs="+", help="recordings to replay, all unless given")
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows = []
    for case in cases():
        if options.only is None or case.recording in options.only:
            rows.append(described(case))
            row = rows[-1]
            worst = {name: f"{value:.1e}" for name, value in row["largest"].items()}
            beyond = [name for name, bound in case.bounds.items() if not row["largest"][name] <= bound]
            print(f"{case.name}: {worst}; equal: {all(row['exact'].values())}; beyond their bounds: {beyond}", flush=True)
    if options.out:
        versions = {"commit": commit()} | {name: version(name) for name in ("bsk_torch", "torch", "numpy")}
        content = {"versions": versions, "recorded with": recorded_with(), "rows": rows}
        options.out.write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main()
