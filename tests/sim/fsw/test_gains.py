"""Proposed gains: numbers by hand, and flights of random bodies with random wheels."""

import logging
import math
from dataclasses import dataclass
from typing import Any

import pytest
import torch

from bsk_torch import SatelliteTasking, act, dyn, fsw, obs, rand, sats
from bsk_torch.constants import RPM
from bsk_torch.sim.dyn.effectors.thrusters import OCTET
from tests.sim.dyn.test_body import random_tensors

HR16 = [dyn.Wheel("Honeywell_HR16", axis, 50.0) for axis in torch.eye(3).tolist()]
BODY = [82.0, 0, 0, 0, 98.0, 0, 0, 0, 121.0]


def test_gains_by_hand():
    """Three wheels on the axes: L = 0.2 N m, H = 50 N m s, J' = 82 - 50 / 628.3."""
    P = 0.36 * (82.0 - 50.0 / (6000.0 * RPM))
    a = math.sqrt(0.2 / (121.0 * math.pi))
    assert a < P / (5.76 * 121.0)
    found = fsw.propose_gains(BODY, HR16)
    assert found == {"P": pytest.approx(P), "K": pytest.approx(4.0 * a * P), "Ki": -1.0, "compensateWheels": True}
    steering = fsw.propose_gains(BODY, HR16, law="steering")
    assert (steering["K1"], steering["K3"]) == (pytest.approx(4.0 * a), pytest.approx(4.0 / 3.0 * a))
    assert (steering["omega_max"], steering["servo_P"]) == (pytest.approx(0.2 / P), pytest.approx(P))
    small_turns = fsw.propose_gains(BODY, HR16, slew=0.01)
    assert small_turns["K"] == pytest.approx(4.0 * P / (5.76 * 121.0) * P)
    assert small_turns["P"] / math.sqrt(small_turns["K"] * 121.0) == pytest.approx(1.2)
    assert fsw.propose_gains(BODY, HR16, 0.5)["P"] == pytest.approx(2.0 * P)
    # Four wheels on a pyramid: least-norm torques about any direction, by search, and the proposal's limit.
    wheels = [dyn.Wheel("custom", axis, 100.0, Omega_max=6000.0, u_max=0.1) for axis in dyn.pyramid(0.5)]
    axes = torch.tensor([wheel.arguments["rwAxes_B"] for wheel in wheels], dtype=torch.float64)
    directions = torch.nn.functional.normalize(torch.randn(200_000, 3, dtype=torch.float64), dim=-1)
    needed = (directions @ torch.linalg.pinv(axes)).abs().amax(-1).max().item()
    found = fsw.propose_gains(torch.diag(torch.tensor([100.0, 90.0, 80.0])), wheels)
    L, P = 0.1 / needed, found["P"]
    assert found["K"] == pytest.approx(4.0 * P * math.sqrt(L / (100.0 * math.pi)), rel=1e-3)
    half = [
        dyn.Wheel("custom", axis, 100.0, Omega_max=6000.0, u_max=0.1, P_max=0.05 * 0.5 * 6000.0 * RPM)
        for axis in dyn.pyramid(0.5)
    ]
    assert fsw.propose_gains(BODY, half)["K"] == pytest.approx(fsw.propose_gains(BODY, wheels)["K"] / math.sqrt(2.0), rel=1e-6)


def test_gains_of_further_parts():
    pyramid = [dyn.Wheel("NanoAvionics_RW0", axis, useRWfriction=True) for axis in dyn.pyramid(0.8)]
    found = fsw.propose_gains([0.09, 0, 0, 0, 0.13, 0, 0, 0, 0.16], pyramid)
    assert found["nullSpaceGain"] == pytest.approx(0.25 * 0.0032 / (6500.0 * RPM))
    assert 0.0 < found["Ki"] < 1.0
    # four wheels with 5e-5 N m, whose axes have the components 1 / sqrt(2) and 0.8 before they are normalized
    friction = 4.0 * 5e-5 * 0.8 / math.hypot(1.0, 0.8)
    assert found["P"] * found["Ki"] * found["integralLimit"] == pytest.approx(2.0 * friction)
    steering = fsw.propose_gains([0.09, 0, 0, 0, 0.13, 0, 0, 0, 0.16], pyramid, law="steering")
    assert steering["servo_Ki"] * steering["integralLimit"] == pytest.approx(2.0 * friction)
    assert "maxCounterValue" not in found
    assert fsw.propose_gains(BODY, HR16, thrusters=OCTET)["maxCounterValue"] == 4.0
    # four of 22 N on arms of 1 m push about an axis at once
    strong = [dyn.Thruster(p, d, 22.0) for p, d in (((1, 0, 0), (0, 1, 0)), ((-1, 0, 0), (0, -1, 0)))]
    strong += [dyn.Thruster(p, d, 22.0) for p, d in (((0, 1, 0), (-1, 0, 0)), ((0, -1, 0), (1, 0, 0)))]
    assert fsw.propose_gains(BODY, HR16, thrusters=strong)["maxCounterValue"] == math.ceil(4 * 22.0 / 6.0 / 0.1) - 1


@dataclass(frozen=True, eq=False)
class Rows(rand.Distribution):
    """The same values for an environment in all episodes."""

    values: torch.Tensor

    def draw(self, key: rand.Key) -> torch.Tensor:
        return self.values[key.env_id % len(self.values)]


class Hold(act.DiscreteFSWAction):
    def __init__(self, duration: float) -> None:
        super().__init__("hold_inertial", duration=duration)


TURNS = (10.0, 90.0, 179.9)
"""Angles, degrees, through which the satellites turn, one after another."""


