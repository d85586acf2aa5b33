"""The function that plays episodes: which rows take a step, what is carried to the next one, and when it ends."""

import itertools

import pytest
import torch
from tensordict import TensorDict

import bsk_torch
from bsk_torch.env.rollout import play_episodes
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled

N = 3


def scanning(**options):
    return bsk_torch.make("NadirScan-v1", num_envs=N, seed=0, time_limit=400.0, **options)


def charging(now):
    return now.set("action", torch.ones(N, dtype=torch.int64))


def test_ended_episodes_take_no_more_steps():
    env = scanning()
    env.reset()
    env.play(torch.zeros(N, dtype=torch.int64), torch.tensor([True, False, False]))  # row 0 is ahead of the others
    start = TensorDict(done=torch.zeros(N, 1, dtype=torch.bool), batch_size=[N])
    steps = [(playing.clone(), step["next", "done"].squeeze(-1)) for playing, step in play_episodes(env, charging, start)]
    taken = torch.stack([playing for playing, _ in steps])
    assert taken.sum(0).tolist() == [2, 4, 4]  # 220 s and 400 s; charging lasts 120 s
    for (playing, done), (following, _) in itertools.pairwise(steps):
        assert torch.equal(following, playing & ~done)
    assert torch.equal(env.fleet.sim_time, torch.full((N,), 400.0, dtype=torch.float64))


def test_only_played_rows_and_entries_under_next_are_carried():
    env = scanning()
    steps = list(play_episodes(env, charging, env.reset(), torch.tensor([False, True, False])))
    assert (len(steps), env.fleet.sim_time.tolist()) == (4, [0.0, 400.0, 0.0])
    seen = []

    def policy(now):
        seen.append((now.get("count", None), "scratch" in now.keys()))  # noqa: SIM118  - a tensordict
        count = now.get("count", torch.zeros(N, dtype=torch.int64))
        return charging(now).update({"scratch": count, "next": {"count": count + 1}})

    list(play_episodes(scanning(), policy))
    assert [None if count is None else count.tolist() for count, _ in seen] == [None, *([k] * N for k in range(1, 4))]
    assert not any(scratch for _, scratch in seen)


def test_no_gradients_are_kept():
    weight = torch.ones(1, requires_grad=True)

    def policy(now):
        return charging(now).set("value", now["observation"].sum(-1) * weight)

    steps = list(play_episodes(scanning(), policy))
    assert not any(step["value"].requires_grad for _, step in steps)
    assert torch.is_grad_enabled()


def test_rejects_episodes_that_do_not_end():
    endless = lambda: list(play_episodes(scanning(), charging, max_steps=2))
    check_refusals(refusal(endless, RuntimeError, "3 episodes", "max_steps=2"))


@pytest.mark.compiled
def test_constellations_are_played_like_single_satellites():
    options = dict(n_satellites=3, n_planes=1, phasing=0, n_targets=500, time_limit=600.0, as_set=True)
    env = bsk_torch.make("Constellation-v1", num_envs=2, seed=0, **options)
    earned = torch.zeros(2, dtype=torch.float64)
    for playing, step in play_episodes(env, bsk_torch.rule("greedy", env)):
        earned += torch.where(playing, step["next", "agents", "reward"].double().sum((1, 2)), 0.0)
    assert bool(env.fleet.sim_time.eq(600.0).all())
    assert float(earned.max()) > 0.0
    torch.testing.assert_close(earned, env.returns, atol=1e-5, rtol=1e-6)  # rewards are float32
