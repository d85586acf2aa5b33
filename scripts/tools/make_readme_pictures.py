"""Make the pictures of README.md, thumbnails of all presets and a plot of speed, and pictures of pages.

    python scripts/tools/make_readme_pictures.py [thumbnails] [frame] [speed] [guides] [viewer] [PRESET]

They are written to docs/_static/readme, those of guides to docs/_static/how_to, those of the viewer to docs/_static/viewer: all
of them, or those that are named, among them thumbnails of single presets. The thumbnails show the pretrained policies, or a rule
where there is none; the plot shows ``benchmarks/results/vs_basilisk.json`` and
``vs_basilisk_imaging.json``; the pictures of guides are those that the blocks of code of these pages draw. Needs the extras
``viz`` and ``cities``.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, Literal

import matplotlib.pyplot as plt
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

import bsk_torch
from bsk_torch import make
from bsk_torch.env import Tasking
from bsk_torch.env.rollout import play_episodes
from bsk_torch.presets import PRESETS
from bsk_torch.recording import record
from bsk_torch.rl.policies import pretrained, pretrained_file, read_card
from bsk_torch.rl.policies.shared_policy import shared
from bsk_torch.tasks.inspection.figure import draw_paths
from bsk_torch.viewer.page import build_page
from bsk_torch.viz import episodes
from bsk_torch.viz.figures.style import save

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "_static" / "readme"
RESULTS = ROOT / "benchmarks" / "results"

COLORS = 64
"""Colors of pictures."""

THUMBNAIL, THUMBNAIL_TIME, DAYLIGHT = 200, 1500.0, 0.35
"""Width and height of a thumbnail, pixels; it shows the first decision after so many seconds at which the cosine of the Sun's
zenith angle below the first satellite is so large."""

LATER = {"Areas-v1": 18_000.0, "AreasTeam-v1": 18_000.0}
"""Presets whose thumbnail shows a later time: areas recorded in earlier revolutions are in view."""

ZOOM = 1.3
"""How much larger a single satellite is shown."""

THUMBNAIL_SEED = 59
"""Seed of the episode that is shown: it flies over Europe and Asia in daylight."""

INSPECTIONS, INSPECTION, INSPECTION_SEED = ("RSOInspection-v1", "MultiInspection-v1"), "survey", 4
"""Presets whose thumbnail is made of paths about an RSO, and the rule and the seed of the episode that it shows."""

RULES = {
    "Areas-v1": "areas",
    "AreasTeam-v1": "areas",
    "HeteroCluster-v1": "cooperative",
    "NadirScience-v1": "science",
    "Services-v1": "angle",
    "Sites-v1": "commit",
    "SitesTeam-v1": "commit",
    "TipAndCue-v1": "commit",
    "ThreeSensors-v1": "local",
    "Walker4-v1": "local",
    "CWDocking-v1": "glide",
    "CWInspection-v1": "seek",
    "AEOSBench-v1": "nearest_task",
}
"""Presets without a pretrained policy, and the rules that their thumbnails show."""

LINEAR, DEPUTIES = ("CWDocking-v1", "CWInspection-v1"), 12
"""Presets whose thumbnail is made of paths in the chief's orbit plane, and the number of paths."""

GUIDES = ("own_rewarder", "own_satellite")
"""Pages of docs/how_to whose blocks draw ``<page>.png``."""

VIEWER_SEED, VIEWER_SIZE = 3, {"width": 1280, "height": 800}

VIEWS: dict[str, tuple[str, dict[str, Any], Literal["light", "dark"], str]] = {
    "globe": ("Constellation-v1", {"n_targets": 1000, "time_limit": 6000.0}, "dark", "t=2700&satellite=2"),
    "follow": ("AEOSPower-v1", {"time_limit": 11400.0}, "light", "t=3030&follow=1"),
    "map": ("Constellation-v1", {}, "dark", "t=2700&satellite=2&view=map"),
}
"""Pictures of the viewer: preset, options of its environment, color scheme, and the address after ``#``."""

INK, OURS, THEIRS = "#14171c", "#2a6ebb", "#98a2b3"


def options_of(preset: str) -> dict[str, Any]:
    """Return the options of the environment that the pretrained policy was trained in, without those of its training."""
    if preset in RULES:
        return {}
    options = read_card(pretrained_file(preset))["options"]
    return {name: value for name, value in options.items() if name != "time_limit"}


def played(preset: str, seed: int, **options: Any) -> Iterator[Tasking]:
    """Yield the environment of one episode at the reset and after each decision of the policy or rule."""
    env = make(preset, num_envs=1, seed=seed, **(options_of(preset) | options))
    policy = bsk_torch.rule(RULES[preset], env) if preset in RULES else shared(pretrained(preset), env)
    start = env.reset()
    yield env
    for _ in play_episodes(env, policy, start):
        yield env


