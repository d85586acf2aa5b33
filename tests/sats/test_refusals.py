"""Satellite classes that no environment would use, and masks that do not fit."""

import torch

from bsk_torch import SatelliteTasking, act
from bsk_torch.presets.nadir_scan import ScanningSatellite
from tests.support.refusals import check_refusals, refusal


def define(**members):
    return type("Mine", (ScanningSatellite,), members)


def test_rejects_wrong_hooks_and_masks():
    def nothing(self):
        pass

    def argument(self, action):
        pass

    check_refusals(
        refusal(lambda: define(action_specs=(act.Charge(),)), TypeError, "action_specs", "'action_spec'"),
        refusal(lambda: define(observations_spec=()), TypeError, "observations_spec", "'observation_spec'"),
        refusal(lambda: define(dyn_types=int), TypeError, "dyn_types", "'dyn_type'"),
        refusal(lambda: define(legal_action=nothing), TypeError, "legal_action", "'legal_actions'"),
        refusal(lambda: define(legal_actions=argument), TypeError, "legal_actions(self, action)", "legal_actions()"),
        refusal(lambda: define(get_obs=nothing), TypeError, "get_obs", "obs.Observation"),
        refusal(lambda: define(set_action=argument), TypeError, "set_action", "act.Action"),
        refusal(lambda: define(reset_post_sim_init=nothing), TypeError, "reset_post_sim_init", "simulator.memory"),
    )

    def built(legal):
        satellite = define(legal_actions=lambda self: legal)("A")
        return SatelliteTasking(satellite, num_envs=2, backend="eager", time_limit=300.0)

    number, dtype, items = built(torch.ones(4, dtype=torch.bool)), built(torch.ones(2, 4)), built([True] * 4)
    check_refusals(
        refusal(lambda: number.reset(), TypeError, "legal_actions()", [4], [2, 4]),
        refusal(lambda: dtype.reset(), TypeError, "legal_actions()", "torch.float32", "torch.bool"),
        refusal(lambda: items.reset(), TypeError, "legal_actions()", [True] * 4, [2, 4]),
    )
