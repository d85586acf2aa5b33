"""Calls out of turn: before the first reset, by two threads at once, for satellites that are dead; in all views."""

import threading
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from gymnasium.error import ResetNeeded
from tensordict import TensorDict

import bsk_torch
from bsk_torch.env.base import ResetNeededError
from bsk_torch.wrappers import GymEnv, GymJointEnv, GymVectorEnv, PettingZooEnv
from tests.support.episodes import begun
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled

N = 3

SETUPS = {
    "scan": lambda **options: bsk_torch.make("NadirScan-v1", **options),
    "imaging": lambda **options: bsk_torch.make("AEOS-v1", n_targets=120, **options),
    "constellation": lambda **options: bsk_torch.make("Constellation-v1", n_satellites=3, n_targets=120, **options),
}


def make(setup, **options):
    return SETUPS[setup](**{"num_envs": N, "seed": 3, "time_limit": 2400.0} | options)


def acting(env, td=None):
    td = TensorDict({}, env.batch_size) if td is None else td
    for key in env.action_keys:
        td = td.set(key, env.full_action_spec[key].zero())
    return td


def test_calls_before_the_first_reset():
    def unstarted(call, *names):
        return refusal(call, ResetNeededError, *names, "reset()")

    some, table = torch.tensor([True, False, False]), []
    for env in map(make, SETUPS):
        table += [
            unstarted(lambda env=env: env.step(acting(env)), "step()"),
            unstarted(lambda env=env: env.step(acting(env).set("_step", some)), "step()"),
            unstarted(lambda env=env: env.rand_step(), "step()"),
            unstarted(lambda env=env: env.rollout(2, auto_reset=False, tensordict=acting(env)), "step()"),
            unstarted(lambda env=env: env.get_state(), "get_state()"),
            unstarted(lambda env=env: env.render(rows=0), "render()", [0]),
            unstarted(lambda env=env: env.reset(TensorDict({"_reset": some.unsqueeze(-1)}, [N])), "reset()", [1, 2]),
        ]
    scan, other = make("scan"), make("scan")
    check_refusals(*table, unstarted(lambda: scan.restore(other), "restore(state)"))


def test_a_new_seed_does_not_end_the_present_episodes():
    """They go on, can be saved, drawn and pickled."""
    env = begun(make("scan"))
    env.reseed(5)
    state = env.get_state()
    assert env.step(acting(env))["next", "duration"].shape == (N, 1)
    assert env.render(rows=0).shape == (480, 640, 3)
    other = make("scan")
    other.load_state_dict(env.state_dict())
    env.restore(state)
    assert bool(other.state.begun.all())


def test_some_episodes_may_be_restored_before_the_first_reset():
    env, other = make("scan"), make("scan")
    env.reset()
    other.restore(env, [0, 1], [2, 2])
    assert other.state.begun.tolist() == [True, True, False]
    check_refusals(refusal(lambda: other.step(acting(other)), ResetNeededError, "environments [2]", "1 in all"))
    again = make("scan")
    again.load_state_dict(other.state_dict())
    assert again.state.begun.tolist() == [True, True, False]
    other.restore(env, [2])
    other.step(acting(other))


VIEWS = {
    "gymnasium": lambda: GymEnv(make("scan", num_envs=1)),
    "vector": lambda: GymVectorEnv(make("scan")),
    "joint": lambda: GymJointEnv(make("constellation", num_envs=1, joint=True)),
    "pettingzoo": lambda: PettingZooEnv(make("constellation", num_envs=1)),
}


def test_rejects_calls_of_views_before_the_first_reset():
    views = {name: build() for name, build in VIEWS.items()}
    simple = [view for name, view in views.items() if name != "pettingzoo"]
    check_refusals(
        *(refusal(lambda v=v: v.step(v.action_space.sample()), ResetNeeded, "step()", "reset()") for v in simple),
        refusal(lambda: views["pettingzoo"].step({}), ResetNeeded, "step()", "reset()"),
        *(refusal(lambda v=v: v.action_masks(), ResetNeeded, "action_masks()", "reset()") for v in simple[:2]),
    )


def test_rejects_calls_of_stable_baselines_before_the_first_reset():
    env = pytest.importorskip("bsk_torch.wrappers.stable_baselines3").SB3VecEnv(make("scan"))
    check_refusals(
        refusal(lambda: env.step(np.zeros(N, dtype=np.int64)), ResetNeeded, "step()", "reset()"),
        refusal(lambda: env.action_masks(), ResetNeeded, "action_masks()", "reset()"),
    )


@pytest.fixture(scope="module")
def lost():
    """A constellation whose second satellite has died in all episodes, and what its agents saw last."""
    env = begun(make("constellation"))
    state = env.get_state()
    state["satellites_0", "task", "dead"][:, 1] = True
    state["removed"][:, 1] = True
    env.restore(state)
    return env