def thumbnails(folder: Path) -> list[Path]:
    """Write ``<preset>.png`` for every preset: the globe, without the panel next to it, or the paths of an inspection."""
    return [thumbnail(preset, folder / f"{preset}.png") for preset in PRESETS]


def frame(folder: Path) -> Path:
    """Write ``frame.png``: a frame of a film of NadirScan-v1, for the page on the first policy."""
    env = next(filter(is_bright, played("NadirScan-v1", THUMBNAIL_SEED)))
    path = folder / "frame.png"
    Image.fromarray(env.render(0).numpy()).quantize(256, dither=Image.Dither.NONE).save(path, optimize=True)
    return path


def thumbnail(preset: str, path: Path) -> Path:
    """Write a thumbnail of a preset."""
    if preset in INSPECTIONS or preset in LINEAR:
        return paths_thumbnail(preset, path)
    env = next(env for env in played(preset, THUMBNAIL_SEED) if is_bright(env, LATER.get(preset, THUMBNAIL_TIME)))
    frame = Image.fromarray(env.render(0, 4 * THUMBNAIL).numpy())
    middle, half = frame.height / 2, frame.height / (2 * ZOOM if env.fleet.size == 1 else 2)
    box = (middle - half, middle - half, middle + half, middle + half)
    globe = frame.resize((THUMBNAIL, THUMBNAIL), Image.Resampling.LANCZOS, box)
    globe.quantize(256, dither=Image.Dither.NONE).save(path, optimize=True)
    return path


def paths_thumbnail(preset: str, path: Path) -> Path:
    """Write a thumbnail of paths near another spacecraft."""
    figure = Figure(figsize=(2.0, 2.0), dpi=2 * THUMBNAIL, facecolor="white")
    panel = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    (linear_paths if preset in LINEAR else inspection_paths)(preset, panel)
    panel.set_axis_off()
    with tempfile.TemporaryDirectory() as folder:
        large = Image.open(save(figure, Path(folder) / path.name)).convert("RGB")
    small = large.resize((THUMBNAIL, THUMBNAIL), Image.Resampling.LANCZOS)
    small.quantize(COLORS, dither=Image.Dither.NONE).save(path, optimize=True)
    return path


def inspection_paths(preset: str, panel: Axes) -> None:
    """Draw the paths of one inspection near the RSO."""
    env = make(preset, num_envs=1, actions="waypoints")
    episode = episodes.record(bsk_torch.rule(INSPECTION, env), env, seed=INSPECTION_SEED)
    draw_paths(panel, episode, 1, 0, near=True)


def linear_paths(preset: str, panel: Axes) -> None:
    """Draw the paths of several episodes in the orbit plane of the chief, until each of them ends."""
    env = make(preset, num_envs=DEPUTIES, seed=INSPECTION_SEED)
    start = env.reset()
    positions = [env.satellites[0].dynamics.rho_H]
    for _ in play_episodes(env, bsk_torch.rule(RULES[preset], env), start):
        positions.append(env.satellites[0].dynamics.rho_H)
    for path in torch.stack(positions, 1):
        panel.plot(path[:, 1], path[:, 0], color=OURS, linewidth=0.5)
        panel.plot(path[0, 1], path[0, 0], "o", color=OURS, markersize=1.5)
    panel.plot(0.0, 0.0, "s", color=INK, markersize=2.5)
    panel.set_aspect("equal")
    panel.margins(0.08)


def is_bright(env: Tasking, since: float = THUMBNAIL_TIME) -> bool:
    """Return whether an episode is in the moment that a thumbnail shows."""
    position, sun = env.satellites[0].dynamics.r_BN_N[0], env.simulator.world.sun_direction_N[0]
    return float(env.fleet.sim_time[0]) >= since and float(position @ sun / position.norm()) > DAYLIGHT


def speed(folder: Path) -> Path:
    """Write ``speed.png``: simulated seconds per second of one core against the number of episodes, here and in Basilisk."""
    plt.rcParams["font.size"] = 11
    figure, panels = plt.subplots(1, 2, figsize=(9.0, 3.4), sharey=True, layout="constrained")
    for panel, (title, rows) in zip(panels, measured_speeds().items(), strict=True):
        draw_speeds(panel, rows, title)
    panels[0].set_ylabel("simulated seconds\nper core-second")
    path = folder / "speed.png"
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path


