"""Make the figure of paper/paper.md from measured results: speed, and agreement with Basilisk.

    python scripts/tools/make_paper_figure.py

Writes ``paper/evidence.png``. Shown are ``benchmarks/results/vs_basilisk.json`` and ``vs_basilisk_imaging.json``, as in the
README, and the replays in float64 of ``benchmarks/results/truth.json``. Needs the extra ``viz``.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
from make_readme_pictures import OURS, RESULTS, ROOT, THEIRS, draw_speeds, measured_speeds
from matplotlib.axes import Axes

QUANTITIES = {
    "r": "position, m",
    "sigma": "attitude, MRP",
    "omega": "rate, rad/s",
    "wheel_speed": "wheels, rad/s",
    "battery": "battery, J",
    "illumination": "illumination",
    "observation": "observations",
}
"""Labels of the quantities of ``truth.json`` that are shown; rewards and stored data are exact."""

LEAST = 1e-15
"""Smaller differences are drawn here."""


def replays() -> list[dict[str, Any]]:
    """Return the replayed recordings in float64."""
    rows = json.loads((RESULTS / "truth.json").read_text())["rows"]
    return [row for row in rows if row["group"] != "mixed"]


def draw_differences(panel: Axes, rows: list[dict[str, Any]]) -> None:
    """Draw the largest difference of each recording as a dot, and the tolerance of most tests as a bar, by quantity."""
    for place, name in enumerate(QUANTITIES):
        found = [max(row["largest"][name], LEAST) for row in rows if name in row["largest"]]
        limits = sorted(row["bounds"][name] for row in rows if name in row["bounds"])
        spread = [place - 0.3 + 0.6 * (k + 0.5) / len(found) for k in range(len(found))]
        panel.scatter(spread, found, s=9, color=OURS, alpha=0.7, linewidths=0, zorder=3)
        panel.hlines(limits[len(limits) // 2], place - 0.4, place + 0.4, color=THEIRS, linewidth=3)
    panel.set(yscale="log", ylim=(LEAST / 3, 1.0), title="difference from Basilisk", xlim=(-0.6, len(QUANTITIES) - 0.4))
    panel.set_xticks(range(len(QUANTITIES)), list(QUANTITIES.values()), rotation=35, ha="right", fontsize=9)
    panel.grid(axis="y", color="#eaecf0")
    panel.set_axisbelow(True)
    panel.spines[["top", "right"]].set_visible(False)
    panel.scatter([], [], s=9, color=OURS, label="a recorded flight")
    panel.plot([], [], color=THEIRS, linewidth=3, label="tolerance of most tests")
    panel.legend(loc="upper right", frameon=False, fontsize=8)


def main(path: Path) -> None:
    """Write the figure."""
    plt.rcParams["font.size"] = 10
    figure, panels = plt.subplots(1, 3, figsize=(11.0, 3.4), layout="constrained", width_ratios=(1.0, 0.8, 1.3))
    for panel, (title, rows) in zip(panels, measured_speeds().items(), strict=False):
        draw_speeds(panel, rows, title)
    panels[0].set_ylabel("simulated seconds per core-second")
    draw_differences(panels[2], replays())
    figure.savefig(path, dpi=150)
    plt.close(figure)
    print(path)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "paper" / "evidence.png", help="the picture")
    main(parser.parse_args().out)
