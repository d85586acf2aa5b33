"""Faults drawn again for copies of an episode: what has happened remains, and the rest follows the conditional distributions."""

import math

import numpy as np
import pytest
import torch

from bsk_torch import SatelliteTasking, faults, rand
from bsk_torch.sim.faults.coming import drawn_again
from tests.sim.faults.test_faults import Clicking, clicking, counted

COPIES = 2000


def futures(env: SatelliteTasking, row: int = 0, copies: int = COPIES, seed: int = 5) -> SatelliteTasking:
    """Copies of one episode, with faults drawn again in each."""
    store = env.like(copies)
    store.restore(env, torch.arange(copies), torch.full((copies,), row))
    zeros = torch.zeros(copies, dtype=torch.int64)
    key = rand.Key(torch.arange(copies) + seed * copies, zeros, zeros)
    store.fleet.simulators[0].draw_faults_again(torch.arange(copies), key)
    return store


def argument(env: SatelliteTasking, name: str) -> torch.Tensor:
    return env.fleet.simulators[0].argument(name)


def clicking_at(fault_at, n: int = 1, **given) -> SatelliteTasking:
    """Environments 50 s after reset."""
    env = clicking(faults.Fault("clickSize", value=rand.Uniform(2.0, 4.0), at=fault_at, name="loud", **given), n=n)
    counted(env, 5)
    return env


def one_where(env: SatelliteTasking, mask: torch.Tensor) -> int:
    return int(torch.nonzero(mask)[0])


def test_times_follow_the_condition_that_nothing_has_happened():
    env = clicking_at(faults.Sometimes(0.5, rand.Uniform(0.0, 100.0)), n=16)
    at = argument(futures(env, one_where(env, argument(env, "loud.at") > 50.0)), "loud.at")
    assert bool((at > 50.0).all())
    # by Bayes' rule, 0.5 / (0.5 + 0.5 * 0.5) of those without a fault until now never have it; 4 standard errors
    assert float(torch.isinf(at).double().mean()) == pytest.approx(2 / 3, abs=4 * math.sqrt(2 / 9 / COPIES))
    begun = at[torch.isfinite(at)]
    assert float(begun.max()) < 100.0
    assert float(begun.mean()) == pytest.approx(75.0, abs=4 * 50.0 / math.sqrt(12 * len(begun)))
    env = clicking_at(faults.Hazard(0.02), n=16)
    at = argument(futures(env, one_where(env, argument(env, "loud.at") > 50.0)), "loud.at")
    assert float((at - 50.0).min()) > 0.0
    assert float((at - 50.0).mean()) == pytest.approx(50.0, abs=4 * 50.0 / math.sqrt(COPIES))
    env = clicking_at(lambda: float(np.random.uniform(0.0, 100.0)), n=8)
    at = argument(futures(env, one_where(env, argument(env, "loud.at") > 50.0), copies=50), "loud.at")
    assert len(at.unique()) == 50
    assert bool((at > 50.0).all())


def test_changes_that_are_to_come_are_drawn_again():
    env = clicking_at(80.0)
    store = futures(env)
    assert torch.equal(argument(store, "loud.at"), torch.full((COPIES,), 80.0, dtype=torch.float64))  # announced
    size = argument(store, "loud.clickSize")
    assert len(size.unique()) == COPIES
    assert 2.0 <= float(size.min()) < 2.1 < 3.9 < float(size.max()) < 4.0


@pytest.mark.parametrize("backend", ["eager", "compiled"])
@pytest.mark.nightly("eager")
def test_drawn_faults_act_in_the_tick(backend):
    fault = faults.Fault("clickSize", value=rand.Uniform(2.0, 4.0), at=rand.Uniform(0.0, 100.0), name="loud")
    env = clicking(fault, n=16, backend=backend)
    before = counted(env, 5)
    row = one_where(env, argument(env, "loud.at") > 50.0)
    store = futures(env, row, copies=8)
    step = store.full_action_spec.zero().update(store.fake_tensordict().exclude("next"))
    store.step(step.set("action", torch.ones(8, dtype=torch.int64)))
    at, size = argument(store, "loud.at"), argument(store, "loud.clickSize")
    late = 150.0 - torch.ceil(at)
    clicks = (100.0 - late) + late * size
    assert torch.allclose(store.satellite.dynamics.clicks - before[row], clicks, rtol=1e-12)


