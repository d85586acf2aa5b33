"""Shields: what they take away, in evaluation and in training."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.collectors import Collector

import bsk_torch
from bsk_torch.act import allow_only, forbid
from bsk_torch.presets.aeos_power import FAST, RESERVE
from bsk_torch.rl.evaluation.evaluate import evaluate
from bsk_torch.rl.rules.baselines import Columns, random_policy
from bsk_torch.rl.rules.shield import RULES, ImagerRule, SafeRule, find_rule, shield, shielded

ACTIONS = ["action_nadir_scan", "action_charge", "action_downlink", "action_desat"]


@pytest.fixture(scope="module")
def env():
    return bsk_torch.make("NadirScan-v1", num_envs=4, env_ids=[0] * 4, time_limit=900.0)


@pytest.fixture(scope="module")
def eager():
    return bsk_torch.make("NadirScan-v1", num_envs=4, backend="eager")


def never_scan(see, actions):
    """A rule without any exception."""
    return forbid(actions, "action_nadir_scan", where=see["time"] >= 0.0)


def names(mask):
    """Names of the actions that a mask [A] allows."""
    return [name for name, allowed in zip(ACTIONS, mask.tolist(), strict=True) if allowed]


def test_masks_by_name():
    where = torch.tensor([True, False])
    assert allow_only(ACTIONS, "action_charge", "action_desat", where=where).tolist() == [[False, True, False, True], [True] * 4]
    assert forbid(ACTIONS, "action_charge", where=where).tolist() == [[True, False, True, True], [True] * 4]
    with pytest.raises(ValueError, match=r"'action_charg' is not an action; did you mean 'action_charge'"):
        allow_only(ACTIONS, "action_charg", where=where)


@pytest.mark.parametrize(
    ("charge", "wheel", "allowed"),
    [(0.5, 0.1, ACTIONS), (0.01, 0.1, ["action_charge"]), (0.5, -0.99, ["action_desat"]), (0.01, -0.99, ["action_desat"])],
)
def test_safe_rule_leaves_what_is_urgent(charge, wheel, allowed):
    seen = {"battery_charge_fraction": charge, "wheel_speeds_fraction[0]": 0.0, "wheel_speeds_fraction[1]": wheel}
    mask = SafeRule()(Columns(torch.tensor([list(seen.values())]), list(seen)), ACTIONS)
    assert names(mask[0]) == allowed


@pytest.mark.parametrize(
    ("level", "charge", "allowed"),
    [(0.5, 0.5, ACTIONS), (0.995, 0.1, ["action_downlink"]), (0.99, 0.19, ["action_charge"]), (0.99, 0.2, ACTIONS)],
)
def test_imager_rule_leaves_what_is_urgent(level, charge, allowed):
    seen = {"storage_level_fraction": level, "battery_charge_fraction": charge}
    mask = ImagerRule()(Columns(torch.tensor([list(seen.values())], dtype=torch.float64), list(seen)), ACTIONS)
    assert names(mask[0]) == allowed


@pytest.mark.compiled
def test_imager_rule_fits_the_observations_of_services():
    env = bsk_torch.make("Services-v1", num_envs=2)
    td = shield(RULES["imager"], env)(env.reset())
    assert td["action_mask"].all()


@pytest.mark.compiled
def test_safe_rule_keeps_random_actions_alive():
    env = bsk_torch.make("NadirScan-v1", num_envs=64, env_ids=[0] * 64)
    bold = random_policy(env, 0)
    alone, guarded = (evaluate(policy, env, seeds=range(64)) for policy in (bold, shielded(bold, RULES["safe"], env)))
    # of 2,000 episodes, random actions survive 31 %, with the shield all
    assert alone.survival < 0.6
    assert guarded.survival > 0.95
    gain = guarded.gain_over(alone)
    assert gain.mean > 3.0 * gain.half_width


def test_shields_narrow_the_mask_but_never_to_nothing(eager):
    guard = shield(never_scan, eager)
    legal = torch.tensor([[True, True, False, True], [True, False, False, False]])
    seen = TensorDict({"observation": torch.zeros(2, 12), "action_mask": legal}, [2])
    assert guard(seen)["action_mask"].tolist() == [[False, True, False, True], [True, False, False, False]]


@pytest.mark.compiled
def test_shielded_policies_do_nothing_that_is_forbidden(env):
    assert evaluate(random_policy(env, 0), env, seeds=range(4)).collected.min() > 0.0
    assert evaluate(shielded(random_policy(env, 0), never_scan, env), env, seeds=range(4)).collected.max() == 0.0
    policy = shielded(random_policy(env, 0), never_scan, env)
    batch = next(iter(Collector(env, policy, frames_per_batch=40, total_frames=40, auto_register_policy_transforms=False)))
    assert batch.shape == (4, 10)
    assert bool((batch["action"] != 0).all())
    assert not bool(batch["action_mask"][..., 0].any())  # what a loss takes the probabilities from
    assert bool(batch["next", "action_mask"][..., 0].all())  # what the environment says


@pytest.mark.compiled
@pytest.mark.parametrize("as_set", [False, True])
def test_rules_read_vectors_and_nested_observations(as_set):
    env = bsk_torch.make("AEOSPower-v1", num_envs=6, seed=0, n_targets=20, time_limit=600.0, as_set=as_set, shielded=False)
    env.set_seed(3)
    seen = env.reset()
    see = Columns(seen["observation"], env.satellite.observation_description)
    dynamics = env.satellite.dynamics
    torch.testing.assert_close(see.all("wheel_speeds_fraction").double(), dynamics.wheel_speeds_fraction, atol=1e-7, rtol=1e-6)
    torch.testing.assert_close(see["battery_charge_fraction"].double(), dynamics.battery_charge_fraction, atol=1e-7, rtol=1e-6)
    assert shield(SafeRule(low=2.0), env)(seen)["action_mask"].sum(1).tolist() == [1] * 6


@pytest.mark.compiled
def test_the_shield_of_aeos_power_is_such_a_rule():
    # the preset reads the simulation, the rule the observations: the same to float32
    options = {"num_envs": 16, "seed": 0, "n_targets": 20, "time_limit": 600.0}

    def power_rule(see, actions):
        dusk, dawn = see.all("eclipse").unbind(-1)
        needed = RESERVE + torch.clamp((dawn - dusk) - dusk, min=0.0)
        low = (dawn >= dusk) & (see["battery_charge_fraction"] < needed)
        fast = ~low & (see.all("wheel_speeds_fraction").abs().amax(-1) > FAST)
        return allow_only(actions, "action_charge", where=low) & allow_only(actions, "action_desat", where=fast)

    inside, outside = (
        bsk_torch.make(
            "AEOSPower-v1", shielded=shielded, sat_args={"storedCharge_Init": bsk_torch.rand.Uniform(0.0, 3e5)}, **options
        )
        for shielded in (True, False)
    )
    wanted, given = inside.reset()["action_mask"], shield(power_rule, outside)(outside.reset())["action_mask"]
    assert torch.equal(wanted, given)
    assert 0 < int((wanted.sum(1) == 1).sum()) < 16


def test_rules_are_found_by_name():
    assert find_rule("safe") is RULES["safe"]
    assert find_rule("bsk_torch.rl.rules.shield:SafeRule") is SafeRule
    for name, message in [
        ("save", "did you mean 'safe'"),
        ("nowhere:f", "nowhere"),
        (":f", "Empty module name"),
        ("math:sinn", "'sin'"),
    ]:
        with pytest.raises(ValueError, match=message):
            find_rule(name)
