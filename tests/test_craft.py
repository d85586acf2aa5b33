"""Spacecraft of the library: an orbit of each, stable gains at all tick lengths, and the page that lists their numbers."""

import ast
import itertools
import logging
import math
import re
from pathlib import Path
from typing import Any

import pytest
import torch

from bsk_torch import SatelliteTasking, act, craft, data, dyn, fsw, obs, sats, scene
from bsk_torch.constants import SOLAR_FLUX
from bsk_torch.rand import first_key
from tests.support.refusals import check_refusals, refusal

PAGE = Path(__file__).parents[1] / "docs" / "how_to" / "spacecraft.md"

LAWS = {"cubesat": "steering", "imager": "feedback", "agile_imager": "steering", "aeos_bench": "feedback"}
"""The spacecraft, with their control law by default."""

NADIR, CHARGE, DESAT, IMAGE = range(4)
"""Numbers of actions."""

ACCURACY = {"cubesat": 1e-4, "imager": 1e-4, "agile_imager": 1e-4, "aeos_bench": 5e-4}
"""Error of nadir pointing after 15 minutes, rad, that the page states."""


def satellite(args: dict[str, Any], law: str) -> sats.Satellite:
    class Imager(sats.ImagingSatellite):
        observation_spec = (obs.Time(),)
        action_spec = (
            act.NadirPoint(duration=300.0),
            act.Charge(duration=300.0),
            act.Desat(duration=300.0),
            act.Image(n_ahead_image=1),
        )
        dyn_type = dyn.ImagingDynModel
        fsw_type = fsw.SteeringImagerFSWModel if law == "steering" else fsw.ImagingFSWModel

    return Imager("A", args)


def momentum(env: SatelliteTasking) -> torch.Tensor:
    """Momentum about the center of mass, ``[NB] (I w + sum J O g)``, [n, 3] N m s in N."""
    dynamics, args = env.satellite.dynamics, env.satellite.sat_args
    axes = torch.nn.functional.normalize(args["rwAxes_B"], dim=-1)
    inside = (args["inertia"].unflatten(-1, (3, 3)) @ dynamics.omega_BN_B.unsqueeze(-1)).squeeze(-1)
    H_B = inside + (axes * (args["rwJs"] * env.simulator.read("Omega_WB_B")).unsqueeze(-1)).sum(1)
    return (dynamics.BN.mT @ H_B.unsqueeze(-1)).squeeze(-1)


@pytest.mark.compiled
@pytest.mark.parametrize("name", LAWS)
def test_an_orbit(name, caplog):
    """Nadir, targets, desaturation, charging and nadir again, without torques from outside but those of the thrusters."""
    caplog.set_level(logging.WARNING)
    # few targets with long windows: a turn, not the window, decides
    easy = dict(imageTargetMinimumElevation=math.radians(10.0), imageAttErrorRequirement=0.02, dragCoeff=0.0)
    env = SatelliteTasking(
        satellite(getattr(craft, name)() | easy, LAWS[name]),
        scenario=scene.UniformTargets(100),
        rewarder=data.UniqueImageReward(),
        num_envs=8,
        seed=0,
        time_limit=12_000.0,
        max_step_duration=600.0,
    )
    td, dynamics, settled = env.reset(), env.satellite.dynamics, False
    assert not [record for record in caplog.records if "stable" in record.getMessage() or "never fires" in record.getMessage()]
    images, flown = torch.zeros(8), torch.zeros(8)
    for action in [NADIR] * 3 + [IMAGE] * 6 + [DESAT] * 3 + [CHARGE] * 9 + [NADIR] * 3:
        before, charge, lit = momentum(env), dynamics.battery_charge, env.simulator.read("illumination").flatten()
        td = env.step(td.set("action", torch.full((8,), action)))["next"]
        after, flown = momentum(env), flown + td["duration"].flatten()
        images += td["reward"].flatten() > 0.0
        assert not td["done"].any()
        assert (dynamics.wheel_speeds_fraction.abs() < 1.0).all()
        if action == DESAT:
            share = after.norm(dim=-1) / before.norm(dim=-1)
            assert (share < 1.001).all()  # of little momentum, no thruster fires
            assert (share < 0.95).sum() >= 6
        else:  # the error of Runge-Kutta steps in turns
            assert ((after - before).norm(dim=-1) < 1e-4 * before.norm(dim=-1)).all()
        if action == CHARGE:
            args, full = env.satellite.sat_args, dynamics.battery_charge_fraction > 0.999
            strong = SOLAR_FLUX * (args["panelArea"] * args["panelEfficiency"]).expand(8) > 60.0  # some of aeos_bench are weak
            sunny = (lit > 0.99) & (env.simulator.read("illumination").flatten() > 0.99) & strong
            assert not settled or ((dynamics.battery_charge > charge) | full | ~sunny).all()
        settled = action == CHARGE
    assert (flown > 5_700.0).all()
    assert (images >= 1).all()
    trace = (dynamics.BN @ dynamics.HN.mT).diagonal(dim1=-2, dim2=-1).sum(-1)
    assert (torch.acos((0.5 * (trace - 1.0)).clamp(max=1.0)) < ACCURACY[name]).all()


@pytest.mark.parametrize(("name", "law", "h"), itertools.product(LAWS, ("feedback", "steering"), (0.5, 2.0)))
def test_gains_suit_both_laws_and_other_ticks(name, law, h, caplog):
    caplog.set_level(logging.WARNING)
    described = satellite(getattr(craft, name)(h, law) | dict(imageTargetMinimumElevation=0.1), law)  # one is soon in view
    SatelliteTasking(described, scenario=scene.UniformTargets(300), num_envs=2, sim_rate=h, backend="eager").reset()
    assert not [record for record in caplog.records if "stable" in record.getMessage() or "oscillates" in record.getMessage()]


