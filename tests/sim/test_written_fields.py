"""Fields that users write: what the next tick would overwrite is refused, and what counts is followed."""

import pytest
import torch

from bsk_torch.rand import first_key
from bsk_torch.sim import dyn, fsw
from bsk_torch.sim.simulator import Simulator
from tests.sim.simulators import make_simulator
from tests.support.refusals import check_refusals, refusal

OPTIONS = dict(num_envs=2, dtype=torch.float64, sim_rate=1.0, horizon=0.0, backend="eager")
ALL = torch.tensor([True, True])
ORBIT = {"oe": [7e6, 0.001, 1.0, 0.1, 0.2, 0.3]}


def simulator(dyn_type: type, fsw_type: type, **options) -> Simulator:
    found = make_simulator(dyn_type, fsw_type, ORBIT, {}, **(OPTIONS | options))
    found.reset(found.state.all_rows, found.type.arguments.draw(first_key(2)), torch.zeros(2, dtype=torch.float64))
    return found


@pytest.mark.parametrize("name", ["r_BN_N", "v_BN_N"])
def test_position_and_velocity_on_an_arc_cannot_be_written(name):
    sim = simulator(dyn.EclipseDynModel, fsw.FSWModel)
    before = sim.state.planes.clone()
    check_refusals(refusal(lambda: sim.write(name, ALL, torch.zeros(2, 3)), ValueError, "next tick", "orbit='integrated'"))
    assert torch.equal(sim.state.planes, before)


def test_rejects_fields_that_a_tick_computes_anew():
    sim, two, rotation = simulator(dyn.EclipseDynModel, fsw.FSWModel), torch.zeros(2), torch.zeros(2, 3)
    check_refusals(
        refusal(lambda: sim.write("illumination", ALL, two), ValueError, "'illumination'", "orbit", "Sun"),
        refusal(lambda: sim.write("sigma_BN", ALL, rotation), ValueError, "'sigma_BN'", "sigma_RN", "omega_RN_N"),
        refusal(lambda: sim.write("sigma_RM", ALL, rotation), KeyError, "'sigma_RM'", "'sigma_RN'"),
    )


def test_a_reference_that_is_written_is_imposed():
    sim = simulator(dyn.DynamicsModel, fsw.FSWModel)
    sigma = torch.tensor([[0.1, 0.2, -0.3], [0.0, 0.4, 0.0]], dtype=torch.float64)
    sim.write("sigma_RN", torch.tensor([True, False]), sigma)
    sim.run(torch.tensor([1, 1]))
    assert torch.equal(sim.read("sigma_BN"), sigma * torch.tensor([[1.0], [0.0]]))


def test_a_velocity_that_is_written_is_flown_where_the_orbit_is_integrated():
    """A change along the velocity raises the orbit of one row and leaves that of the other."""
    sim, twin = (simulator(dyn.DynamicsModel, fsw.FSWModel, orbit="integrated") for _ in range(2))
    push = sim.read("v_BN_N") * 1.01
    sim.write("v_BN_N", torch.tensor([True, False]), push)
    for s in (sim, twin):
        s.run(torch.tensor([10, 10]))
    moved = (sim.read("r_BN_N") - twin.read("r_BN_N")).norm(dim=-1)
    assert (moved[0].item(), moved[1]) == (pytest.approx(10.0 * 0.01 * 7.5e3, rel=0.02), 0.0)
