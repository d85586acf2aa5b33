"""``bsk-torch explain``: why a policy's satellites die, and whether any policy could have saved them."""

from __future__ import annotations

import dataclasses
import json
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Any

from bsk_torch.cli.declaration import EnvironmentOptions, JsonFile, OfPreset, Policy, Trust, flag
from bsk_torch.cli.shared import check_writable, drawing, extra, made, seed_range
from bsk_torch.cli.terminal import activity, echo, fail, refusing, working
from bsk_torch.files import write_file
from bsk_torch.tables import print_table

if TYPE_CHECKING:
    from torch import Tensor

    from bsk_torch.env import SatelliteTasking, Tasking
    from bsk_torch.lab.audit.failures import Failure, Moment
    from bsk_torch.rl.evaluation.replay import Flown

LOST_AFTER = "lost after"
"""Column with the number of decisions from the last chance to the first that is proven to be too late."""

EXPENDABLE = ("dark (s)", "wheels (rpm)", LOST_AFTER, "charge", "outcome")
"""Columns to leave out where the terminal is narrow, the first one first."""


def explain_failures(
    policy: Policy,
    preset: OfPreset = None,
    seeds: Annotated[str, flag("A:B", "Episodes of the seeds A to B - 1, or of a single seed.", "--seeds", "--seed")] = "0:2000",
    starts: Annotated[
        str | None, flag("A:B", "Seeds of episodes in which to search for surviving actions, regardless of the policy.")
    ] = None,
    num_envs: Annotated[int, flag("N", "Episodes, or states of a search, at once.", min=1)] = 1024,
    draw: Annotated[
        Path | None, flag("FILE", "Picture (.png, .svg, .pdf) of the first death, with its cause and last chance.")
    ] = None,
    out: JsonFile = None,
    trust: Trust = False,
    *,
    options: EnvironmentOptions,
) -> None:
    """Find actions that would have saved each lost satellite, or prove that none exist.

    For each death, search for surviving actions from the start of the episode, and then from the latest possible decision. An
    episode counts as lost only with a proof.

    Examples:
        bsk-torch explain runs/scan --seeds 0:200
        bsk-torch explain runs/scan --seed 11 --draw death.png
        bsk-torch explain random --preset NadirScan-v1 --seeds 0:50 --out deaths.json
    """
    import torch

    from bsk_torch.cli.policies import flown as flown_by
    from bsk_torch.env import SatelliteTasking
    from bsk_torch.lab.audit.counterfactual import check_searchable
    from bsk_torch.lab.audit.failures import explain

    episodes, start_seeds = seed_range(seeds), None if starts is None else seed_range(starts, "--starts")
    figure = drawing(draw, "bsk_torch.viz.figures.timeline")
    check_writable(out)
    named, env, actor = flown_by(policy, preset, num_envs, options, trust)
    if not isinstance(env, SatelliteTasking):
        fail(f"{named.preset} has many satellites; failures are explained of one")
    begin = time.perf_counter()
    with refusing(why=f"failures in {named.preset} cannot be explained: "):
        check_searchable(env)
        with working(f"playing {len(episodes)} episodes") as show:
            flown, failures = explain(actor, env, torch.tensor(episodes), show)
            figures = summary(flown, failures)
            if start_seeds is not None:
                show(f"searching for actions that survive {len(start_seeds)} episodes")
                figures["starts"] = survivable(env, start_seeds)
    activity.report()
    if failures:
        print_table([cells(failure) for failure in failures], expendable=EXPENDABLE, left=("cause", "action then"))
    echo("\n".join(lines_of(figures)))
    if out is not None:
        about = {"policy": Path(policy).name, "seeds": [episodes.start, episodes.stop]}
        save(out, about | figures | {"seconds": round(time.perf_counter() - begin, 1)}, failures)
    if draw is not None and failures:
        with working("drawing"):
            one = made(named.preset, 1, named.options(options) | {"env_ids": [0]})
            draw_failure(one, failures[0], flown.actions[episodes.index(failures[0].seed)], draw, figure)
        echo(f"{draw}: the death in the episode of seed {failures[0].seed}")
    elif draw is not None:
        echo(f"{draw} was not drawn: no satellite died")


def summary(flown: Flown, failures: Sequence[Failure]) -> dict[str, object]:
    """Return figures of all episodes: returns, deaths by cause and outcome, and bounds on the survival of the best policy."""
    from bsk_torch.lab.audit.counterfactual import LOST, OPEN, SAVED
    from bsk_torch.rl.evaluation.statistics import confidence

    outcomes, n = Counter(failure.outcome for failure in failures), len(flown.survived)
    returns = confidence(flown.returns)
    return {
        "episodes": n,
        "return": {"mean": round(returns.mean, 4), "half_width": round(returns.half_width, 4)},
        "died": len(failures),
        "causes": dict(Counter(failure.cause for failure in failures)),
        **{outcome: outcomes[outcome] for outcome in (SAVED, LOST, OPEN)},
        "survival": 1.0 - len(failures) / n,
        "survival_of_the_best": {"at_least": 1.0 - (outcomes[LOST] + outcomes[OPEN]) / n, "at_most": 1.0 - outcomes[LOST] / n},
        "starts_of_the_lost": statistics([failure.start for failure in failures if failure.outcome == LOST]),
        "last_chances": statistics([failure.last_chance for failure in failures if failure.last_chance]),
    }


