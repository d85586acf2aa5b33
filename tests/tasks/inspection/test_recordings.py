"""Inspection of an RSO: replays of bsk_rl's episodes on Basilisk."""

from typing import NamedTuple

import pytest
import torch
from torch import Tensor

from tests.tasks.inspection.replay import Episodes, environment, load, padded, replay

ORBIT = {"fine": (9e-9, 1.4e-10), "three": (3.6e-5, 3.3e-8), "collide3": (3.6e-5, 3.3e-8)}
"""Bounds of positions, m, and velocities, m/s, after 1000 s and after 9 h: ten times what the equations give in NumPy."""

HOURS = 1.1e-5, 1.4e-8
"""The same for one inspector over 6 h."""

SIGMA, FUEL = 6e-13, 1e-14
"""Bounds of the RSO's attitude, which follows from its orbit, and of fuel, m/s."""

POINTING = {"fine": 8e-11, "steer": 2e-10}
"""Bounds of the inspectors' attitudes with ticks of a second; with 5 s, the gains make attitudes chaotic."""


CASES = ["fine", "tumble", "steer", "one", "fuel", "complete", "dark", "range", "collision", "three", "collide3"]


class Worst(NamedTuple):
    """Largest differences over a replay, and numbers of flags that differ."""

    duration: float
    r: float
    v: float
    sigma_rso: float
    sigma: float
    fuel: float
    storage: float
    inspected: int
    illuminated: int
    reward: float
    terms: float
    regions: float
    agents: int
    retasking: int
    terminated: int

    @staticmethod
    def of(parts: "list[Worst]") -> "Worst":
        return Worst(*map(max, zip(*parts, strict=True)))


def differences(env, recorded: Episodes, step) -> Worst:
    """Compare the present with the boundary after a step, in the episodes that took it."""
    k, moves, outputs = step
    n, (rso, inspectors) = len(recorded), env.fleet.simulators
    expected = padded(recorded, "state", k + 1)

    def state(name: str) -> Tensor:
        return torch.cat([simulator.read(name).view(n, -1, 3) for simulator in (rso, inspectors)], 1)

    def largest(found: Tensor, wanted: Tensor) -> float:
        return float((found - wanted).nan_to_num()[moves].abs().max())

    def unequal(found: Tensor, key: str) -> int:
        return int((found[:, 1:] != padded(recorded, key, k + 1).bool())[moves].sum())

    def unlike(found: Tensor, key: str, number: int, who: Tensor | bool = True) -> int:
        wanted = padded(recorded, key, number)
        return int(((found != (wanted > 0.0)) & (wanted >= 0.0) & who)[moves].sum())

    inspection, staying = env.rewarder.rewarders[0], ~(env.state.removed | outputs["truncated"])
    reward = torch.cat([outputs[group]["reward"][..., 0] for group in env.group_map], 1)
    terms = env.rewarder.terms
    pairs = {"inspection": terms["RSOInspectionReward"], "fuel": terms["ResourceReward"]}
    names = ("six_hill", "six_body", "fifteen_hill", "resource_reward_weight")
    columns = [k for k, name in enumerate(recorded.names) if any(part in name for part in names)]
    assert len(columns) == 28
    return Worst(
        largest(outputs["duration"][:, 0], padded(recorded, "duration", k)),
        largest(state("r_BN_N"), expected[..., 1:4]),
        largest(state("v_BN_N"), expected[..., 4:7]),
        largest(state("sigma_BN")[:, 0], expected[:, 0, 7:10]),
        largest(state("sigma_BN")[:, 1:], expected[:, 1:, 7:10]),
        largest(inspectors.read("dv_available").view(n, -1), expected[:, 1:, 14]),
        largest(inspectors.read("storage").view(n, -1), expected[:, 1:, 15]),
        unequal(inspection.known.inspected, "inspected"),
        unequal(inspection.known.illuminated, "illuminated"),
        largest(reward, padded(recorded, "reward", k)),
        max(largest(found, padded(recorded, key, k)) for key, found in pairs.items()),
        largest(outputs[list(env.group_map)[1]]["observation"], padded(recorded, "obs", k + 1)[..., columns]),
        unlike(staying, "agents", k + 1),
        unlike(env.requires_retasking & staying, "retask", k + 1, staying),
        unlike(env.dead | env.rewarder.is_terminated(), "terminated", k),
    )


@pytest.mark.compiled
@pytest.mark.parametrize("case", CASES)
@pytest.mark.nightly("fine", "tumble", "one", "steer")
def test_an_episode_is_the_recorded_one(case):
    """Orbits, fuel, points, rewards, who leaves and when steps end, times of completion; attitudes that are not chaotic."""
    recorded = load(case)
    env = environment(recorded)
    worst = Worst.of([differences(env, recorded, step) for step in replay(env, recorded)])
    assert (worst.inspected, worst.illuminated) == (0, 0), worst
    assert worst.duration < 1e-11, worst  # a time minus a time, in Basilisk's seconds
    assert worst.storage == 0.0, worst
    assert worst.regions < 1e-15, worst
    assert max(worst.reward, worst.terms) < 1e-14, worst
    assert (worst.agents, worst.retasking, worst.terminated) == (0, 0, 0), worst
    r, v = ORBIT.get(case, HOURS)
    assert worst.r < r, worst
    assert worst.v < v, worst
    assert worst.sigma_rso < SIGMA, worst
    assert worst.fuel < FUEL, worst
    assert worst.sigma < POINTING.get(case, 2.0), worst
    bonus = env.rewarder.rewarders[0].bonus_reward_time
    torch.testing.assert_close(bonus, torch.tensor(recorded.bonus_time), rtol=0, atol=1e-11, equal_nan=True)


def test_recordings_show_what_they_are_for():
    """Points that were inspected, completion, the bonus for nothing, deaths by fuel, range and collision."""
    seen = {case: padded(load(case), "inspected", 10**6).sum().item() for case in ("fine", "one", "complete")}
    assert min(seen.values()) >= 3
    assert seen["one"] > 90
    assert (load("complete").bonus_time > 0.0).all()
    dark = load("dark")
    assert (dark.bonus_time.item(), padded(dark, "illuminated", 10**6).sum()) == (630.0, 0)
    assert (load("fuel").death[:, 1] > 0.0).all()
    assert all((load(case).death[:, 0] > 0.0).all() for case in ("range", "collision"))
    crashed = load("collide3")
    assert (crashed.death[:, 2:] == crashed.death[:, 3:]).all()  # the last inspector, and the one before it
    assert (crashed.death[:, 0] > crashed.death[:, 3]).all()  # whom the last one has hit goes on
    assert crashed.bonus_time[1] > crashed.death[1, 0]
