"""The policies that come with the package fly as well as it says."""

import pytest
import torch

import bsk_torch
from bsk_torch.presets import PRESETS
from bsk_torch.rl.evaluation.evaluate import evaluate
from bsk_torch.rl.policies.files import SAME_EPISODES, read_card
from bsk_torch.rl.policies.pretrained import FOLDER, makings, pretrained, pretrained_file
from bsk_torch.rl.policies.shared_policy import shared
from tests.support.refusals import check_refusals, refusal

SAME = 0.02
"""Relative: where two actions are equally good to rounding, another processor may take the other one."""


@pytest.mark.nightly(*(set(makings()) - {"NadirScan-v1", "NadirScience-v1", "AEOS-v1", "RSOInspection-v1", "MultiInspection-v1"}))
@pytest.mark.compiled
@pytest.mark.parametrize("preset", makings())
def test_a_pretrained_policy_has_its_score(preset):
    noted, card = makings()[preset], read_card(pretrained_file(preset))
    assert card["preset"] == preset
    expected = torch.tensor(noted["first"], dtype=torch.float64)
    env = bsk_torch.make(preset, num_envs=len(expected), **card["options"])
    policy, seed = pretrained(preset), noted["score"]["seed"]
    result = evaluate(shared(policy, env), env, seed=seed)
    torch.testing.assert_close(result.returns.mean(), expected.mean(), rtol=SAME, atol=0.0)


WITHOUT = {"AEOSBench-v1", "HeteroCluster-v1", "ThreeSensors-v1", "Walker4-v1", "CWDocking-v1", "CWInspection-v1"}
WITHOUT |= {"AreasTeam-v1", "Sites-v1", "SitesTeam-v1", "TipAndCue-v1"}
"""Presets without a policy."""


def test_every_other_preset_has_one_of_a_release_and_says_what_made_it():
    assert set(makings()) == set(PRESETS) - WITHOUT
    assert {read_card(file)["bsk_torch"] for file in FOLDER.glob("*.pt")} | {bsk_torch.__version__} <= set(SAME_EPISODES)
    assert {path.stem for path in FOLDER.glob("*.pt")} == set(makings())
    for noted in makings().values():
        assert noted["command"].split()[0] == "bsk-torch"
        assert noted["seconds"] > 0
        assert noted["score"]["episodes"] >= 256
    assert sum(path.stat().st_size for path in FOLDER.iterdir()) < 5e6


def test_a_policy_of_another_preset_says_where_it_was_trained():
    env = bsk_torch.make("NadirScan-v1", num_envs=2, backend="eager")
    check_refusals(
        refusal(lambda: env.rollout(1, pretrained("AEOS-v1")), ValueError, "trained for AEOS-v1 as_set=True"),
        refusal(lambda: env.rollout(1, pretrained("NadirScience-v1")), ValueError, "NadirScience-v1", "12 numbers"),
        refusal(lambda: pretrained("HeteroCluster-v1"), ValueError, "'HeteroCluster-v1'", "cooperative"),
        refusal(lambda: pretrained("AEOS-v2"), ValueError, "is not a preset", "'AEOS-v1'"),
    )
