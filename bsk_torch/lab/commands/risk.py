"""``bsk-torch risk``: probabilities of losses and other rare events, and the ways to them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated

from bsk_torch.cli.declaration import AtOnce, EnvironmentOptions, JsonFile, OfPreset, Options, Policy, Trust, flag
from bsk_torch.cli.shared import check_writable, drawing, extra, made, preset_options
from bsk_torch.cli.terminal import activity, echo, fail, refusing, working
from bsk_torch.files import write_file
from bsk_torch.tables import print_table

if TYPE_CHECKING:
    from bsk_torch.cli.policies import NamedPolicy
    from bsk_torch.lab.risk.estimate import Risk, Shift, Way

SHOWN = 6
"""Number of drawn quantities in the table."""

CARRIED = 0.3
"""Share of one episode in an estimate above which a line warns of it."""


def estimate_risk(
    policy: Policy,
    preset: OfPreset = None,
    option: Options = None,
    event: Annotated[str, flag("EVENT", "'death', or a property with a limit such as 'battery_charge_fraction<0.05'.")] = "death",
    level: Annotated[
        list[str] | None,
        flag(
            "NAME",
            "What is followed toward a death: battery, wheels, buffer or distance; repeatable. Default: the nearest limit.",
        ),
    ] = None,
    method: Annotated[
        str,
        flag(
            "NAME", "subset: small steps of everything random. screen: flies the seeds whose draws at reset are most dangerous."
        ),
    ] = "subset",
    episodes: Annotated[int, flag("N", "Episodes of a repetition, a multiple of 10.", min=20)] = 1000,
    repetitions: Annotated[int, flag("R", "Independent repetitions.", min=4)] = 8,
    smallest: Annotated[float, flag("P", "Probability at which subset simulation ends its search for the event.")] = 1e-9,
    pool: Annotated[int, flag("N", "Seeds that each repetition screens.", min=40)] = 1_000_000,
    seed: Annotated[int, flag("N", "Seed of the estimate.", min=0)] = 0,
    num_envs: AtOnce = 512,
    save: Annotated[Path | None, flag("FILE", "JSON file for a typical episode of each way, to fly it again.")] = None,
    draw: Annotated[Path | None, flag("FILE", "Picture (.png, .svg, .pdf) of the most typical episode.")] = None,
    out: JsonFile = None,
    trust: Trust = False,
    *,
    options: EnvironmentOptions,
) -> None:
    """Estimate the probability of a rare loss, with its interval, and show the ways to it.

    Initial states, scenarios, faults and noise are followed in small steps toward the event (subset simulation). Where draws at
    reset decide about the event, --method screen needs fewer simulated seconds. An event that never happens has an upper limit.

    Examples:
        bsk-torch risk pretrained --preset NadirScan-v1 --save deaths.json
        bsk-torch risk rule --event 'battery_charge_fraction<0.05' --draw low.png
        bsk-torch risk rule --time-limit 900 --method screen
        bsk-torch risk runs/scan --level battery --episodes 1000 --out risk.json
    """
    from bsk_torch.cli.policies import flown
    from bsk_torch.env import SatelliteTasking
    from bsk_torch.lab.risk.estimate import risk
    from bsk_torch.lab.risk.rare_flights import save_paths

    figure = drawing(draw, "bsk_torch.viz.figures.timeline")
    check_writable(save, out)
    options = preset_options(option) | options
    named, env, actor = flown(policy, preset, num_envs, options, trust)
    if draw is not None and not isinstance(env, SatelliteTasking):
        fail(f"--draw shows the episode of one satellite; {named.preset} has many")
    with (
        refusing(why=f"the risk in {named.preset} cannot be estimated: "),
        working(f"estimating the risk of {named.label}") as show,
    ):
        estimate = risk(
            env, actor, event=event, level=level or None, method=method, episodes=episodes, repetitions=repetitions,
            smallest=smallest, pool=pool, seed=seed, tell=show,
        )  # fmt: skip
    activity.report()
    echo("\n".join(lines_of(estimate, f"{named.preset}, {named.label}")))
    print_ways(estimate)
    settings = {name: value for name, value in named.options(options).items() if name not in ("backend", "device")}
    about = {"preset": named.preset, "policy": Path(policy).name, "options": settings}
    if save is not None and estimate.ways:
        save_paths(save, about | {"event": estimate.event}, estimate.paths(), estimate.actions)
        echo(f"{save}: a typical episode of each way")
    if out is not None:
        write_file(out, json.dumps(about | estimate.to_dict(), indent=1, allow_nan=False, default=str) + "\n")
    if draw is not None and estimate.ways:
        draw_way(estimate, named, options, draw, figure)
    for path in (save, draw):
        if path is not None and not estimate.ways:
            echo(f"{path} was not written: the event was not seen")


def lines_of(risk: Risk, title: str) -> Iterator[str]:
    """Yield the estimate in lines of at most 80 characters."""
    from bsk_torch.lab.risk.subset import RARER

    mean, low, high = risk.probability
    screening, several = risk.screening, f"{risk.tally.episodes:,} episodes of {risk.seconds:,.0f} s on average"
    yield f"{title}: {risk.event}"
    if mean == 0.0:
        yield f"not seen; its probability is at most {high:.1e}, with a confidence of 95 %"
        why = "smaller probabilities are not searched" if risk.why == RARER else "no episode came nearer; --episodes may help"
        yield f"the highest level is {risk.highest:.4g}: {why}"
    else:
        yield f"probability {mean:.2e}, 95 % interval {low:.1e} to {high:.1e}"
        if risk.error * len(risk.estimates) ** 0.5 > 1.0:
            yield "single repetitions differ by more than their mean: use more --episodes"
    if screening is None:
        yield f"{several}, {len(risk.thresholds)} thresholds"
    else:
        yield f"{several}, {screening.learned:,} of them to learn from"
        yield f"screened: {screening.pool:,} seeds in each of {len(risk.estimates)} repetitions"
        yield f"draws at reset explain {screening.explained:.0%} of the variance of levels"
        if screening.largest > CARRIED:
            yield f"one episode carries {screening.largest:.0%} of the estimate: do not rely on its interval"
    if risk.saved == risk.saved:
        yield f"as exact as {risk.saved:,.1f} times as many simulated seconds of independent episodes"


def print_ways(risk: Risk) -> None:
    """Print the ways to the event, and the drawn quantities that differ most."""
    if not risk.ways:
        return
    echo("")
    print_table([of_way(way) for way in risk.ways], "Ways to the event", left=("checks that fail",))
    print_table(
        [of_shift(shift) for shift in risk.shifts[:SHOWN]],
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


def draw_way(risk: Risk, named: NamedPolicy, options: Mapping[str, object], path: Path, figure: ModuleType) -> None:
    """Draw the most typical episode over time, with the moment of the event."""
    import torch

    from bsk_torch.rand import blended
    from bsk_torch.rl.evaluation.replay import script

    typical = risk.paths().take(torch.tensor([0]))
    seed = int(typical.seeds[0])
    with working("drawing"), blended(typical.blend()):
        one = made(named.preset, 1, named.options(options) | {"env_ids": [0]})
        episode = extra("bsk_torch.viz.episodes").record(script(torch.tensor(risk.actions[0])[None, :, 0]), one, seed=seed)
    moment = float(typical.flown["time"][0])
    figure.timeline(episode, path, f"{named.preset}, {named.label}: {risk.event}", [(moment, risk.event)])
    echo(f"{path}: an episode with the event after {moment:,.0f} s; half of them are before {risk.ways[0].time[1]:,.0f} s")