def measured_speeds() -> dict[str, list[dict[str, Any]]]:
    """Return the rows of TorchRL's environments in float64 by the task, from small to large batches."""
    tasks = (
        ("vs_basilisk.json", "4096-", "NadirScan-v1: scanning"),
        ("vs_basilisk_imaging.json", "-float32", "AEOS-v1: 1,000 targets"),
    )
    cases = {}
    for name, without, title in tasks:
        rows = json.loads((RESULTS / name).read_text())["rows"]
        plain = [row for row in rows if without not in row["case"] and not row["case"].startswith("gymnasium")]
        cases[title] = sorted(plain, key=lambda row: row["batch"])
    return cases


def draw_speeds(panel: Axes, rows: list[dict[str, Any]], title: str) -> None:
    """Draw the rates of ``rows`` and of Basilisk in the same turns, with the ratio at the largest batch."""
    batches = [row["batch"] for row in rows]
    theirs = sorted(row["basilisk_rate"] for row in rows)[len(rows) // 2]
    panel.plot(batches, [row["rate"] for row in rows], "o-", color=OURS)
    panel.axhline(theirs, color=THEIRS, linestyle="--")
    panel.text(1.0, theirs, "BSK-RL on Basilisk", color="#67717c", transform=panel.get_yaxis_transform(), ha="right", va="bottom")
    last = rows[-1]
    panel.annotate(
        f"bsk_torch: {last['ratio']:,.0f} times",
        (last["batch"], last["rate"]),
        textcoords="offset points",
        xytext=(4, 8),
        ha="right",
        color=OURS,
        weight="bold",
    )
    panel.set(xscale="log", yscale="log", xlabel="episodes at once", title=title, ylim=(1e3, 6e7))
    panel.set_xticks(batches, [f"{batch:,}" for batch in batches])
    panel.minorticks_off()
    panel.grid(axis="y", color="#eaecf0")
    panel.spines[["top", "right"]].set_visible(False)


def guides(folder: Path) -> list[Path]:
    """Write ``<page>.png`` for the guides that have a picture, into the folder ``how_to`` next to the given one."""
    target = folder.resolve().parent / "how_to"
    target.mkdir(parents=True, exist_ok=True)
    return [guide(page, target / f"{page}.png") for page in GUIDES]


def guide(page: str, path: Path) -> Path:
    """Run the blocks of a page in an empty folder, and write the picture that they leave there."""
    text = (ROOT / "docs" / "how_to" / f"{page}.md").read_text()
    program = "\n".join(re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE))
    with tempfile.TemporaryDirectory() as empty:
        subprocess.run([sys.executable, "-c", program], cwd=empty, stdout=subprocess.DEVNULL, check=True)
        picture = Image.open(Path(empty) / path.name).convert("RGB")
    picture.quantize(COLORS, dither=Image.Dither.NONE).save(path, optimize=True)
    return path


def viewer(folder: Path) -> list[Path]:
    """Write pictures of the viewer in Chromium, with pretrained policies, into the folder ``viewer`` next to the given one."""
    from playwright.sync_api import sync_playwright  # only here: the other pictures need no browser

    target = folder.resolve().parent / "viewer"
    target.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as empty:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"])
        pages: dict[str, Path] = {}
        for name, (preset, options, scheme, where) in VIEWS.items():
            if preset not in pages:
                env = make(preset, num_envs=1, seed=0, **(options_of(preset) | options))
                recording = record(
                    env, shared(pretrained(preset), env), seed=VIEWER_SEED, preset=preset, label="pretrained policy"
                )
                pages[preset] = Path(empty) / f"{preset}.html"
                pages[preset].write_text(build_page(recording.encode()))
            page = browser.new_page(viewport=VIEWER_SIZE, color_scheme=scheme)
            page.goto(f"{pages[preset].as_uri()}#{where}")
            page.wait_for_selector("#message[hidden]", state="attached")
            page.wait_for_timeout(1000)  # until it has been drawn
            Image.open(BytesIO(page.screenshot())).convert("RGB").save(target / f"{name}.webp", quality=82, method=6)
            page.close()
        browser.close()
    return [target / f"{name}.webp" for name in VIEWS]


PICTURES: dict[str, Callable[[Path], Any]] = {
    "thumbnails": thumbnails,
    "frame": frame,
    "speed": speed,
    "guides": guides,
    "viewer": viewer,
}


def main() -> None:
    """Make the pictures that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pictures", nargs="*", choices=[[], *PICTURES, *PRESETS], help="pictures; all unless some are named")
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder of the pictures")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name in arguments.pictures or PICTURES:
        print(PICTURES[name](arguments.out) if name in PICTURES else thumbnail(name, arguments.out / f"{name}.png"))


if __name__ == "__main__":
    main()
