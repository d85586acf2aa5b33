"""Run-time assurance: against forces of AFRL's package (scripts/recorders/record_afrl_filters.py), and in episodes."""

import pickle

import numpy as np
import pytest
import torch

import bsk_torch
from bsk_torch import ConstellationTasking
from bsk_torch.tasks.safe_autonomy import HeldThrust
from bsk_torch.tasks.safe_autonomy.assurance import DOCKING, INSPECTION, Backup, Barriers, Deputies, nearest, stopping_gain
from bsk_torch.tasks.safe_autonomy.preset_docking import DockingDeputy, DockingReward, Polar, deputy_args
from tests.tasks.safe_autonomy.replay import RECORDINGS

RECORDED = np.load(RECORDINGS / "filters.npz")
WISHES = torch.as_tensor(RECORDED["wishes"])
ROUNDING = 1e-12
"""Largest difference of forces of up to 1 N, N: both compute in float64, by other solvers of the same problems."""

FILTERS = {"asif": Barriers(DOCKING), "simplex": Backup(DOCKING), "implicit_simplex": Backup(DOCKING, window=5.0)}


def deputies(task, keep_out=0.0, distance=0.5):
    state = torch.as_tensor(RECORDED[f"{task}/states"])
    one = torch.ones_like(state[:, 0])
    sun = torch.zeros_like(state[:, :3])
    if f"{task}/angles" in RECORDED:
        angle = torch.as_tensor(RECORDED[f"{task}/angles"])
        sun = torch.stack([angle.cos(), -angle.sin(), 0.0 * angle], 1)
    limit = torch.tensor([0.2, 2.0, distance], dtype=torch.float64).expand(len(state), 3)
    return Deputies(state[:, :3], state[:, 3:], sun, 0.001027 * one, 12.0 * one, limit, keep_out * one, 1.0)


@pytest.mark.parametrize("name", FILTERS)
def test_filters_of_docking(name):
    recorded = RECORDED[f"docking/{name}"]
    assert 0.2 < (np.abs(recorded - WISHES.numpy()).max(1) > 0.01).mean() < 0.6
    np.testing.assert_allclose(FILTERS[name](deputies("docking"), WISHES, 1.0).numpy(), recorded, rtol=0, atol=ROUNDING)


def test_the_filter_of_inspection():
    recorded, x = RECORDED["inspection/asif"], deputies("inspection", 15.0, 15.0)
    values = torch.stack([barrier(x) for barrier in INSPECTION], 1).numpy()
    np.testing.assert_allclose(values, RECORDED["inspection/constraints"], rtol=0, atol=1e-12)
    assert 0.02 < 1.0 - RECORDED["inspection/solved"].mean() < 0.1  # wishes that no force can replace stay
    np.testing.assert_allclose(Barriers(INSPECTION)(x, WISHES, 10.0).numpy(), recorded, rtol=0, atol=ROUNDING)


def some(x, rows):
    return Deputies(*(part[rows] if isinstance(part, torch.Tensor) and len(part) == len(x.r) else part for part in x))


@pytest.mark.parametrize("name", [*FILTERS, "inspection"])
def test_no_deputy_depends_on_the_others(name):
    x = deputies("inspection", 15.0, 15.0) if name == "inspection" else deputies("docking")
    filtering = FILTERS.get(name, Barriers(INSPECTION))
    together = filtering(x, WISHES, 1.0)
    assert not torch.equal(together, WISHES)
    for rows in (slice(0, 1), slice(7, 60)):
        assert torch.equal(filtering(some(x, rows), WISHES[rows], 1.0), together[rows])


def test_deputies_on_the_axis_of_the_cone_of_blinding_are_filtered():
    """In front of the chief and behind it, the barrier has the value of a deputy a micrometer off the axis."""
    x = some(deputies("inspection", 15.0, 15.0), slice(0, 4))
    sun = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64).expand(4, 3)
    r = torch.tensor([[100.0, 0.0, 0.0], [-100.0, 0.0, 0.0]], dtype=torch.float64).repeat(2, 1)
    r[2:, 2] = 1e-6
    x = x._replace(r=r, v=torch.zeros_like(r), sun=sun)
    value = INSPECTION[1](x)
    torch.testing.assert_close(value[:2], value[2:], rtol=0, atol=1e-6)
    force = Barriers(INSPECTION)(x._replace(v=-0.004 * r), torch.zeros_like(r), 10.0)  # 0.4 m/s, where 0.37 m/s are safe
    assert force[0, 0] > 0.1  # brakes
    assert force[1, 2] > 0.1  # leaves the cone along the orbit normal