def survivable(env: SatelliteTasking, seeds: range) -> dict[str, object]:
    """Return how many episodes a plan survives.

    If that is all n of them, ``lost_at_most`` is the 95 % bound of Clopper and Pearson, 1 - 0.05^(1/n), on how often none does.
    """
    import torch

    from bsk_torch.lab.audit.failures import can_be_saved

    count, n = int(can_be_saved(env, torch.tensor(seeds)).sum()), len(seeds)
    figures: dict[str, object] = {"seeds": [seeds.start, seeds.stop], "survived": count}
    return figures | ({"lost_at_most": float(f"{1.0 - 0.05 ** (1.0 / n):.2g}")} if count == n else {})


def statistics(moments: Sequence[Moment]) -> dict[str, object]:
    """Return the least, median and largest value of the moments' numbers, and how often each action was chosen."""
    import torch

    if not moments:
        return {}
    numbers = {
        name: torch.tensor([getattr(moment, name) for moment in moments], dtype=torch.float64)
        for name in ("charge", "wheel_rpm", "dark")
    }
    ranges = {name: [round(float(f()), 4) for f in (v.min, v.median, v.max)] for name, v in numbers.items()}
    return {**ranges, "actions": dict(Counter(moment.action for moment in moments))}


def lines_of(figures: Mapping[str, Any]) -> Iterator[str]:
    """Yield what :func:`summary` has found, in lines of at most 80 characters."""
    from bsk_torch.lab.audit.counterfactual import LOST, OPEN, SAVED

    died, n, best = figures["died"], figures["episodes"], figures["survival_of_the_best"]
    yield f"{died} of {n} episodes end in death: survival {figures['survival']:.1%}"
    if died:
        yield f"could be saved: {figures[SAVED]}; proven lost from the start: {figures[LOST]}; open: {figures[OPEN]}"
        ends = dict.fromkeys(f"{best[end]:.1%}" for end in ("at_least", "at_most"))
        yield f"survival of the best policy: {' to '.join(ends)}"
    if "starts" in figures:
        first, end = figures["starts"]["seeds"]
        yield f"starts of seeds {first}:{end} that a plan survives: {figures['starts']['survived']} of {end - first}"


def cells(failure: Failure) -> dict[str, str]:
    """Return a row of the table: the last chance, and the number of decisions after which the episode is proven to be lost."""
    moment = failure.last_chance or failure.start
    return {
        "seed": f"{failure.seed}",
        "cause": failure.cause.replace("_valid", ""),
        "died (s)": f"{failure.died:.0f}",
        "outcome": failure.outcome,
        "last chance (s)": f"{moment.time:.0f}" if failure.last_chance else "none",
        "action then": moment.action.removeprefix("action_"),
        "charge": f"{moment.charge:.1%}",
        "wheels (rpm)": f"{moment.wheel_rpm:.0f}",
        "dark (s)": f"{moment.dark:.0f}",
        LOST_AFTER: f"{failure.lost_from - moment.decision}",
    }


def draw_failure(env: Tasking, failure: Failure, actions: Tensor, path: Path, figure: ModuleType) -> None:
    """Draw the episode of a failure over time, with its cause and its last chance, as a replay of ``actions`` [T] in ``env``."""
    from bsk_torch.lab.audit.counterfactual import LOST, OPEN, SAVED
    from bsk_torch.rl.evaluation.replay import script

    fates = {SAVED: "could be saved", LOST: "could not be saved", OPEN: "unknown whether it could be saved"}
    episode = extra("bsk_torch.viz.episodes").record(script(actions.clamp(min=0).unsqueeze(0)), env, seed=failure.seed)
    cause = failure.cause.replace("_valid", "")
    marks = [(failure.died, f"died: {cause}")]
    if failure.last_chance is not None:
        rescue = "" if failure.rescue is None else f": a rescue begins with {rescue_action(env, failure)}"
        marks.append((failure.last_chance.time, f"last chance{rescue}"))
    figure.timeline(episode, path, f"Seed {failure.seed}, {fates[failure.outcome]}", marks)


def rescue_action(env: Tasking, failure: Failure) -> str:
    """Return the action at the last chance that the rescue takes instead of the policy's."""
    from bsk_torch.env import SatelliteTasking

    assert failure.last_chance is not None
    assert failure.rescue is not None
    assert isinstance(env, SatelliteTasking)
    number = failure.rescue[min(failure.last_chance.decision, len(failure.rescue) - 1)]
    return env.satellite.action_description[number].removeprefix("action_")


def save(path: Path, figures: dict[str, object], failures: Sequence[Failure]) -> None:
    """Write figures line by line, then a line for each failure."""
    lines = [f"{json.dumps(name)}: {json.dumps(value)}" for name, value in figures.items()]
    entries = ",\n  ".join(json.dumps(dataclasses.asdict(failure)) for failure in failures)
    write_file(path, "{\n " + ",\n ".join([*lines, f'"failures": [\n  {entries}\n ]']) + "\n}\n")
