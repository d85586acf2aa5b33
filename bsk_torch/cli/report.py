"""``bsk-torch report``: one HTML page about a run."""

from __future__ import annotations

import platform
from dataclasses import asdict, replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bsk_torch.cli.declaration import MachineOptions, flag
from bsk_torch.cli.shared import check_writable, environment, extra
from bsk_torch.cli.terminal import echo, refusing, working

if TYPE_CHECKING:
    from torch import Tensor

    from bsk_torch.rl.training.config import PPOConfig

REPORT = "report.html"
"""File of the report."""

VERSIONS = ("bsk_torch", "torch", "torchrl", "matplotlib")
"""Packages whose versions a report notes."""


def report(
    run: Annotated[Path, typer.Argument(help="Run folder.", show_default=False)],
    episodes: Annotated[int, flag("N", "Unseen episodes, of which the best, the median and the worst are shown.", min=1)] = 64,
    *,
    options: MachineOptions,
) -> None:
    """Write report.html into a run folder: learning curves, final comparison, episodes on maps. Needs the extra viz.

    Examples:
        bsk-torch report runs/scan
        bsk-torch report runs/scan --episodes 256
    """
    from bsk_torch.cli.run_folder import columns, command_of, results, run_card, run_config
    from bsk_torch.rl.evaluation.results import EVALUATION
    from bsk_torch.rl.training.log import EVALUATIONS, LOG

    config = run_config(run)
    card, log, evaluations = run_card(run, options["device"]), columns(run / LOG), columns(run / EVALUATIONS)
    comparison = results(run / EVALUATION)
    check_writable(run / REPORT)
    pages = extra("bsk_torch.viz.report.page")
    shown, flights = _episodes(config, card, config.options | options, episodes)
    data = pages.RunData(
        name=run.resolve().name,
        preset=config.preset,
        log=log,
        evaluations=evaluations,
        results=comparison,
        episodes=[pages.Chosen(*chosen) for chosen in shown],
        flights=flights,
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
    echo(f"{path} ({path.stat().st_size / 1e6:.1f} MB)\nopen it in a browser: {path.resolve().as_uri()}")


def _episodes(
    config: PPOConfig, card: dict[str, Any], options: dict[str, Any], episodes: int
) -> tuple[list[tuple[str, int, Any]], str]:
    """The reason, the number and the recording of the best, the median and the worst of unseen episodes; and their viewer."""
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
    made = {why: environment(config.preset, 1, options | {"env_ids": [number]}) for why, number in chosen.items()}
    shown = []
    for why, number in chosen.items():
        with working(f"playing the {why} episode again"):
            shown.append((why, number, extra("bsk_torch.viz.episodes").record(policy, made[why], seed=seed)))
    with working("recording these episodes for the viewer"):
        labels = {f"{why} episode (no. {number})": made[why] for why, number in chosen.items()}
        return shown, _viewer(labels, policy, seed, config.preset)


def _viewer(episodes: dict[str, Any], policy: Any, seed: int, preset: str) -> str:
    """Page of the viewer with the first episode of each environment; empty for teams with one agent, which it cannot show."""
    recorder = extra("bsk_torch.viewer.recorder")
    env = next(iter(episodes.values()))
    if not recorder.has_agents(env):
        return ""
    scenes, tracks = [], []
    for k, (label, one) in enumerate(episodes.items()):
        flight = recorder.Flight(one, policy)
        tracks.append(replace(flight.fly(seed).track, label=label, scene=k))
        scenes.append(flight.scene)
    page: str = recorder.recording_of(env, scenes, tracks, f"{preset}: episodes of the report", preset, "trained").html()
    return page


def extremes(returns: Tensor) -> dict[str, int]:
    """Numbers of the episodes with the highest, the median and the lowest of the ``returns`` [n]; each only once."""
    order = returns.argsort().tolist()
    chosen = {"best": order[-1], "median": order[(len(order) - 1) // 2], "worst": order[0]}
    return {why: number for k, (why, number) in enumerate(chosen.items()) if number not in list(chosen.values())[:k]}