@pytest.mark.parametrize("name", LAWS)
def test_the_page_lists_the_numbers_as_they_are(name):
    args = getattr(craft, name)()
    [table] = re.findall(rf"^\| `{name}` \|.*\n\|---.*\n((?:\|.*\n)+)", PAGE.read_text(), re.MULTILINE)
    rows = [[cell.strip() for cell in line.split("|")[1:3]] for line in table.splitlines()]
    listed = {argument: value for names, value in rows for argument in re.findall(r"`(\w+)`", names)}
    # initial values and proposed gains are not listed
    gains = {
        *fsw.propose_gains(
            [1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0], [dyn.Wheel("BCT_RWP015", a) for a in dyn.pyramid(1)], law=LAWS[name]
        )
    }
    assert set(args) - gains - {"wheelSpeeds", "storedCharge_Init", "maxCounterValue", "integralLimit"} <= set(listed)
    assert set(listed) <= set(args)
    for names, value in rows:
        arguments = re.findall(r"`(\w+)`", names)
        if value.startswith("`craft."):
            assert eval(value.strip("`"), {"craft": craft}) == args[arguments[0]]
        elif value.startswith("`"):
            found = ast.literal_eval(value.strip("`"))
            assert found == (args[arguments[0]] if len(arguments) == 1 else tuple(args[one] for one in arguments)), names


def test_satellites_of_aeos_bench():
    key = first_key(4096).named("inertia")
    moments = craft.aeos_bench()["inertia"].draw(key).unflatten(-1, (3, 3)).diagonal(dim1=-2, dim2=-1)
    assert moments.shape == (4096, 3)
    assert (moments.sum(-1) >= 2.0 * moments.amax(-1)).all()
    assert moments.min() >= 50.0
    assert moments.max() <= 200.0
    # of a triple, 14.8 % is drawn again: the largest of three uniform ones exceeds the sum of the others by less than it could
    assert moments.mean().item() == pytest.approx(129.0, abs=2.0)
    normals = craft.aeos_bench()["nHat_B"].draw(key)
    torch.testing.assert_close(normals.norm(dim=-1), torch.ones(4096, dtype=torch.float64))
    assert (normals[:, 1] >= -1e-12).all()
    inertias = {craft.aeos_bench(max_momentum=momentum)["wheels"][0].arguments["rwJs"] for momentum in (12, 25, 50, 75, 100)}
    assert len(inertias) == 5
    with pytest.raises(ValueError, match=r"max_momentum=60 N m s must be one of \[12.0, 25.0, 50.0, 75.0, 100.0\]"):
        craft.aeos_bench(max_momentum=60)


def test_an_octet_exerts_torques_only():
    thrusters = craft.octet(0.1, 0.5, 0.4, 2.0)
    assert len(set(thrusters)) == 8
    places, pushes = (
        torch.tensor([getattr(t, name) for t in thrusters], dtype=torch.float64) for name in ("position", "direction")
    )
    torques = torch.linalg.cross(places, pushes)
    assert pushes.sum(0).abs().max() < 1e-15
    assert torques.sum(0).abs().max() < 1e-15
    assert torch.linalg.matrix_rank(torques) == 3
    assert torch.equal(torques[:4], torques[4:])


def test_wheels_of_slew_limits():
    """Numbers by hand for 121 kg m^2, 1.8 deg/s and 0.4 deg/s^2; wheels on the faces of a regular tetrahedron share 3/4 each."""
    args = craft.from_slew_limits(1.8, 0.4, margin=1.1)
    torque, momentum = 1.1 * 121.0 * math.radians(0.4), 1.1 * 121.0 * math.radians(1.8 + 1.0)
    for wheel in args["wheels"]:
        assert wheel.u_max == pytest.approx(torque)
        assert wheel.maxMomentum == pytest.approx(momentum)
    assert torque == pytest.approx(1.1 * 0.845, rel=1e-3)
    pyramid = dyn.pyramid(1.0 / math.sqrt(2.0))  # 54.7 degrees from its axis
    four = craft.from_slew_limits(1.8, 0.4, margin=1.1, axes=pyramid)
    assert [wheel.u_max for wheel in four["wheels"]] == pytest.approx([0.75 * torque] * 4)
    turned = craft.from_slew_limits(1.8, 0.4, margin=1.1, inertia=[90.0, 20.0, 0.0, 20.0, 90.0, 0.0, 0.0, 0.0, 80.0])
    assert turned["wheels"][0].u_max == pytest.approx(110.0 / 121.0 * torque)


def test_refusals_of_slew_limits():
    check_refusals(
        refusal(lambda: craft.from_slew_limits(0.0, 0.4), ValueError, "max_rate_deg_s=0.0", "deg/s"),
        refusal(lambda: craft.from_slew_limits(1.8, -1.0), ValueError, "max_acceleration_deg_s2=-1.0", "deg/s^2"),
        refusal(lambda: craft.from_slew_limits(1.8, 0.4, 0.5, h=0.5), ValueError, "settling_time=0.5", "1"),
        refusal(lambda: craft.from_slew_limits(1.8, 0.4, margin=1.0), ValueError, "margin=1.0", "1.1"),
        refusal(lambda: craft.from_slew_limits(1.8, 0.4, inertia=(1.0, 2.0)), ValueError, "inertia=(1.0, 2.0)"),
        refusal(lambda: craft.from_slew_limits(1.8, 0.4, inertia=(1.0, 1.0, 5.0)), ValueError, "inertia"),
        refusal(lambda: craft.from_slew_limits(1.8, 0.4, axes=[(1, 0, 0), (0, 1, 0)]), ValueError, "axes"),
    )