def test_actions_of_the_dead_are_ignored(lost):
    state, table = lost.get_state(), []
    lost.restore(state)
    expected = lost.step(acting(lost))["next"]
    for action in (10**6, -(10**6), 2**63 - 1, -(2**63)):
        lost.restore(state)
        td = acting(lost)
        td["agents", "action"][:, 1] = action
        found = lost.step(td)["next"]
        assert not [key for key in expected.keys(True, True) if not torch.equal(found[key], expected[key])]
        td["agents", "action"][:, 0] = action
        table.append(refusal(lambda td=td: lost.step(td), ValueError, f"action {action}", "environment 0", "legal are 0: "))
    lost.restore(state)
    check_refusals(table)


def test_actions_of_episodes_that_do_not_move_are_ignored():
    env = make("scan")
    td = env.reset().set("action", torch.tensor([0, 99, -7])).set("_step", torch.tensor([True, False, False]))
    assert env.step(td)["next", "duration"][0] > 0.0
    check_refusals(refusal(lambda: env.step(td.exclude("_step")), ValueError, "action 99 of environment 1"))


def test_rejects_actions_that_are_no_integers_in_all_views():
    scan, crew = begun(make("scan")), begun(make("constellation"))
    views = {name: build() for name, build in VIEWS.items()}
    for view in views.values():
        view.reset(seed=1)
    ticks = [view.core.fleet.ticks.clone() for view in views.values()]
    far = {"gymnasium": np.int64(77), "vector": np.full(N, 77), "joint": (0, 77, 0), "pettingzoo": {"EO1": -500}}
    table = [refusal(lambda v=v: views[v].step(far[v]), ValueError, -500 if v == "pettingzoo" else 77) for v in far]
    for value in (float("nan"), float("inf"), 0.5):
        one = TensorDict({"action": torch.full((N,), value)}, [N])
        several = TensorDict({"agents": TensorDict({"action": torch.full((N, 3), value)}, [N, 3])}, [N])
        given = {"gymnasium": value, "vector": np.full(N, value), "joint": (value, 0, 0), "pettingzoo": {"EO1": value}}
        table += [
            refusal(lambda one=one: scan._step(one), TypeError, "integer tensor"),
            refusal(lambda several=several: crew._step(several), TypeError, "integer tensor"),
            *(
                refusal(lambda v=views[name], action=action: v.step(action), TypeError, "integer")
                for name, action in given.items()
            ),
        ]
    check_refusals(table)
    assert all(torch.equal(view.core.fleet.ticks, before) for view, before in zip(views.values(), ticks, strict=True))


def in_thread(call):
    """Call in another thread; what came of it."""
    found = SimpleNamespace(result=None, error=None)

    def run():
        try:
            found.result = call()
        except Exception as error:
            found.error = error

    thread = threading.Thread(target=run, name="visitor")
    thread.start()
    thread.join()
    return found


def test_a_second_thread_is_refused_while_one_is_inside(monkeypatch):
    env = make("scan")
    td = env.reset()
    saved, calls = env.get_state(), {}
    inside = type(env.scenario).finish_step

    def meanwhile(scenario, time):
        for name, call in {
            "step": lambda: env.step(acting(env)),
            "reset": env.reset,
            "restore": lambda: env.restore(saved),
            "get_state": env.get_state,
            "render": lambda: env.render(rows=0),
        }.items():
            calls[name] = in_thread(call).error
        inside(scenario, time)

    expected = make("scan")
    after = expected.step(expected.reset().set("action", torch.zeros(N, dtype=torch.int64)))["next"]
    monkeypatch.setattr(type(env.scenario), "finish_step", meanwhile)
    found = env.step(td.set("action", torch.zeros(N, dtype=torch.int64)))["next"]
    monkeypatch.undo()
    for name, error in calls.items():
        assert isinstance(error, RuntimeError), name
        assert "in use by thread 'MainThread', and 'visitor' called it at the same time" in str(error)
    assert torch.equal(found["observation"], after["observation"])
    assert in_thread(lambda: env.step(acting(env))["next"]).error is None  # one after the other is right


def test_threads_with_environments_of_their_own():
    """At once, and as if each were alone."""

    def play(env):
        td = env.reset()
        for _ in range(5):
            td = env.step(acting(env, td))["next"]
        return td["observation"]

    expected = [play(make("scan", seed=seed)) for seed in range(3)]
    envs, found = [make("scan", seed=seed) for seed in range(3)], {}
    threads = [threading.Thread(target=lambda k=k, env=env: found.update({k: play(env)})) for k, env in enumerate(envs)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(torch.equal(found[k], value) for k, value in enumerate(expected))


def test_two_threads_that_use_one_environment():
    """Each call is refused in words, or is right."""
    env, errors = make("scan", num_envs=40), []
    env.reset()
    barrier = threading.Barrier(2)

    def play():
        barrier.wait()
        for _ in range(30):
            try:
                env.step(acting(env))
            except RuntimeError as error:
                errors.append(str(error))

    threads = [threading.Thread(target=play) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all("in use by thread" in error for error in errors)
    env.check_finite()
    assert bool(torch.isfinite(env.step(acting(env))["next", "observation"]).all())