def test_rejects_states_that_are_not_numbers():
    x = some(deputies("inspection", 15.0, 15.0), slice(0, 3))
    lost = x._replace(r=torch.where(torch.arange(3).unsqueeze(1) == 1, torch.nan, x.r))
    with pytest.raises(FloatingPointError, match=r"is not finite for deputy 1 at \[nan"):
        Barriers(INSPECTION)(lost, WISHES[:3], 10.0)
    with pytest.raises(FloatingPointError, match=r"forces of up to 0\.001 N"):  # too weak to stop at any distance
        Barriers(INSPECTION)(x._replace(most=0.001), WISHES[:3], 10.0)
    weight, bound = torch.ones(2, 4, 3, dtype=torch.float64), torch.zeros(2, 4, dtype=torch.float64)
    bound[1, 2] = torch.nan
    assert nearest(WISHES[:2], weight, bound).isnan().any(1).tolist() == [False, True]


def test_nearest_solves_the_program():
    """Against projections by Dykstra's method, for inequalities with a common solution."""
    generator = torch.Generator().manual_seed(0)
    wish, weight = (torch.randn(50, *shape, 3, dtype=torch.float64, generator=generator) for shape in ((), (6,)))
    inner = 0.3 * torch.randn(50, 1, 3, dtype=torch.float64, generator=generator)
    bound = (weight * inner).sum(-1) - 0.05
    found = nearest(wish, weight, bound)
    assert ((weight @ found.unsqueeze(-1)).squeeze(-1) >= bound - 1e-8).all()
    u, corrections = wish.clone(), torch.zeros_like(weight)
    for _ in range(3000):
        for k in range(6):
            y = u + corrections[:, k]
            short = (bound[:, k] - (weight[:, k] * y).sum(-1)).clamp(min=0.0) / weight[:, k].square().sum(-1)
            u = y + short.unsqueeze(-1) * weight[:, k]
            corrections[:, k] = y - u
    torch.testing.assert_close(found, u, rtol=0, atol=1e-4)  # the method converges slowly


def test_the_backup_controller_solves_the_riccati_equation():
    """Along the normal axis, the equation has a solution in closed form: that of an oscillator of frequency n."""
    x = deputies("docking")
    gain = stopping_gain(x)[0, 2, 2]
    n, m, q, r = 0.001027, 12.0, 0.05, 1000.0
    position = m * (-(n**2) + (n**4 + q / (r * m**2)) ** 0.5)
    assert float(gain) == pytest.approx((q / r + 2.0 * m * position) ** 0.5, rel=1e-9)


@pytest.mark.compiled
def test_filtered_episodes_keep_the_safe_speed():
    """Deputies with random forces stay below the safe speed, which those without a filter do not.

    The filter of barriers assumes that it acts continuously: forces held for a second exceed the limit by millimeters per second.
    """
    excess = {}
    for name in (None, "asif", "simplex"):
        slow = Polar(0.0, 0.2)
        env = bsk_torch.make("CWDocking-v1", num_envs=8, seed=0, assurance=name, sat_args=dict(relative_velocity=slow))
        td, generator, excess[name] = env.reset(), torch.Generator().manual_seed(0), -1.0
        for _ in range(60):
            wish = torch.rand(8, 3, generator=generator) - 0.2
            td = env.step(td.set("action", wish))["next"]
            excess[name] = max(excess[name], float((td["observation"][:, 6] - td["observation"][:, 7]).max()))
        assert ("interventions" in td["counts"]) == (name is not None)
        if name is not None:
            assert (td["counts", "interventions"] > 0).all()
            assert env.satellite.dynamics.force_H.abs().max() <= 1.0
            again = pickle.loads(pickle.dumps(env))
            assert torch.equal(again.step(td.set("action", wish))["next", "observation"], env.step(td)["next", "observation"])
    assert excess[None] > 0.5
    assert 0.0 < excess["asif"] < 0.005
    assert excess["simplex"] < 0.0


@pytest.mark.compiled
def test_every_agent_has_a_filter():
    names = ("Deputy1", "Deputy2")
    args = deputy_args() | dict(relative_position=Polar(100.0, 150.0), relative_velocity=Polar(0.0, 0.2), speedLimitDistance=0.5)
    thrust = [HeldThrust(assurance=FILTERS["asif"])]
    satellites = [DockingDeputy(name, args, action_spec=thrust) for name in names]
    env = ConstellationTasking(satellites, rewarder=DockingReward(), num_envs=4, seed=0, time_limit=2001.0)
    (group,) = env.group_map
    td = env.reset()
    for _ in range(60):
        action = torch.ones(4, 2, 3)
        action[:, 1] = -0.01  # the second hardly thrusts
        td = env.step(td.set((group, "action"), action))["next"]
    assert (td["counts", "interventions"][:, 0] > 0).all()
    assert (td["counts", "speeding"][:, 1] == 0).all()
