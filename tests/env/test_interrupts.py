"""Ctrl-C during long runs, and what a step that did not come to its end leaves behind."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import torch

import bsk_torch
from bsk_torch import act, data, obs, scene
from bsk_torch.env.base import ResetNeededError
from bsk_torch.presets.nadir_scan import ScanningSatellite, scanning_args
from bsk_torch.sim import simulator as simulation
from bsk_torch.sim.component import Arg, Component, Field
from tests.support.episodes import unchanged
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled

SECOND = 1.0
"""Longest time until Ctrl-C is answered, s."""

SCRIPT = """
import json, os, signal, sys, threading, time
import torch
from tests.env.test_interrupts import long_steps

torch.set_num_threads(1)
answers = []
for n, delay in ((1, 0.2), (1, 0.7), (512, 1.0)):
    env, sent = long_steps(n), []
    td = env.reset()
    timer = threading.Timer(delay, lambda: (sent.append(time.perf_counter()), os.kill(os.getpid(), signal.SIGINT)))
    timer.start()
    try:
        env.step(td.set("action", torch.zeros(env.batch_size, dtype=torch.int64)))
        answers.append("finished")
    except KeyboardInterrupt:
        answers.append(time.perf_counter() - sent[0])
    try:
        env.rand_step(td)
    except RuntimeError as error:
        answers.append(str(error))
print(json.dumps(answers))
"""


def long_steps(n: int, seconds: float = 1e7) -> bsk_torch.SatelliteTasking:
    """NadirScan-v1 with steps of ten million seconds."""
    satellite = type("Long", (ScanningSatellite,), {"action_spec": (act.Charge(duration=seconds),)})
    parts = satellite("Scanner1", sat_args=scanning_args()), scene.UniformNadirScanning(), data.ScanningTimeReward()
    return bsk_torch.SatelliteTasking(*parts, num_envs=n, seed=1, time_limit=float("inf"))


def test_long_steps_answer_within_a_second_and_come_to_their_end(monkeypatch):
    folder = Path(__file__).parents[2]
    run = subprocess.run([sys.executable, "-c", SCRIPT], cwd=folder, capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stderr[-2000:]
    answers = json.loads(run.stdout.splitlines()[-1])
    assert len(answers) == 6
    for seconds, words in zip(answers[::2], answers[1::2], strict=True):
        assert seconds < SECOND
        assert "a step was interrupted" in words
        assert "call reset() first" in words
    # Three days at once: arcs move on piece by piece, and windows are found where the step ends.
    monkeypatch.setattr(simulation, "ticks_at_once", lambda rows: 20_000)
    env = long_steps(1, 3e5)
    step = env.step(env.reset().set("action", torch.zeros(1, dtype=torch.int64)))["next"]
    assert step["duration"].item() == 3e5
    assert bool(torch.isfinite(step["observation"]).all())
    assert env.simulator.arcs.length < 1e5


MAKES = {
    "scan": (lambda: bsk_torch.make("NadirScan-v1", num_envs=3, seed=1), "ticks"),
    "imaging": (lambda: bsk_torch.make("AEOS-v1", n_targets=120, num_envs=3, seed=1), "images"),
    "constellation": (lambda: bsk_torch.make("Constellation-v1", n_satellites=3, n_targets=120, num_envs=3, seed=1), "images"),
    "two types": (lambda: bsk_torch.make("RelayConstellation-v1", num_envs=2, seed=1), "images"),
}


def play(env, steps=6):
    td = env.reset()
    for _ in range(steps):
        for key in env.action_keys:
            mask = td[(*key[:-1], "action_mask")] if isinstance(key, tuple) else td["action_mask"]
            td = td.set(key, mask.long().argmax(-1))
        td = env.step(td)["next"].exclude("reward")
    return td, [simulator.state.planes.clone() for simulator in env.fleet.simulators], env.fleet.ticks.clone()


@pytest.mark.parametrize("name", MAKES)
def test_runs_in_pieces_are_the_same(name, monkeypatch):
    """Bit for bit, also where an image ends a run in the last tick of a piece."""
    env = MAKES[name][0]()
    env.set_seed(7)
    td, planes, ticks = play(env)
    calls = []
    for most in (2, 7) if name == "scan" else (5, 64):
        monkeypatch.setattr(simulation, "ticks_at_once", lambda rows, most=most: calls.append(rows) or most)
        env.set_seed(7)
        pieces = play(env)
        assert torch.equal(pieces[2], ticks)
        assert all(torch.equal(a, b) for a, b in zip(pieces[1], planes, strict=True))
        assert all(torch.equal(pieces[0][key], td[key]) for key in td.keys(True, True))
    assert calls


def test_stops_of_users_end_runs_in_pieces(monkeypatch):
    """A component of a user's own that stops: in the first, in the last and in any tick of a piece."""

    def stop(bus):
        bus.stop = bus.ticks >= 10.0 + bus.stop_after

    part = Component(
        "stopper",
        stop,
        (Arg("stop_after", 0.0, "tick", "when to stop"),),
        params=(Field("stop_after", exact=True),),
        prepare=lambda args: {"stop_after": args["stop_after"]},
        stops=True,
        after="image_event",
    )
    dyn_type = type("Stopping", (ScanningSatellite.dyn_type,), {"components": (part,)})
    satellite = type("Stopped", (ScanningSatellite,), {"dyn_type": dyn_type})
    waits = torch.arange(6, dtype=torch.float64)
    args = scanning_args() | {"stop_after": bsk_torch.rand.per_env(waits)}
    parts = satellite("Scanner1", sat_args=args), scene.UniformNadirScanning(), data.ScanningTimeReward()
    env = bsk_torch.SatelliteTasking(*parts, num_envs=6, seed=1, time_limit=3000.0, backend="eager")
    for most in (None, 2, 5):
        if most is not None:
            monkeypatch.setattr(simulation, "ticks_at_once", lambda rows, most=most: most)
            monkeypatch.setattr(simulation, "Kernel", type(env.simulator.runners.run))
        env.reset()
        ran = env.simulator.run(torch.full((6,), 30))
        assert ran.tolist() == (10 + torch.arange(6)).tolist(), most


