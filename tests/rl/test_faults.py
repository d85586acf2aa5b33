"""Faults injected into trainings: the run goes on, or stops so that it can be resumed, and equals one without, bit for bit."""

import dataclasses
import errno
import logging
import multiprocessing
import os
import random
import resource
import signal
import time

import pytest
from torch._inductor import config

from bsk_torch.codegen import build
from bsk_torch.rl.policies.files import POLICY, policy_of_file
from bsk_torch.rl.training import resume, train
from bsk_torch.rl.training.config import CONFIG
from bsk_torch.rl.training.log import EVALUATIONS, LOG, read_log
from bsk_torch.rl.training.trainer import CHECKPOINT, Training
from tests.support.refusals import check_refusals, refusal
from tests.support.trainings import TINY, weights

pytestmark = pytest.mark.compiled

SMALL = dataclasses.replace(TINY, frames=144, checkpoint_every=24)

FILES = {POLICY, LOG, EVALUATIONS, CONFIG, CHECKPOINT}

SAME = {
    LOG: ("frames", "return", "survival", "entropy", "kl", "loss_critic", "learning_rate", "simulated_days"),
    EVALUATIONS: ("frames", "return", "survival", "collected", "fill"),
}
"""Columns of the logs that do not depend on the clock."""


def same(one, other):
    """Whether two runs have left the same policy and logs, and nothing else besides."""
    assert {path.name for path in one.iterdir()} == {path.name for path in other.iterdir()}
    assert weights(policy_of_file(one)).equal(weights(policy_of_file(other)))
    for name, columns in SAME.items():
        first, second = read_log(one / name), read_log(other / name)
        assert [str(first.get(column)) for column in columns] == [str(second.get(column)) for column in columns]
    return True


def go_on(out, config=SMALL):
    """Train in a folder, or go on with the run in it, as users would."""
    if (out / CONFIG).is_file():
        resume(out, episodes=0)
    else:
        train(config, out, episodes=0)


@pytest.fixture(scope="module")
def processes():
    """Starts processes that have imported what they need, so that they begin to train at once."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["bsk_torch.rl.training", "tests.rl.test_faults"])
    return context


@pytest.fixture(scope="module")
def whole(processes, tmp_path_factory):
    """Folder of a run without faults, and the time that it takes, s."""
    out = tmp_path_factory.mktemp("faults") / "whole"
    for _ in range(2):  # the first one also waits for the imports
        begin = time.perf_counter()
        process = processes.Process(target=go_on, args=(out,))
        process.start()
        process.join()
        seconds = time.perf_counter() - begin
    assert process.exitcode == 0
    return out, seconds


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.nightly(*map(str, range(1, 20)))
def test_a_killed_training_goes_on_as_if_nothing_had_happened(processes, whole, tmp_path, seed):
    """Killed at a random moment, resumed, killed again, and resumed."""
    out, draw = tmp_path / "run", random.Random(seed)
    for _ in range(2):
        process = processes.Process(target=go_on, args=(out,))
        process.start()
        process.join(draw.uniform(0.0, whole[1]))
        process.kill()
        process.join()
        assert process.exitcode in (-signal.SIGKILL, 0)
    go_on(out)
    assert same(out, whole[0])


def full(*arguments):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_training_goes_on_while_the_disk_is_full(whole, tmp_path, monkeypatch, caplog):
    class Full(Training):
        def _learn(self, batch):
            if self.iteration == 2:
                monkeypatch.setattr("bsk_torch.files.os.fsync", full)
            elif self.iteration == 4:
                monkeypatch.undo()
            return super()._learn(batch)

    with caplog.at_level(logging.WARNING):
        Full(SMALL, tmp_path / "run").run()
    assert caplog.text.count("no new checkpoint.pt") == 2
    assert same(tmp_path / "run", whole[0])


def limited(out, most):
    """Train where no file may have more than ``most`` bytes."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
    try:
        go_on(out)
    except OSError as error:
        os._exit(42 if "cannot be written: File too large" in str(error) else 1)


def test_a_disk_that_stays_full_stops_a_training_that_can_be_resumed(processes, whole, tmp_path):
    out = tmp_path / "run"
    checkpoint = (whole[0] / CHECKPOINT).stat().st_size
    process = processes.Process(target=limited, args=(out, checkpoint // 2))
    process.start()
    process.join()
    assert process.exitcode == 42
    assert {path.name for path in out.iterdir()} <= FILES - {CHECKPOINT}
    go_on(out)
    assert same(out, whole[0])


def test_a_read_only_folder_stops_a_training_that_can_be_resumed(whole, tmp_path, monkeypatch):
    """Refused when a run begins, survived while it goes on, said at its end."""

    def read_only(*arguments):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    class ReadOnly(Training):
        def _learn(self, batch):
            if self.iteration == 3:
                monkeypatch.setattr("bsk_torch.files.os.replace", read_only)
            return super()._learn(batch)

    check_refusals(
        refusal(lambda: ReadOnly(SMALL, tmp_path / "run").run(), OSError, "Read-only file system", "checkpoint.pt"),
        refusal(lambda: resume(tmp_path / "run", episodes=0), OSError, "Read-only file system", "config.yaml"),
    )
    monkeypatch.undo()
    go_on(tmp_path / "run")
    assert same(tmp_path / "run", whole[0])


@pytest.mark.nightly
def test_a_compiler_that_disappears_stops_a_training_that_can_be_resumed(whole, tmp_path, monkeypatch):
    out = tmp_path / "run"
    train(dataclasses.replace(SMALL, frames=24), out, episodes=0)
    (out / CONFIG).write_bytes((whole[0] / CONFIG).read_bytes())
    monkeypatch.setattr(build, "LOADED", {})
    monkeypatch.setenv("BSK_TORCH_CACHE", str(tmp_path / "cache"))
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    missing = config.patch({"cpp.cxx": (None, "/missing/c++")})
    with missing, pytest.raises(RuntimeError, match=r"needs a C\+\+ compiler, but /missing/c\+\+ does not run here"):
        resume(out, episodes=0)
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    monkeypatch.undo()
    resume(out, episodes=0)
    assert read_log(out / LOG)["frames"][-1] == SMALL.frames