def test_past_faults_remain():
    env = clicking_at(rand.Uniform(0.0, 100.0), n=16)
    env.inject("loud", envs=[one_where(env, argument(env, "loud.at") > 50.0)])
    row = one_where(env, argument(env, "loud.at") == 50.0)  # began now
    for begun in (row, one_where(env, argument(env, "loud.at") < 50.0)):
        store, state = futures(env, begun, copies=20), env.get_state()[begun]["satellites_0"]
        for name in ("arguments", "parameters"):
            mine = store.get_state()["satellites_0"][name]
            mine, true = (part["values"] if name == "arguments" else part for part in (mine, state[name]))
            assert torch.equal(mine, true.expand_as(mine))


def test_only_the_end_of_a_fault_that_acts_is_drawn_again():
    env = clicking_at(10.0, lasts=rand.Uniform(0.0, 100.0), n=16)
    acts = env.satellite.dynamics.fault_severity.squeeze(1) > 0.0
    store = futures(env, one_where(env, acts))
    for name in ("loud.at", "loud.clickSize"):
        assert len(argument(store, name).unique()) == 1
    lasts = argument(store, "loud.lasts")
    assert bool((lasts > 40.0).all())
    assert float(lasts.mean()) == pytest.approx(70.0, abs=4 * 60.0 / math.sqrt(12 * COPIES))
    over = futures(env, one_where(env, ~acts), copies=20)
    assert len(argument(over, "loud.lasts").unique()) == 1


def test_draws_do_not_depend_on_other_rows():
    env = clicking_at(rand.Uniform(0.0, 100.0), n=16)
    simulator = env.fleet.simulators[0]
    few, many = torch.tensor([3, 9]), torch.arange(16)
    zeros = torch.zeros(16, dtype=torch.int64)
    key = rand.Key(torch.arange(16), zeros, zeros)
    found = []
    for rows in (many, few):
        values = {name: argument(env, name)[rows] for name in ("loud.at", "loud.clickSize")}
        fault = argument(env, "faults")
        found.append(
            drawn_again(
                fault, values, env.fleet.ticks[rows], simulator.h_ns, key.take(rows.tolist()), simulator.type.arguments.draw_some
            )
        )
    assert {"loud.at", "loud.clickSize"} <= found[1].keys()
    for name, value in found[1].items():
        assert torch.equal(value, found[0][name][few])


def test_distributions_of_single_environments_are_kept():
    """In the last instant of a distribution, of 16,383 candidates perhaps none fits; no NaN, no endless loop."""
    env = clicking_at(rand.Uniform(0.0, 50.0 + 1e-9))
    env.fleet.simulators[0].state.arguments["loud.at"][0] = 50.0 + 1e-9
    store = futures(env, copies=3)
    assert argument(store, "loud.at").tolist() == [50.0 + 1e-9] * 3
    fault = faults.Fault("clickSize", value=2.0, at=rand.per_env([70.0, 90.0]), name="loud")
    env = clicking(fault, n=2)
    counted(env, 5)
    zeros = torch.zeros(2, dtype=torch.int64)
    env.fleet.simulators[0].draw_faults_again(torch.arange(2), rand.Key(zeros + 7, torch.arange(2), zeros))
    assert argument(env, "loud.at").tolist() == [70.0, 90.0]


def test_each_satellite_has_its_own_draws():
    from bsk_torch import ConstellationTasking

    fault = faults.Fault("clickSize", value=2.0, at=rand.Uniform(20.0, 100.0), name="loud")
    satellites = [Clicking(name, {"faults": [fault]}) for name in ("A", "B")]
    env = ConstellationTasking(satellites, num_envs=3, backend="eager", time_limit=1000.0, seed=0)
    env.reset()
    simulator = env.fleet.simulators[0]
    zeros = torch.zeros(3, dtype=torch.int64)
    before = simulator.argument("loud.at").clone()
    simulator.draw_faults_again(torch.tensor([0, 2]), rand.Key(zeros[:2] + 7, torch.tensor([0, 2]), zeros[:2]))
    after = simulator.argument("loud.at")
    assert torch.equal(after[2:4], before[2:4])
    assert len({*before.tolist(), *after.tolist()}) == 6 + 4