def test_an_error_within_a_step_ends_the_episodes_of_the_step(monkeypatch):
    env = bsk_torch.make("NadirScan-v1", num_envs=4, seed=1, time_limit=600.0)
    td = env.reset()
    saved = env.get_state()
    moves = torch.tensor([True, False, True, False])
    call = td.clone().set("action", torch.zeros(4, dtype=torch.int64)).set("_step", moves)

    def fail(*args):
        raise ZeroDivisionError("a rewarder that divides")

    with monkeypatch.context() as patch:
        patch.setattr(env.rewarder, "calculate_reward", fail)
        check_refusals(refusal(lambda: env.step(call.clone()), ZeroDivisionError))
    assert env.state.begun.tolist() == (~moves).tolist()
    for use in (lambda: env.step(call.clone()), env.get_state, lambda: env.render(rows=0)):
        with pytest.raises(ResetNeededError, match=r"environments \[0.*a step was interrupted"):
            use()
    env.restore(saved, torch.tensor([0, 2]))
    assert torch.equal(env.get_state()["satellites_0", "planes"], saved["satellites_0", "planes"])
    assert bool((env.step(call.clone())["next", "duration"] >= 0.0).all())


def test_a_wrong_action_of_a_later_type_changes_nothing():
    """Actions of all types are decided before any is begun."""
    env = bsk_torch.make("RelayConstellation-v1", num_envs=2, seed=1)
    td = env.reset()
    for group in env.groups:
        td = td.set((group.name, "action"), torch.zeros(2, len(group.agents), dtype=torch.int64))
    last = env.groups[-1].name
    wrong = td.set((last, "action"), torch.full_like(td[last, "action"], 10**6))
    with unchanged(env):
        check_refusals(refusal(lambda: env.step(wrong), ValueError, 10**6))


def test_a_signal_while_a_prepared_episode_is_made(monkeypatch):
    """Episodes that were being prepared are prepared again."""
    env = bsk_torch.make("NadirScan-v1", num_envs=40, seed=1, time_limit=600.0)
    expected = bsk_torch.make("NadirScan-v1", num_envs=40, seed=1, time_limit=600.0).reset()["observation"]
    start = env.pool.start

    def interrupted(*args):
        start(*args)
        os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(env.pool, "start", interrupted)
    check_refusals(refusal(lambda: env.reset(), KeyboardInterrupt))
    monkeypatch.setattr(env.pool, "start", start)
    assert torch.equal(env.reset()["observation"], expected)


def test_a_property_that_resets_its_environment_and_fails_leaves_no_running_episodes():
    """The reset begins episodes; the step around it, which fails, must not leave them running."""
    resets = []

    def reset(satellite):
        if resets:
            resets.pop()
            env.reset()
            raise ZeroDivisionError
        return satellite.dynamics.battery_charge_fraction

    kind = type("Resetting", (ScanningSatellite,), {"observation_spec": (obs.SatProperties(dict(prop="own", fn=reset)),)})
    parts = kind("Scanner1", sat_args=scanning_args()), scene.UniformNadirScanning(), data.ScanningTimeReward()
    env = bsk_torch.SatelliteTasking(*parts, num_envs=2, seed=1, backend="eager")
    td = env.reset().set("action", torch.zeros(2, dtype=torch.int64))
    resets.append(True)
    with pytest.raises(ZeroDivisionError):
        env.step(td)
    check_refusals(refusal(lambda: env.step(td), ResetNeededError, "a step was interrupted", "reset()"))
