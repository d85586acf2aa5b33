"""Environments with catalogs of resident space objects (RSO): batches, saved states, copies."""

import copy
import pickle

import pytest
import torch
from torchrl.envs.utils import check_env_specs

from bsk_torch import ConstellationTasking, SatelliteTasking, act, obs, rand, sats
from bsk_torch.tasks.objects import ImageRSO, RandomRSOCatalog, RSOImageReward, RSOTargets
from tests.support.refusals import check_refusals, refusal
from tests.tasks.objects.objects import EPOCH, KEPT, Imager, catalog, environment, play, state

pytestmark = pytest.mark.compiled

DRAWN = RandomRSOCatalog(6, oe=rand.random_orbit(a=7100.0, i=90.0, Omega=17.0), priority=rand.Uniform(1.0, 2.0))


def drawn(n, **options):
    return environment(imagers=2, catalog=DRAWN, num_envs=n, time_limit=900.0, **options)


def actions(env, step):
    """Actions of each environment that do not depend on the batch."""
    choices = (torch.arange(env.num_envs).unsqueeze(1) * 7 + torch.arange(2) * 3 + step * 5) % 5
    mask = env.satellites[0].action_mask().view(env.num_envs, 2, -1)
    legal = mask.gather(2, choices.unsqueeze(-1)).squeeze(-1)
    return torch.where(legal, choices, 0)


def fly(env, steps, start=0):
    """Rewards, observations and times of some steps."""
    rows = []
    for step in range(start, start + steps):
        moves = torch.ones(env.num_envs, dtype=torch.bool)
        outputs = env.play([actions(env, step)], moves)
        group = next(iter(env.group_map))
        rows.append((outputs[group]["reward"].clone(), outputs[group]["observation"].clone(), env.fleet.sim_time.clone()))
    return rows


def same(one, other, rows=slice(None)):
    for a, b in zip(one, other, strict=True):
        for x, y in zip(a, b, strict=True):
            assert torch.equal(x, y[rows])


def test_episodes_do_not_depend_on_the_batch():
    few, many = drawn(2), drawn(7)
    few.reset()
    many.reset()
    same(fly(few, 6), fly(many, 6), slice(2))


def test_a_saved_state_continues_bit_for_bit():
    env, other = drawn(3), drawn(3, seed=5)
    env.reset()
    other.reset()
    fly(env, 4)
    saved = pickle.loads(pickle.dumps(env.get_state()))
    wanted = fly(env, 4, 4)
    other.restore(saved)
    same(wanted, fly(other, 4, 4))


def test_copies_continue_bit_for_bit():
    env = drawn(3)
    env.reset()
    fly(env, 3)
    others = [copy.deepcopy(env), pickle.loads(pickle.dumps(env)), drawn(3, seed=9), env.like(3)]
    for other in others[2:]:
        other.restore(env, [0, 1, 2], [0, 1, 2])
    wanted = fly(env, 3, 3)
    assert all(torch.equal(a[1], b[1]) for other in others for a, b in zip(wanted, fly(other, 3, 3), strict=True))


def test_what_begins_in_inference_mode_continues_outside():
    with torch.inference_mode():
        env = drawn(2)
        env.reset()
        fly(env, 2)
    wanted = drawn(2)
    wanted.reset()
    fly(wanted, 2)
    same(fly(wanted, 2, 2), fly(env, 2, 2))


def test_one_imager_is_an_environment_of_one_agent():
    r_N, v_N = state(0.0)
    args = KEPT | dict(oe=None, rN=r_N.tolist(), vN=v_N.tolist())
    scenario, rewarder = RSOTargets(catalog(), ["Imager0"]), RSOImageReward()
    env = SatelliteTasking(
        Imager("Imager0", args), scenario, rewarder, world_args=dict(utc_init=EPOCH), num_envs=4, time_limit=600.0, seed=0
    )
    check_env_specs(env)
    td = env.rollout(4, break_when_any_done=False)
    assert td["next", "reward"].shape == (4, 4, 1)


