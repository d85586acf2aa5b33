"""``bsk-torch report``: one HTML page about a run."""

from __future__ import annotations

import platform
from dataclasses import asdict, replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bsk_torch._rooms import absent_room
from bsk_torch.cli.declaration import MachineOptions, OfPreset, flag
from bsk_torch.cli.shared import check_writable, environment, extra
from bsk_torch.cli.terminal import echo, refusing, working

if TYPE_CHECKING:
    from torch import Tensor

    from bsk_torch.recording import Recording
    from bsk_torch.rl.training.config import PPOConfig

REPORT = "report.html"
"""File of the report."""

VERSIONS = ("bsk_torch", "torch", "torchrl", "matplotlib")
"""Packages whose versions a report notes."""


def report(
    run: Annotated[Path, typer.Argument(help="Run folder.", show_default=False)],
    preset: OfPreset = None,
    episodes: Annotated[int, flag("N", "Unseen episodes, of which the best, the median and the worst are shown.", min=1)] = 64,
    *,
    options: MachineOptions,
) -> None:
    """Write report.html into a run folder: learning curves, final comparison, episodes on maps. Needs the extra viz.

    Examples:
        bsk-torch report runs/scan
        bsk-torch report runs/scan --episodes 256
        bsk-torch report runs/mine --preset mine.py:scanner
    """
    from bsk_torch.cli.policies import warn_of_objects
    from bsk_torch.cli.run_folder import columns, command_of, results, run_card, run_config
    from bsk_torch.rl.evaluation.results import EVALUATION
    from bsk_torch.rl.policies.files import OBJECTS
    from bsk_torch.rl.training.log import EVALUATIONS, LOG

    config = run_config(run)
    config = config if preset is None else replace(config, preset=preset)
    card, log, evaluations = run_card(run, options["device"]), columns(run / LOG), columns(run / EVALUATIONS)
    comparison = results(run / EVALUATION)
    check_writable(run / REPORT)
    pages = extra("bsk_torch.viz.report.page")
    warn_of_objects(str(run), card, config.preset, ())
    kept = {name: value for name, value in config.options.items() if name not in card.get(OBJECTS, [])}
    chosen, recording = _episodes(config, card, kept | options, episodes)
    viewer = absent_room("bsk_torch.viewer.page")
    data = pages.RunData(
        name=run.resolve().name,
        preset=config.preset,
        log=log,
        evaluations=evaluations,
        results=comparison,
        episodes=[pages.Chosen(why, number, pages.episode_of(recording, k)) for k, (why, number) in enumerate(chosen.items())],
        flights="" if viewer else recording.html(),
        played=episodes,
        config=asdict(config),
        facts={
            "policy trained with": f"bsk_torch {card['bsk_torch']}",
            "report made with": ", ".join(f"{name} {version(name)}" for name in VERSIONS),
            "Python": platform.python_version(),
        },
        command=command_of(config),
    )
    path = pages.write_report(data, run / REPORT)
    if viewer:
        echo(f"the report does not play its episodes: this copy of bsk_torch has no folder {viewer}")
    echo(f"{path} ({path.stat().st_size / 1e6:.1f} MB)\nopen it in a browser: {path.resolve().as_uri()}")


def _episodes(
    config: PPOConfig, card: dict[str, Any], options: dict[str, Any], episodes: int
) -> tuple[dict[str, int], Recording]:
    """The numbers of the best, the median and the worst of unseen episodes, and their recording."""
    from bsk_torch.recording import record
    from bsk_torch.rl.evaluation.evaluate import FRESH, evaluate
    from bsk_torch.rl.policies.files import build_policy, check_fits
    from bsk_torch.rl.policies.shared_policy import shared

    env = environment(config.preset, episodes, options)
    with refusing():
        check_fits(card, env, config.preset)
        policy = shared(build_policy(card, options["device"]), env)
    seed = config.seed + FRESH
    with working(f"playing {episodes} unseen episodes"):
        returns = evaluate(policy, env, seed=seed).returns
    chosen = extremes(returns)
    recordings = []
    for why, number in chosen.items():
        with working(f"playing the {why} episode again"):
            single = environment(config.preset, 1, options | {"env_ids": [number]})
            recordings.append(record(single, policy, seed=seed, preset=config.preset, label="trained"))
    labels = (f"{why} episode (no. {number})" for why, number in chosen.items())
    tracks = [
        replace(part.tracks[0], scene=k, label=label) for k, (part, label) in enumerate(zip(recordings, labels, strict=True))
    ]
    title, scenes = f"{config.preset}: episodes of the report", [part.scenes[0] for part in recordings]
    return chosen, replace(recordings[0], title=title, scenes=scenes, tracks=tracks)


def extremes(returns: Tensor) -> dict[str, int]:
    """Numbers of the episodes with the highest, the median and the lowest of the ``returns`` [n]; each only once."""
    order = returns.argsort().tolist()
    chosen = {"best": order[-1], "median": order[(len(order) - 1) // 2], "worst": order[0]}
    return {why: number for k, (why, number) in enumerate(chosen.items()) if number not in list(chosen.values())[:k]}
