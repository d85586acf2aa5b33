"""Several deputies against recordings of AFRL's programs, see scripts/recorders/record_afrl_crews.py."""

from operator import attrgetter

import numpy as np
import pytest
import torch

import bsk_torch
from bsk_torch import formations
from bsk_torch.rl.marl.runs import is_constellation
from bsk_torch.tasks.safe_autonomy.assurance import Barriers, Deputies, crew_barriers, crew_inspection
from tests.tasks.safe_autonomy.replay import read

RECORDED = read("crews.npz")
CREW = 3
ROUNDING = 1e-12
"""Largest difference of forces of up to 1 N, N; see test_filters.py."""


def crews():
    """Return the first deputy of each recorded crew, with the others."""
    case = RECORDED["filter"]
    states, angle = (torch.as_tensor(case[name]) for name in ("states", "angles"))
    r, v = states.unflatten(1, (CREW, 6)).split(3, 2)
    one = torch.ones_like(angle)
    limit = torch.tensor([0.2, 2.0, 15.0], dtype=torch.float64).expand(len(one), 3)
    sun = torch.stack([angle.cos(), -angle.sin(), 0.0 * angle], 1)
    return Deputies(r[:, 0], v[:, 0], sun, 0.001027 * one, 12.0 * one, limit, 15.0 * one, 1.0, r[:, 1:], v[:, 1:])


def test_the_filter_of_a_crew():
    case, x, barriers = RECORDED["filter"], crews(), crew_inspection(CREW)
    names = ["chief_collision", "rel_vel", "chief_sun", "r_max", "PSM", "x_vel", "y_vel", "z_vel"]
    order = [names.index(name) for name in ("rel_vel", "chief_sun", "r_max", "PSM", "x_vel", "y_vel", "z_vel", "chief_collision")]
    values = torch.stack([barrier(x) for barrier in barriers], 1).numpy()
    np.testing.assert_allclose(values, case["values"][:, order + list(range(8, 14))], rtol=0, atol=1e-11)
    wishes, recorded = torch.as_tensor(case["wishes"]), case["forces"]
    assert 0.2 < (np.abs(recorded - case["wishes"]).max(1) > 0.01).mean() < 0.9
    found = Barriers(barriers)(x, wishes, 10.0)
    np.testing.assert_allclose(found.numpy(), recorded, rtol=0, atol=ROUNDING)


DOCKING = ["dock", "crash", "collide", "fast", "late"]
INSPECTION = ["tour", "dive", "leave", "collide"]
POSITION, VELOCITY = 1e-7, 1e-10
"""Largest differences, m and m/s; see test_docking.py and test_inspection.py."""


def fly(preset, names):
    """Return recorded episodes by name, and what two deputies do with the same actions, in one row for each episode."""
    recorded = {name: RECORDED[f"{'docking' if preset == 'CWDocking-v1' else 'inspection'} {name}"] for name in names}
    starts = torch.as_tensor(np.array([case["states"][0] for case in recorded.values()]))
    args = dict(relative_position=starts[..., :3], relative_velocity=starts[..., 3:])
    if preset == "CWInspection-v1":
        angle = [case["observations"][0, :, 6] for case in recorded.values()]
        args["sunAngle"] = torch.as_tensor(np.array(angle), dtype=torch.float64)

    class Recorded(formations.Formation):
        def draw(self, key, names):
            return {name: (range(2), value[key.env_id]) for name, value in args.items()}

    env = bsk_torch.make(
        preset,
        deputies=2,
        num_envs=len(names),
        env_ids=range(len(names)),
        seed=0,
        dtype=torch.float64,
        sat_arg_randomizer=Recorded(),
    )
    group = env.groups[0].name
    length = [len(case["actions"]) for case in recorded.values()]
    actions = torch.zeros(max(length), len(names), 2, 3)
    for k, case in enumerate(recorded.values()):
        actions[: length[k], k] = torch.as_tensor(case["actions"])

    def state():
        return torch.cat([env.fleet.each(attrgetter(f"dynamics.{name}")) for name in ("rho_H", "rho_dot_H")], 2)

    td, states, flown = env.reset(), [], []
    states.append(state())
    seen = [td[group, "observation"]]
    for action in actions:
        td = env.step(td.select().set((group, "action"), action))["next"]
        states.append(state())
        seen.append(td[group, "observation"])
        flown.append(td)
    return recorded, group, (torch.stack(states, 1).numpy(), torch.stack(seen, 1).numpy(), flown)


@pytest.fixture(scope="module")
def docked():
    return fly("CWDocking-v1", DOCKING)