def random_spacecraft(n: int, count: int, h: float, law: str) -> tuple[dict[str, Any], torch.Tensor]:
    """Arguments of n bodies with wheels of different strength, and how long each may take to settle, s.

    The torque of the wheels turns the bodies by 1e-4 to 1e-2 rad/s^2, their momentum by 0.5 to 8 degrees per second. Initial
    speeds have up to a quarter of the momentum.
    """
    torch.manual_seed(20263)
    inertia = random_tensors(n) * 10.0 ** (4.0 * torch.rand(n, 1, 1, dtype=torch.float64) - 3.0)
    largest = torch.linalg.eigvalsh(inertia)[:, -1:]
    axes = torch.randn(n, count, 3, dtype=torch.float64)
    axes[:, :3] = torch.linalg.qr(axes[:, :3])[0] + 0.1 * torch.randn(n, 3, 3, dtype=torch.float64)
    torque = largest * 10.0 ** (2.0 * torch.rand(n, 1, dtype=torch.float64) - 4.0) * (0.5 + torch.rand(n, count).double())
    momentum = largest * math.radians(0.5) * 16.0 ** torch.rand(n, 1, dtype=torch.float64) * (0.5 + torch.rand(n, count).double())
    gains: list[dict[str, Any]] = []
    for k in range(n):
        wheels = [
            dyn.Wheel("custom", axes[k, i].tolist(), momentum[k, i].item(), Omega_max=6000.0, u_max=torque[k, i].item())
            for i in range(count)
        ]
        gains.append(fsw.propose_gains(inertia[k], wheels, h, law))
    drawn = {name: torch.tensor([float(one[name]) for one in gains], dtype=torch.float64) for name in gains[0]}
    drawn.pop("compensateWheels", None)
    rate = drawn["K1"] / 4.0 if law == "steering" else drawn["K"] / (4.0 * drawn["P"])
    turns = torch.deg2rad(torch.tensor(TURNS, dtype=torch.float64))[torch.arange(n) % len(TURNS)]
    direction = torch.nn.functional.normalize(torch.randn(n, 3, dtype=torch.float64), dim=-1)
    W = torch.linalg.pinv(torch.nn.functional.normalize(axes, dim=-1).mT)
    H = (momentum / W.norm(dim=-1)).amin(-1)
    stored = torch.nn.functional.normalize(torch.randn(n, 3, dtype=torch.float64), dim=-1) * (0.25 * H)[:, None]
    if law == "feedback":  # see the docstring of propose_gains
        rate = rate / (1.0 + (0.25 * H / drawn["P"]) ** 2)
    fastest = drawn["omega_max"] if law == "steering" else torch.full_like(rate, math.inf)
    drawn |= {
        "inertia": inertia.flatten(-2),
        "rwAxes_B": axes,
        "rwJs": momentum / (6000.0 * RPM),
        "u_max": torque,
        "wheelSpeeds": 6000.0 * (W @ stored[..., None])[..., 0] / momentum,
        "sigma_init": direction * torch.tan(turns / 4.0)[:, None],
    }
    fixed = dict(wheels=[dyn.Wheel("BCT_RWP015", axis) for axis in torch.randn(count, 3).tolist()], omega_init=[0.0] * 3)
    fixed |= dict(dragCoeff=0.0, disturbance_vector=[0.0] * 3, rwBasePower=0.0, basePowerDraw=0.0, batteryStorageCapacity=1e12)
    fixed |= {"compensateWheels": True} if law == "feedback" else {}
    args = {name: Rows(values) for name, values in drawn.items()} | fixed | {"storedCharge_Init": 1e12}
    return args, turns / torch.minimum(fastest, rate) + 10.0 / rate


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("law", "count", "h"), [("feedback", 3, 1.0), ("feedback", 6, 2.0), ("steering", 4, 0.5), ("steering", 8, 1.0)]
)
@pytest.mark.nightly("feedback-6-2.0", "steering-8-1.0")
def test_random_spacecraft_turn_and_settle(law, count, h, caplog):
    """They settle in the time that the bandwidth tells, without a warning, with torques that die out, below the top speed.

    With gains that are unstable, torques would stay at their limit.
    """
    caplog.set_level(logging.WARNING)
    n = 48
    args, time = random_spacecraft(n, count, h, law)

    class Body(sats.Satellite):
        observation_spec = (obs.Time(),)
        action_spec = (Hold(20.0 * h),)
        dyn_type = dyn.BasicDynamicsModel
        fsw_type = (fsw.InertialHoldFSWModel, fsw.SteeringFSWModel if law == "steering" else fsw.BasicFSWModel)

    env = SatelliteTasking(Body("A", args), num_envs=n, seed=0, sim_rate=h, time_limit=1e9, max_step_duration=1e9)
    td, flown, settled = env.reset(), 0.0, torch.zeros(n, dtype=torch.bool)
    assert "stable" not in caplog.text
    assert "nullSpaceGain" not in caplog.text
    while flown < time.max():
        td = env.step(td.set("action", torch.zeros(n, dtype=torch.int64)))["next"]
        flown += 20.0 * h
        error = 4.0 * torch.atan(env.satellite.dynamics.sigma_BN.norm(dim=-1))
        share = (env.simulator.read("motor_torque_B").abs() / args["u_max"].values).amax(-1)
        quiet = (error < 1e-2) & (share < 1e-2)
        late = flown > time
        assert (quiet | ~late).all(), (law, flown, error[late & ~quiet], share[late & ~quiet])
        settled |= quiet
        assert (env.satellite.dynamics.wheel_speeds_fraction.abs() < 1.0).all()
    assert settled.all()
