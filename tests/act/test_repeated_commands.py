"""Commands that are repeated: as in bsk_rl they go on, whatever entry of the list repeats them."""

import pytest
import torch

from bsk_torch import SatelliteTasking, act, dyn, fsw, obs, sats


class Pointing(sats.Satellite):
    observation_spec = (obs.SatProperties(dict(prop="sigma_BN")),)
    action_spec = (act.NadirPoint("a", 1.0), act.NadirPoint("b", 1.0), act.DiscreteFSWAction("action_drift", "c", 1.0))
    dyn_type, fsw_type = dyn.DynamicsModel, fsw.FSWModel


@pytest.fixture(scope="module")
def env():
    return SatelliteTasking(Pointing("A"), backend="eager", time_limit=100.0, dtype=torch.float64)


def turned(env, actions):
    """Whether the attitude is that of a reference after each of several actions of a tick."""
    td, found = env.reset(), []
    for action in actions:
        td = env.step(td.empty().set("action", torch.tensor([action])))["next"]
        found.append(bool(td["observation"].any()))
    return found


def test_only_another_command_begins_anew(env):
    """A new command would set the reference to zero, and with it the attitude of the next tick."""
    assert turned(env, [0, 0, 1, 0, 1]) == [False, True, True, True, True]
    assert turned(env, [0, 0, 2, 1, 1]) == [False, True, False, False, True]


def test_commands_may_be_named_as_methods_of_bsk_rl(env):
    assert env.satellite.action_description == ["a", "b", "c"]
    assert env.satellite.actions.entries[2].fsw_action == "drift"
