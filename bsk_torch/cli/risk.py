"""``bsk-torch risk``: probabilities of losses and other rare events, and the ways to them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import torch

from bsk_torch.cli.policies import NamedFunction, NamedPolicy, named_policy
from bsk_torch.cli.shared import check_picture, check_writable, environment_options, extra, made, preset_options
from bsk_torch.cli.terminal import activity, echo, fail, working
from bsk_torch.env import SatelliteTasking
from bsk_torch.files import write_file
from bsk_torch.lab.risk.estimate import Risk, Shift, Way, risk
from bsk_torch.lab.risk.rare_flights import save_paths
from bsk_torch.lab.risk.subset import RARER
from bsk_torch.rand import blended
from bsk_torch.rl.evaluation.replay import script
from bsk_torch.tables import print_table

SHOWN = 6
"""Number of drawn quantities in the table."""

CARRIED = 0.3
"""Share of one episode in an estimate above which a line warns of it."""


def estimate_risk(
    policy: str,
    preset: str | None,
    option: list[str] | None,
    event: str,
    level: list[str] | None,
    method: str,
    episodes: int,
    repetitions: int,
    smallest: float,
    pool: int,
    seed: int,
    num_envs: int,
    save: Path | None,
    draw: Path | None,
    out: Path | None,
    threads: int,
    backend: str,
    device: str,
    time_limit: float | None,
) -> None:
    """Estimate the probability of an event, and print the ways to it; see :mod:`bsk_torch.cli.main`."""
    torch.set_num_threads(threads)
    for path in (save, draw, out):
        check_writable(path)
    if draw is not None:
        check_picture("--draw", draw)
        extra("bsk_torch.viz.figures.timeline")
    named = named_policy(policy, preset)
    options = preset_options(option) | environment_options(backend, device, time_limit)
    env = named.environment(num_envs, options)
    if draw is not None and not isinstance(env, SatelliteTasking):
        fail(f"--draw shows the episode of one satellite; {named.preset} has many")
    actor = named.actor(env, device)
    try:
        with working(f"estimating the risk of {named.label}") as show:
            found = risk(
                env, actor, event=event, level=level or None, method=method, episodes=episodes, repetitions=repetitions,
                smallest=smallest, pool=pool, seed=seed, tell=show,
            )  # fmt: skip
    except ValueError as error:
        fail(f"the risk in {named.preset} cannot be estimated: {error}")
    activity.report()
    echo("\n".join(told(found, f"{named.preset}, {named.label}")))
    print_ways(found)
    kept = {name: value for name, value in named.options(options).items() if name not in ("backend", "device")}
    about = {"preset": named.preset, "policy": Path(policy).name, "options": kept}
    if save is not None and found.ways:
        save_paths(save, about | {"event": found.event}, found.paths(), found.actions)
        echo(f"{save}: a typical episode of each way")
    if out is not None:
        write_file(out, json.dumps(about | found.to_dict(), indent=1, allow_nan=False, default=str) + "\n")
    if draw is not None and found.ways:
        draw_way(found, named, options, draw)
    for path in (save, draw):
        if path is not None and not found.ways:
            echo(f"{path} was not written: the event was not seen")


def told(found: Risk, title: str) -> Iterator[str]:
    """Yield the estimate in lines of at most 80 characters."""
    mean, low, high = found.probability
    screening, several = found.screening, f"{found.tally.episodes:,} episodes of {found.seconds:,.0f} s on average"
    yield f"{title}: {found.event}"
    if mean == 0.0:
        yield f"not seen; its probability is at most {high:.1e}, with a confidence of 95 %"
        why = "smaller probabilities are not searched" if found.why == RARER else "no episode came nearer; --episodes may help"
        yield f"the highest level is {found.highest:.4g}: {why}"
    else:
        yield f"probability {mean:.2e}, 95 % interval {low:.1e} to {high:.1e}"
        if found.error * len(found.estimates) ** 0.5 > 1.0:
            yield "single repetitions differ by more than their mean: use more --episodes"
    if screening is None:
        yield f"{several}, {len(found.thresholds)} thresholds"
    else:
        yield f"{several}, {screening.learned:,} of them to learn from"
        yield f"screened: {screening.pool:,} seeds in each of {len(found.estimates)} repetitions"
        yield f"draws at reset explain {screening.explained:.0%} of the variance of levels"
        if screening.largest > CARRIED:
            yield f"one episode carries {screening.largest:.0%} of the estimate: do not rely on its interval"
    if found.saved == found.saved:
        yield f"as exact as {found.saved:,.1f} times as many simulated seconds of independent episodes"


def print_ways(found: Risk) -> None:
    """Print the ways to the event, and the drawn quantities that differ most."""
    if not found.ways:
        return
    echo("")
    print_table([of_way(way) for way in found.ways], "Ways to the event", left=("checks that fail",))
    print_table(
        [of_shift(shift) for shift in found.shifts[:SHOWN]],
        "What was drawn at reset (medians), and how often it is larger with the event",
        left=("quantity",),
    )


def of_way(way: Way) -> dict[str, str]:
    """Return the cells of a way."""
    early, median, late = way.time
    return {
        "checks that fail": ", ".join(way.cause) or "none",
        "share": f"{way.share:.0%}",
        "time of the event (s): 5 %": f"{early:,.0f}",
        "median": f"{median:,.0f}",
        "95 %": f"{late:,.0f}",
    }


def of_shift(shift: Shift) -> dict[str, str]:
    """Return the cells of a drawn quantity."""
    medians = (f"{values[1]:.4g}" if values[1] < float("inf") else "never" for values in (shift.event, shift.all))
    return {
        "quantity": shift.name,
        **dict(zip(("with the event", "all episodes"), medians, strict=True)),
        "larger": f"{shift.larger:.0%}",
    }


def draw_way(found: Risk, named: NamedPolicy | NamedFunction, options: Mapping[str, Any], path: Path) -> None:
    """Draw the most typical episode over time, with the moment of the event."""
    recorder, figure = extra("bsk_torch.viz.recorders.track"), extra("bsk_torch.viz.figures.timeline")
    typical = found.paths().take(torch.tensor([0]))
    time = found.ways[0].time
    seed = int(typical.seeds[0])
    with working("drawing"), blended(typical.blend()):
        one = made(named.preset, 1, named.options(options) | {"env_ids": [0]})
        episode = recorder.record_track(script(torch.tensor(found.actions[0])[None, :, 0]), one, seed=seed)
    moment = float(typical.flown.notes["time"][0])
    figure.timeline(episode, path, f"{named.preset}, {named.label}: {found.event}", [(moment, found.event)])
    echo(f"{path}: an episode with the event after {moment:,.0f} s; half of them are before {time[1]:,.0f} s")
