"""bsk_torch.rule: one function for single satellites and constellations; what environments say of themselves."""

import pytest

import bsk_torch
from bsk_torch.rl.marl import MAPPOConfig
from bsk_torch.rl.training import PPOConfig
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled

FEW = dict(num_envs=2, seed=0, time_limit=300.0)


def test_rules_act_in_both_kinds_of_environments():
    env = bsk_torch.make("NadirScan-v1", **FEW)
    assert env.rollout(2, bsk_torch.rule("rule", env))["action"].shape == (2, 2)
    crew = bsk_torch.make("Constellation-v1", n_satellites=3, n_targets=200, **FEW)
    assert crew.rollout(2, bsk_torch.rule("hasty", crew))["agents", "action"].shape[-1] == 3
    check_refusals(
        refusal(lambda: bsk_torch.rule("hastey", crew), ValueError, "name='hastey'", "'hasty'"),
        refusal(lambda: bsk_torch.rule("rule", crew), ValueError, "observed", "Baselines that fit: random, greedy, nearest"),
        refusal(lambda: bsk_torch.rule("greedy", env), ValueError, "observes no targets. Baselines that fit: random, rule"),
    )


def test_a_hurried_survey_prefers_short_transfers():
    env = bsk_torch.make("RSOInspection-v1", num_envs=32, seed=0, time_limit=8550.0)
    now = env.reset()
    # velocity changes of 3 entries, and how long to wait for the next one
    waits = {name: bsk_torch.rule(name, env)(now.clone())["inspector", "action"][..., 3] for name in ("survey", "hurried_survey")}
    assert bool((waits["hurried_survey"] <= waits["survey"]).all())
    assert float(waits["hurried_survey"].mean()) < 0.8 * float(waits["survey"].mean())


def test_environments_say_what_they_are():
    env = bsk_torch.make("NadirScan-v1", **FEW)
    text = repr(env)
    assert text.startswith("SatelliteTasking: 2 environments on cpu, scenario UniformNadirScanning")
    assert f"{len(env.satellite.observation_description)} observed, 4 actions (action_nadir_scan, " in text
    crew = repr(bsk_torch.make("Constellation-v1", n_satellites=6, n_targets=200, **FEW))
    assert "EO1, EO2, EO3 and 3 more (LinkedImager): 141 observed, 16 actions" in crew


@pytest.mark.parametrize(
    ("kind", "limits", "every"),
    [
        (PPOConfig, dict(seconds=180.0), 250_000),
        (PPOConfig, dict(seconds=None, frames=400_000), 50_000),
        (PPOConfig, dict(seconds=None, frames=10_000_000), 250_000),
        (PPOConfig, dict(seconds=None, frames=64), 0),
        (PPOConfig, dict(seconds=180.0, evaluate_every=0), 0),
        (MAPPOConfig, dict(seconds=180.0), 50_000),
    ],
)
def test_trainings_are_evaluated_by_default(kind, limits, every):
    assert kind(**limits).evaluate_every == every
