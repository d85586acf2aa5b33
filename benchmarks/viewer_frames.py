"""Frames per second of the viewer's page in headless Chromium without a graphics card, and the processor time of a frame.

Usage:
    python benchmarks/viewer_frames.py [--pages OLD.html NEW.html] [--views globe follow] [--turns 3] [--out FILE.json]

Pages, such as the same recording in two versions of the viewer, play in turns at their usual speed. Without pages, one of
``Constellation-v1`` with its pretrained policy is made: ``--satellites`` satellites, ``--targets`` targets, ``--limit`` seconds.
Columns: frames per second while playing (medians and the range of the turns), the share of the resolution that the page has
chosen by then, and the processor time of all processes of Chromium per frame, which depends less on what else the machine does.
"""

from __future__ import annotations

import os
import statistics
import tempfile
from pathlib import Path
from shutil import which
from typing import Any

import harness
import torch

from bsk_torch import make
from bsk_torch.recording import record
from bsk_torch.rl.policies import pretrained
from bsk_torch.rl.policies.shared_policy import shared

COLUMNS = {
    "page": "{page}",
    "view": "{view}",
    "frames per second": "{rate:.1f}",
    "range": "{rate_least:.1f} to {rate_most:.1f}",
    "resolution": "{detail:.2f}",
    "CPU ms per frame": "{cpu:.0f}",
    "CPU range": "{cpu_least:.0f} to {cpu_most:.0f}",
}

VIEWS = {"globe": "", "follow": "&follow=1", "map": "&view=map"}
"""Views by what the address says."""

SCREEN = {"width": 1280, "height": 900}
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]
SETTLING = 3.0
"""Seconds of playing before measuring, in which the page chooses its resolution."""

LOOK = "[performance.now(), bskViewer.state().drawn, bskViewer.viewer.stage.detail]"


def page_of(satellites: int, targets: int, limit: float, folder: Path) -> Path:
    """Write the page of a constellation."""
    name = "Constellation-v1"
    env = make(name, num_envs=1, env_ids=[0], n_satellites=satellites, n_targets=targets, as_set=True, time_limit=limit)
    path = folder / f"{satellites}_satellites_{targets}_targets.html"
    path.write_text(record(env, shared(pretrained(name), env), seed=1, preset=name, label="pretrained").html(), encoding="utf-8")
    print(f"{path.name}: {path.stat().st_size / 1e6:.1f} MB")
    return path


def used(process: int) -> float:
    """Processor time of a process and of those that it has started, s, from Linux's /proc."""
    folder = Path("/proc") / str(process)
    try:
        fields = (folder / "stat").read_text().rpartition(")")[2].split()
        started = " ".join(path.read_text() for path in folder.glob("task/*/children")).split()
    except OSError:  # it has ended
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK") + sum(used(int(child)) for child in started)


def turn(browser: Any, path: Path, view: str, seconds: float) -> dict[str, float]:
    """Play a page in a new tab."""
    tab = browser.new_page(viewport=SCREEN)
    tab.goto(f"{path.resolve().as_uri()}#t=0&play=1{VIEWS[view]}")
    tab.evaluate("bskViewer.ready")
    tab.wait_for_timeout(1e3 * SETTLING)
    before, busy = tab.evaluate(LOOK), used(os.getpid())
    tab.wait_for_timeout(1e3 * seconds)
    after, busy = tab.evaluate(LOOK), used(os.getpid()) - busy
    tab.close()
    frames = after[1] - before[1]
    return {"rate": 1e3 * frames / (after[0] - before[0]), "detail": after[2], "cpu": 1e3 * busy / frames}


def measure(pages: list[Path], views: list[str], seconds: float, turns: int) -> list[dict[str, Any]]:
    """Rows of the table: all pages in turns, so that they share what else the machine does."""
    from playwright.sync_api import sync_playwright

    found: dict[tuple[str, str], list[dict[str, float]]] = {(page.name, view): [] for view in views for page in pages}
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=which("chromium"), args=FLAGS)
        for _ in range(turns):
            for view in views:
                for page in pages:
                    found[page.name, view].append(turn(browser, page, view, seconds))
        browser.close()
    return [{"page": page, "view": view, **summary(row), "turns": row} for (page, view), row in found.items()]


def summary(turns: list[dict[str, float]]) -> dict[str, float]:
    """Medians and ranges."""
    columns = {name: [one[name] for one in turns] for name in turns[0]}
    ends = {f"{name}_{end}": pick(values) for name, values in columns.items() for end, pick in (("least", min), ("most", max))}
    return {name: statistics.median(values) for name, values in columns.items()} | ends


def main() -> None:
    """Measure and print a table."""
    arguments = harness.parser(__doc__, seconds=8.0, turns=3, satellites=12, targets=5000, limit=28500.0)
    arguments.add_argument("--pages", type=Path, nargs="+", default=[], metavar="FILE.html")
    arguments.add_argument("--views", nargs="+", default=["globe", "follow"], choices=VIEWS)
    options, described = harness.begin(arguments)
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        pages = options.pages or [page_of(options.satellites, options.targets, options.limit, Path(folder))]
        rows = measure(pages, options.views, options.seconds, options.turns)
    print(harness.table(COLUMNS, rows))
    harness.write(options, described, rows=rows)


if __name__ == "__main__":
    main()