def test_rejects_wrong_saved_states():
    env = drawn(2, backend="eager")
    env.reset()

    def restore(*key, row, value):
        saved = env.get_state()
        saved[("memory", *key)][row] = value
        env.restore(saved)

    steps = env.get_state()["memory", "rso_orbits", "steps"][0, 1] + 1
    table = [
        refusal(lambda: restore("rso_pending", row=(0, 0), value=-1), ValueError, "rso_pending", -1),
        refusal(lambda: restore("rso_orbits", "steps", row=(0, 1), value=steps), ValueError, "rso_orbits", int(steps)),
        refusal(lambda: restore("rso_orbits", "flights", row=(1, 0), value=torch.nan), ValueError, "rso_orbits.flights", "nan"),
    ]
    check_refusals(table)


def test_a_reset_of_some_environments_leaves_the_others():
    env = drawn(3)
    env.reset()
    fly(env, 3)
    before = env.scenario.r_TN_N.clone()
    td = env.reset(env_mask(env, [1]))
    after = env.scenario.r_TN_N
    assert torch.equal(after[[0, 2]], before[[0, 2]])
    assert not torch.equal(after[1], before[1])
    assert td is not None


def env_mask(env, envs):
    """A tensordict that asks for the reset of some environments."""
    from tensordict import TensorDict

    mask = torch.zeros(env.num_envs, 1, dtype=torch.bool)
    mask[envs] = True
    return TensorDict({"_reset": mask}, [env.num_envs])


def test_rollouts_of_random_actions_run():
    env = drawn(4)
    td = env.rollout(12, break_when_any_done=False)
    group = next(iter(env.group_map))
    assert torch.isfinite(td[group, "observation"]).all()
    assert torch.isfinite(td["next", group, "reward"]).all()


@pytest.mark.parametrize("orbit", ["integrated"])
def test_imagers_may_integrate_their_orbits(orbit):
    one, other = drawn(2), drawn(2, orbit=orbit)
    one.reset()
    other.reset()
    pairs = zip(fly(one, 4), fly(other, 4), strict=True)
    differences = [max(float((a[k] - b[k]).abs().max()) for k in range(3)) for a, b in pairs]
    assert max(differences) < 1e-6


class Quick(Imager):
    action_spec = (
        ImageRSO(2, 100.0, 0.0, require_illumination_during_hold=False),
        act.Downlink(duration=60.0),
    )


class Other(sats.Satellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Charge(duration=70.0),)


def test_imagers_of_several_types_share_a_catalog_with_other_satellites():
    satellites = []
    for k, (kind, name) in enumerate(((Other, "Other"), (Imager, "A"), (Quick, "B"), (Imager, "C"))):
        r_N, v_N = state(-0.02 * k)
        args = KEPT | dict(oe=None, rN=r_N.tolist(), vN=v_N.tolist())
        known = kind.default_sat_args().rows
        satellites.append(kind(name, {key: value for key, value in args.items() if key in known}))
    env = ConstellationTasking(
        satellites,
        RSOTargets(catalog(), ["C", "A", "B"]),
        RSOImageReward(lambda record, target: target.priority, quality_threshold=0.0, multi_imager_credit="per_imager"),
        world_args=dict(utc_init=EPOCH),
        num_envs=2,
        time_limit=900.0,
        seed=0,
    )
    env.reset()
    assert sorted(env.scenario.imager_columns) == [1, 2, 3]
    moves = torch.ones(2, dtype=torch.bool)
    env.play([torch.tensor([[0]] * 2), torch.tensor([[2, 2]] * 2), torch.tensor([[0]] * 2)], moves)
    captured, paid = env.rewarder.counts()["captured"], env.rewarder.last_reward_components["acquisition"]
    assert captured[:, 2].tolist() == [1, 1]  # B needs no hold
    assert captured[:, 0].tolist() == [0, 0]
    assert torch.equal(paid > 0.0, captured > 0)


@pytest.mark.parametrize("options", [{"sim_rate": 0.5}, {"sim_dtype": torch.float32}])
def test_images_are_taken_with_other_ticks_and_types(options):
    env = environment(**options)
    env.reset()
    play(env, 2)
    assert env.satellites[0].dynamics.rso_images.tolist() == [1.0, 1.0]
    assert env.satellites[0].dynamics.rso_image_held.tolist() == [5.0, 5.0]
