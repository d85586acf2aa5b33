"""The views of one episode are read as bsk_rl's environments: numbers and arrays, satellites by name."""

import gymnasium
import numpy as np
import pytest

from bsk_torch.wrappers.general import GymJointEnv
from bsk_torch.wrappers.pettingzoo import PettingZooEnv
from tests.support.refusals import check_refusals, refusal

from .constellations import trio


@pytest.fixture(scope="module")
def single():
    env = gymnasium.make("bsk_torch/NadirScan-v1", backend="eager", time_limit=300.0)
    env.reset(seed=0)
    env.step(1)
    return env.unwrapped


@pytest.fixture(scope="module", params=[GymJointEnv, PettingZooEnv])
def crew(request):
    env = request.param(trio(joint=request.param is GymJointEnv, backend="eager"))
    env.reset(seed=0)
    return env


def test_numbers_and_arrays_of_the_present(single):
    assert (type(single.simulator.sim_time), single.simulator.sim_time) == (float, pytest.approx(120.0))
    assert (single.latest_step_duration, single.time_limit) == (120.0, 300.0)
    dynamics = single.satellite.dynamics
    assert type(dynamics.battery_charge_fraction) is float
    assert (type(dynamics.r_BN_N), dynamics.r_BN_N.shape, dynamics.BN.shape) == (np.ndarray, (3,), (3, 3))
    assert single.satellite.fsw.c_hat_P.shape == (3,)
    assert single.satellite.dynamics.world.sun_direction_N.shape == (3,)


def test_methods_and_arguments_which_are_read_only(single):
    assert single.satellite.is_alive() is True
    assert single.satellite.next_eclipse()[0] > 0.0
    assert single.satellite.sat_args["maxWheelSpeed"] == 6000.0
    assert single.satellite.find_next_opportunities(1, types="ground_station")[0]["r_LP_P"].shape == (3,)
    assert single.satellite.action_description[1] == "action_charge"
    check_refusals(refusal(lambda: setattr(single.satellite, "name", "other"), AttributeError, "'name'", "read-only"))


def test_satellites_of_one_type_are_told_apart_and_share_a_scenario(crew):
    assert [satellite.name for satellite in crew.satellites] == crew.core.names
    positions = np.stack([satellite.dynamics.r_BN_N for satellite in crew.satellites])
    np.testing.assert_array_equal(positions, crew.core.satellites[0].dynamics.r_BN_N.numpy())
    last = crew.get_satellite(crew.core.names[-1])
    np.testing.assert_array_equal(last.dynamics.r_BN_N, positions[-1])
    assert crew.scenario.value_per_second == 0.1
    assert crew.communicator.is_silent is True
