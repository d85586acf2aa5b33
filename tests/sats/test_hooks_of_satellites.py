"""Satellite classes: what no environment would use is refused at the definition, and masks of wrong shape are named."""

from __future__ import annotations

import pytest
import torch

from bsk_torch import SatelliteTasking, act
from bsk_torch.presets.nadir_scan import ScanningSatellite


@pytest.mark.parametrize(
    ("members", "words"),
    [
        (dict(action_specs=(act.Charge(),)), "action_specs is never used; did you mean 'action_spec'"),
        (dict(observations_spec=()), "did you mean 'observation_spec'"),
        (dict(dyn_types=int), "did you mean 'dyn_type'"),
        (dict(legal_action=lambda self: None), "did you mean 'legal_actions'"),
        (dict(legal_actions=lambda self, mask: None), r"cannot be called as legal_actions\(\)"),
        (dict(get_obs=lambda self: None), r"define an obs\.Observation"),
        (dict(set_action=lambda self, action: None), r"define an act\.Action"),
        (dict(reset_post_sim_init=lambda self: None), r"simulator\.memory"),
    ],
)
def test_what_would_not_run_is_refused_at_the_definition(members, words):
    with pytest.raises(TypeError, match=words):
        type("Mine", (ScanningSatellite,), members)


@pytest.mark.parametrize(
    ("legal", "words"),
    [
        (torch.ones(4, dtype=torch.bool), r"legal_actions\(\) is a tensor of shape \[4\] .* shape \[2, 4\]"),
        (torch.ones(2, 4), r"dtype torch\.float32; .* dtype torch\.bool"),
        ([True] * 4, r"legal_actions\(\) is \[True"),
    ],
)
def test_masks_that_do_not_fit_are_named(legal, words):
    mine = type("Mine", (ScanningSatellite,), {"legal_actions": lambda self: legal})
    env = SatelliteTasking(mine("A"), num_envs=2, backend="eager", time_limit=300.0)
    with pytest.raises(TypeError, match=words):
        env.reset()
