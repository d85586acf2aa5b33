"""Every argument of every preset, with every kind of wrong value: an error that names the argument, or finite numbers.

All cases are drawn, which is what checks them; some are played, and all of them at night.
"""

import functools
import logging
import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import pytest
import torch

import bsk_torch
from bsk_torch.rand import first_key
from bsk_torch.sim.arguments.values import Arguments, merge
from bsk_torch.sim.assembly.satellite_type import fitted
from bsk_torch.sim.simulator import Simulator

SMALL: dict[str, dict[str, Any]] = {
    "NadirScan-v1": {},
    "AEOS-v1": dict(n_targets=10),
    "AEOSPower-v1": dict(n_targets=10),
    "AEOSCity-v1": dict(n_targets=10),
    "CloudyAEOS-v1": dict(n_targets=10),
    "Constellation-v1": dict(n_satellites=2, n_planes=1, n_targets=10),
    "AEOSConstellation-v1": dict(n_satellites=2, n_targets=10),
    "RelayConstellation-v1": dict(n_imagers=1, n_relays=1, n_targets=10),
}
"""Presets, at the smallest size."""

NUMBERS = (0.0, -1.0, math.nan, math.inf, -math.inf, 1e308)
OTHERS = (None, "x", [[1.0, 2.0], [3.0, 4.0]], {"a": 1})

PLAYED = 13
"""One case in so many, of the preset that is built fastest, is played in every run of the tests."""


class Case(NamedTuple):
    preset: str
    where: str
    name: str
    value: Any


def make(preset: str, **options: Any) -> Any:
    given = dict(num_envs=2, seed=3, backend="eager", time_limit=600.0, max_step_duration=4.0)
    return bsk_torch.make(preset, **(SMALL[preset] | given | options))


@functools.cache
def built(preset: str) -> Any:
    return make(preset)


def values(shape: tuple[int, ...]) -> list[Any]:
    return [*((x,) * shape[0] if shape else x for x in NUMBERS), *OTHERS]


def cases(preset: str) -> Iterator[Case]:
    env = built(preset)
    for where, table in (("sat_args", env.default_sat_args()), ("world_args", env.default_world_args())):
        for name, arg in table.rows.items():
            for value in values(tuple(size or 3 for size in arg.dims)):
                yield Case(preset, where, name, value)


def draw(simulator: Simulator, where: str, name: str, value: Any) -> None:
    """Do what the construction of a simulation and a reset do with arguments, and check that numbers are finite."""
    arguments = simulator.type.arguments
    old: Arguments = getattr(arguments, where)
    given = {**old.given, name: value}
    parts = fitted(arguments.parts, {**arguments.world_args.given, **arguments.sat_args.given, **given})

    def of_title(components: Iterable[Any]) -> list[Any]:
        return [part for part in components if not part.args or all(arg.name in old.table for arg in part.args)]

    new = Arguments(of_title(arguments.parts), given, where, old.columns).of_components(of_title(parts), given)
    trial = replace(arguments, parts=parts, _checked=set(), **{where: new})
    drawn = trial.draw(first_key(2), overrides=arguments.randomize(first_key(2)))
    for title in ("initial", "prepare"):
        for field, number in merge(drawn, trial.parts, title).items():
            assert not bool(torch.isnan(number).any()), f"{field} is NaN"
            assert title == "prepare" or bool(torch.isfinite(number).all()), f"{field} is infinite"


MODELS = ["NadirScan-v1", "AEOSPower-v1", "RelayConstellation-v1"]
"""Presets whose satellites together have all components."""


@pytest.mark.parametrize("preset", MODELS)
def test_draws(preset, caplog):
    caplog.set_level(logging.ERROR)
    wrong, count = [], 0
    for case in cases(preset):
        simulators = built(preset).fleet.simulators if case.where == "sat_args" else built(preset).fleet.simulators[:1]
        for simulator in simulators:
            if case.name not in getattr(simulator.type.arguments, case.where).table:
                continue
            count += 1
            try:
                draw(simulator, case.where, case.name, case.value)
            except (ValueError, KeyError) as error:
                if case.name not in str(error):
                    wrong.append(f"{case}: {error}")
            except Exception as error:
                wrong.append(f"{case}: {type(error).__name__}: {error}")
    assert not wrong, "\n".join(wrong)
    assert count > 400


def play(case: Case) -> str:
    """Return what is wrong after a step of an environment with a value; an empty string for an error that names it."""
    try:
        env = make(case.preset, **{case.where: {case.name: case.value}})
        td = env.rand_step(env.reset())["next"]
        env.check_finite()
    except (ValueError, KeyError, TypeError) as error:
        return "" if case.name in str(error) else f"{case}: {error}"
    except Exception as error:
        return f"{case}: {type(error).__name__}: {error}"
    infinite = [key for key, leaf in td.items(True, True) if leaf.is_floating_point() and not bool(leaf.isfinite().all())]
    return f"{case}: {infinite}" if infinite else ""


def test_some_episodes():
    chosen = list(cases("NadirScan-v1"))[::PLAYED]
    assert len(chosen) > 25
    wrong = [words for words in map(play, chosen) if words]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("preset", SMALL)
@pytest.mark.nightly
def test_all_episodes(preset):
    wrong = [words for words in map(play, cases(preset)) if words]
    assert not wrong, "\n".join(wrong)