@pytest.fixture(scope="module")
def inspected():
    return fly("CWInspection-v1", INSPECTION)


@pytest.mark.parametrize("task", ["docked", "inspected"])
def test_recorded_episodes_of_two_deputies(task, request):
    recorded, group, (states, seen, flown) = request.getfixturevalue(task)
    assert len(recorded) == len(DOCKING if task == "docked" else INSPECTION)
    for k, (name, case) in enumerate(recorded.items()):
        count, rows = len(case["actions"]), case["rows"]
        difference = np.abs(states[k, rows] - case["states"])
        assert difference[..., :3].max() < POSITION, name
        assert difference[..., 3:].max() < VELOCITY, name
        shown = rows[
            rows < count
        ]  # zero for agents that have crashed; without the direction of a cluster, as in test_inspection.py
        np.testing.assert_allclose(
            seen[k, shown, :, :8], case["observations"][: len(shown), :, :8], rtol=1e-6, atol=1e-6, err_msg=name
        )
        rewards = np.array([td[group, "reward"][k, :, 0].numpy() for td in flown[:count]])
        np.testing.assert_allclose(rewards, case["rewards"], rtol=3e-7, atol=1e-8, err_msg=name)
        done = [bool(td["done"][k]) for td in flown[:count]]
        assert done == [False] * (count - 1) + [True], name
        early = {"Out of Bounds", "Timeout", "Max Velocity Violation"} & set(case["status"])
        assert bool(flown[count - 1]["truncated"][k]) == bool(early), name
        assert bool(flown[count - 1]["terminated"][k]) == (not early), name
        counts = {key: value[k].tolist() for key, value in flown[count - 1]["counts"].items()}
        assert counts["collided"] == [int(status == "Collision") for status in case["status"]], name


def test_deputies_know_each_other():
    """Each is filtered with the others in the order of the environment, and its own place does not matter."""
    env = bsk_torch.make("CWInspection-v1", deputies=3, num_envs=4, seed=0, assurance="asif", dtype=torch.float64)
    env.reset()
    (satellite,) = env.fleet.satellites
    x = Deputies.of(satellite, 1.0)
    r = x.r.unflatten(0, (4, 3))
    for k, rest in enumerate(([1, 2], [0, 2], [0, 1])):
        assert torch.equal(x.others_r.unflatten(0, (4, 3))[:, k], r[:, rest])
    wish = torch.rand(12, 3, dtype=torch.float64) * 2.0 - 1.0
    assert torch.equal(crew_barriers(x, wish, 10.0), Barriers(crew_inspection(3))(x, wish, 10.0))
    angle = env.fleet.each(attrgetter("dynamics.sun_angle"))
    assert torch.equal(angle, angle[:, :1].expand(-1, 3))
    assert len(angle.unique()) == 4
    with pytest.raises(ValueError, match="needs the other deputy 2, counted from 0; there are 2 others"):
        Barriers(crew_inspection(4))(x, wish, 10.0)


class Facing(formations.Formation):
    """Puts two deputies 60 m above the chief, 50 m from each other."""

    def draw(self, key, names):
        r = torch.tensor([[60.0, -25.0, 0.0], [60.0, 25.0, 0.0]], dtype=torch.float64)
        return {"relative_position": (range(2), r.expand(len(key), 2, 3))}


def test_the_filter_keeps_deputies_apart():
    """Deputies that fly toward each other collide without it only, if forces are held for 1 s."""

    def flown(assurance):
        env = bsk_torch.make(
            "CWInspection-v1",
            deputies=2,
            num_envs=1,
            seed=0,
            sim_rate=1.0,
            assurance=assurance,
            dtype=torch.float64,
            sat_arg_randomizer=Facing(),
        )
        group, td = env.groups[0].name, env.reset()
        for _ in range(100):
            r, v = td[group, "observation"][..., :6].split(3, -1)
            gap = r.flip(1) - r
            force = 3.0 * (0.25 * gap / gap.norm(dim=-1, keepdim=True) - v)
            td = env.step(td.select().set((group, "action"), force.clamp(-1.0, 1.0)))["next"]
            if bool(td["done"]):
                break
        return td

    assert flown(None)["counts", "collided"].all()
    kept = flown("asif")
    assert not kept["counts", "collided"].any()
    assert (kept["counts", "interventions"] > 0).all()


@pytest.mark.parametrize("preset", ["CWDocking-v1", "CWInspection-v1"])
def test_several_deputies_are_a_constellation(preset):
    assert not is_constellation(preset)
    assert is_constellation(preset, {"deputies": 2})
