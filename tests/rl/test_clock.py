"""Trainings that decisions limit depend on no clock, from Python as from the command line."""

import dataclasses
import time

import pytest
import torch

from bsk_torch.rl.marl.runs import configure, read_config, train
from bsk_torch.rl.training.config import SECONDS, PPOConfig, override
from tests.support.refusals import check_refusals, refusal

SMALL = dict(
    frames=96, num_envs=4, rollout=8, minibatch=16, epochs=1, hidden=(8,), options=dict(time_limit=600.0, backend="compiled")
)


def weights(folder, speed, monkeypatch):
    """Weights after a training during which the clock runs ``speed`` times as fast; ``folder`` is given as text."""
    clock = time.perf_counter
    begin = clock()
    with monkeypatch.context() as patched:
        patched.setattr("bsk_torch.rl.training.progress.time.perf_counter", lambda: begin + speed * (clock() - begin))
        policy = train(configure("NadirScan-v1", seed=0, **SMALL), str(folder), episodes=0, quiet=True)
    return torch.cat([parameter.detach().flatten() for parameter in policy.parameters()])


@pytest.mark.compiled
def test_the_same_seed_gives_the_same_weights_on_a_loaded_machine(tmp_path, monkeypatch):
    idle, loaded = (weights(tmp_path / f"{speed}", speed, monkeypatch) for speed in (1.0, 3000.0))
    assert torch.equal(idle, loaded)
    assert read_config(str(tmp_path / "1.0")).clock is None


def test_decisions_alone_limit_a_training_with_frames():
    timed = configure("NadirScan-v1", seconds=60.0)
    assert [configure("NadirScan-v1").clock, PPOConfig().clock, timed.clock] == [SECONDS, SECONDS, 60.0]
    assert PPOConfig(frames=5).clock is None
    assert dataclasses.replace(configure("NadirScan-v1"), frames=5).clock is None
    assert override(timed, ["frames=5"]).clock is None
    assert override(configure("Constellation-v1"), ["frames=5"]).clock is None
    assert override(timed, ["frames=5", "seconds=7"]).clock == 7.0


def test_unknown_settings_name_what_to_write():
    check_refusals(
        refusal(lambda: configure("NadirScan-v1", minutes=0.3), ValueError, "'minutes'", "seconds=60 * minutes"),
        refusal(lambda: configure("NadirScan-v1", learning_rat=1), ValueError, "'learning_rat'", "'learning_rate'"),
        refusal(lambda: configure("NadirScan-v1", sat_args={}), ValueError, "'sat_args'", "options.sat_args"),
        refusal(lambda: override(PPOConfig(), ["sat_args.mass=1"]), ValueError, "'sat_args'", "options.sat_args"),
    )
