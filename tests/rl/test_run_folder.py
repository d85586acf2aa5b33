"""Folders of runs: what is checked before anything is written, one process at a time, torn logs, links."""

import dataclasses
import errno
import logging
import os
import resource
import shutil
import signal
from pathlib import Path

import pytest
import torch

from bsk_torch.rl.policies.checksummed import load_checksummed, save_checksummed
from bsk_torch.rl.policies.files import POLICY, policy_of_file, read_card
from bsk_torch.rl.training import resume, train
from bsk_torch.rl.training.config import CONFIG, PPOConfig, load_config
from bsk_torch.rl.training.lock import LOCK, FolderInUseError, FolderLock
from bsk_torch.rl.training.log import EVALUATIONS, LOG, CsvLog, read_log
from bsk_torch.rl.training.trainer import CHECKPOINT, Training
from tests.support.refusals import check_refusals, refusal
from tests.support.trainings import TINY, weights

pytestmark = pytest.mark.compiled

SMALL = dataclasses.replace(
    TINY,
    frames=72,
    evaluate_every=24,
    checkpoint_every=24,
    learning_rate_schedule="constant",
    entropy_schedule="constant",
    options={"time_limit": 600.0},
)

HALF = dataclasses.replace(SMALL, frames=24)


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Folder of a run that nothing has interrupted."""
    out = tmp_path_factory.mktemp("whole")
    train(SMALL, out, episodes=0)
    return out


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    """Folder of a run that has used a third of what :data:`SMALL` has, in a way that does not depend on the budget."""
    out = tmp_path_factory.mktemp("stopped")
    train(HALF, out, episodes=0)
    return out


@pytest.fixture
def half(stopped, tmp_path):
    """A copy of that folder."""
    return Path(shutil.copytree(stopped, tmp_path / "half"))


def test_rejects_other_settings_at_a_resume_which_change_nothing(half, monkeypatch):
    monkeypatch.setattr("bsk_torch.rl.training.log.find_spec", lambda name: None)  # no wandb
    before, config = contents(half), load_config(half / CONFIG, PPOConfig)
    changes = [
        {"hidden": (16,)},
        {"num_envs": 8},
        {"seed": 1},
        {"network": "gru", "hidden": (8, 8)},
        {"collector": "multi"},
        {"options": {"time_limit": 900.0}},
        *({"options": {"time_limit": 600.0} | more} for more in ({"backend": "eager"}, {"obs_type": dict}, {"foo": 1})),
        {"loggers": ("csv", "wandb")},
        {"preset": "AEOS-v1"},
    ]
    begin = lambda change: Training(dataclasses.replace(config, **change), half, resume=True)
    errors = ValueError, TypeError, ModuleNotFoundError
    check_refusals(refusal(lambda change=change: begin(change), errors) for change in changes)
    assert contents(half) == before


def test_after_a_failed_resume_the_run_goes_on_as_if_nothing_had_happened(half, whole):
    with pytest.raises(ValueError, match="cannot be resumed as"):
        Training(dataclasses.replace(SMALL, options={"time_limit": 900.0}), half, resume=True)
    assert weights(Training(SMALL, half, resume=True).run()).equal(weights(policy_of_file(whole)))


def test_the_file_of_a_policy_has_what_the_whole_training_cost(half):
    before = read_card(half)["training"]
    assert (before["decisions"], before["tuning_runs"]) == (24, 0)
    assert 0.0 < before["core_seconds"] < 60.0
    run = Training(dataclasses.replace(SMALL, tuning_runs=3), half, resume=True)
    run.progress.cpu_before += 1000.0  # as if the first part had taken longer
    run.run(bar=False)
    after = read_card(half)["training"]
    assert (after["decisions"], after["tuning_runs"]) == (72, 3)
    assert 1000.0 < after["core_seconds"] < 1060.0


DAMAGES = [lambda data: data[: len(data) // 2 + 3], lambda data: b"no such file", lambda data: b""]


@pytest.mark.parametrize(("name", "damage"), [(CHECKPOINT, damage) for damage in DAMAGES] + [(CONFIG, DAMAGES[2])])
def test_damaged_files_are_named_and_left(half, name, damage):
    (half / name).write_bytes(damage((half / name).read_bytes()))
    before = contents(half)
    with pytest.raises(ValueError, match=name.replace(".", r"\.")):
        resume(half, episodes=0)
    assert contents(half) == before


def test_rejects_checkpoints_of_others(whole, tmp_path):
    for name in (CONFIG, LOG):
        (tmp_path / name).write_bytes((whole / name).read_bytes())

    def begin(crafted):
        save_checksummed(tmp_path / CHECKPOINT, load_checksummed(whole / CHECKPOINT, "checkpoint") | crafted)
        before = contents(tmp_path)
        try:
            resume(tmp_path, episodes=0)
        finally:
            assert contents(tmp_path) == before

    wrong = [
        *({"learner": value} for value in ({}, 5)),
        {"recent": {}},
        {"generator": torch.zeros(3, dtype=torch.uint8)},
        *({"collected": value} for value in ([{}], 5, [])),
        {"options": {"time_limit": 9.0}},
        {"hidden": None},
        {"seed": torch.zeros(3)},
        *({"progress": value} for value in ((1, 2), (10**30, 0.0, 0.0, 0), (0, float("nan"), 0.0, 0))),
        {"best": {"return": "x"}},
        {"best": {"return": 0.0, "waited": "a", "networks": None}},
        {"best": {"return": 0.0, "waited": 0, "networks": {}}},
    ]
    check_refusals(refusal(lambda crafted=crafted: begin(crafted), ValueError, "checkpoint") for crafted in wrong)


@pytest.mark.parametrize(("name", "value"), [("betas", "x"), ("eps", float("nan")), ("weight_decay", torch.zeros(3))])
def test_rejects_other_settings_of_the_optimizer(whole, tmp_path, name, value):
    saved = load_checksummed(whole / CHECKPOINT, "checkpoint")
    saved["learner"]["optimiser"]["param_groups"][0][name] = value
    (tmp_path / CONFIG).write_bytes((whole / CONFIG).read_bytes())
    save_checksummed(tmp_path / CHECKPOINT, saved)
    check_refusals(refusal(lambda: resume(tmp_path, episodes=0), ValueError, CHECKPOINT))


def test_rejects_moments_of_another_shape(whole, tmp_path):
    saved = load_checksummed(whole / CHECKPOINT, "checkpoint")
    next(iter(saved["learner"]["optimiser"]["state"].values()))["exp_avg"] = torch.zeros(7, 7)
    (tmp_path / CONFIG).write_bytes((whole / CONFIG).read_bytes())
    save_checksummed(tmp_path / CHECKPOINT, saved)
    check_refusals(refusal(lambda: resume(tmp_path, episodes=0), ValueError, CHECKPOINT, "exp_avg", (7, 7)))


def test_a_run_without_a_checkpoint_begins_again(whole, tmp_path):
    for name in (CONFIG, LOG, EVALUATIONS, POLICY):  # what a run leaves that was killed before its first checkpoint
        (tmp_path / name).write_bytes((whole / name).read_bytes())
    assert weights(resume(tmp_path, episodes=0)).equal(weights(policy_of_file(whole)))
    assert read_log(tmp_path / LOG)["frames"] == [24, 48, 72]


def test_a_training_that_diverges_says_so(tmp_path):
    class Diverging(Training):
        def _learn(self, batch):
            if self.iteration == 1:
                with torch.no_grad():
                    next(iter(self.learner.networks.actor.parameters())).fill_(torch.nan)
                batch["action_log_prob"].zero_()
            return super()._learn(batch)

    check_refusals(refusal(lambda: Diverging(SMALL, tmp_path / "run").run(), (RuntimeError, ValueError), "diverged"))
    assert weights(policy_of_file(tmp_path / "run")).isfinite().all()
    assert load_checksummed(tmp_path / "run" / CHECKPOINT, "checkpoint")["progress"][0] == 24


@pytest.fixture
def other(tmp_path):
    """A function that lets another process take the lock of a folder; returns its number."""
    children = []

    def take(folder):
        taken, wrote = os.pipe()
        child = os.fork()
        if child == 0:
            lock = FolderLock(folder)
            (folder / f".{POLICY}.0123456789abcdef.part").touch()
            os.write(wrote, b"x")
            signal.pause()
            lock.release()
        children.append(child)
        assert os.read(taken, 1) == b"x"
        os.close(taken)
        os.close(wrote)
        return child

    yield take
    for child in children:
        end(child)


def end(child):
    try:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    except (ProcessLookupError, ChildProcessError):
        pass


def test_a_folder_in_use_is_refused_and_the_other_process_named(half, other):
    child = other(half)
    before = contents(half)
    for begin in (resume, lambda out: train(SMALL, out, episodes=0)):
        with pytest.raises(FolderInUseError, match=rf"half' is in use by process {child} on {os.uname().nodename} since "):
            begin(half)
    assert contents(half) == before


@pytest.mark.parametrize("make", [Path.symlink_to, Path.hardlink_to], ids=["symbolic", "hard"])
def test_a_lock_that_is_a_link_is_refused_and_its_file_kept(half, tmp_path, make):
    """A run folder of others may contain a link to any file of the user."""
    mine = tmp_path / "thesis.tex"
    mine.write_text("years of work")
    make(half / LOCK, mine)
    before = contents(half)
    kind = "symbolic link" if (half / LOCK).is_symlink() else "hard link"
    starts = resume, lambda out: train(SMALL, out, episodes=0)
    check_refusals([refusal(lambda start=start: start(half), PermissionError, LOCK, kind, "delete it") for start in starts])
    assert (contents(half), mine.read_text()) == (before, "years of work")


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files to others")
def test_a_lock_of_another_user_is_refused(tmp_path):
    (tmp_path / LOCK).write_text("another user's")
    os.chown(tmp_path / LOCK, 1234, 1234)
    check_refusals(refusal(lambda: FolderLock(tmp_path), PermissionError, LOCK, "a file of user 1234"))
    assert (tmp_path / LOCK).read_text() == "another user's"


def test_the_lock_of_a_dead_process_is_taken_over_and_its_leftovers_swept(half, other):
    end(other(half))
    assert {LOCK, f".{POLICY}.0123456789abcdef.part"} <= set(contents(half))
    resume(half, episodes=0)
    assert set(contents(half)) == {POLICY, LOG, EVALUATIONS, CONFIG, CHECKPOINT}


def test_a_run_may_begin_where_one_was_killed_before_it_began(tmp_path, other):
    end(other(tmp_path))
    train(HALF, tmp_path, episodes=0)
    assert set(contents(tmp_path)) == {POLICY, LOG, EVALUATIONS, CONFIG, CHECKPOINT}


def test_one_process_may_not_train_twice_in_a_folder(tmp_path):
    first = Training(HALF, tmp_path / "run")
    with pytest.raises(FolderInUseError, match=f"process {os.getpid()} "):
        resume(tmp_path / "run", episodes=0)
    first.run()
    assert LOCK not in contents(tmp_path / "run")


TORN = [
    pytest.param(lambda data: data[:-7], id="torn"),
    pytest.param(lambda data: data[:-1], id="without its end"),
    pytest.param(lambda data: data + b"3,1,,x\r\n", id="too few columns"),
    pytest.param(lambda data: data + b"\x00" * 60, id="zeros"),
    pytest.param(lambda data: data + data.splitlines(True)[-1].replace(b"1", b"\xff"), id="no text"),
    pytest.param(lambda data: b"", id="empty"),
    pytest.param(lambda data: data[:9], id="half a header"),
]


@pytest.mark.parametrize("tear", TORN)
def test_torn_lines_are_dropped(whole, tmp_path, tear, caplog):
    path = tmp_path / LOG
    path.write_bytes(tear((whole / LOG).read_bytes()))
    read = read_log(path)
    rows = len(read.get("frames", ()))
    assert rows in (0, 2, 3)
    assert all(len(column) == rows for column in read.values())
    log = CsvLog(path, tuple(read_log(whole / LOG)), keep=48)
    log.write(dict.fromkeys(log.columns, 96.0))
    log.close()
    assert read_log(path)["frames"] == [*[24, 48][:rows], 96]


def test_a_torn_log_does_not_block_resuming(half, whole):
    for name in (LOG, EVALUATIONS):
        (half / name).write_bytes((half / name).read_bytes() + b"2,48,0.")
    Training(dataclasses.replace(SMALL, frames=48), half, resume=True).run()
    assert (read_log(half / LOG)["frames"], read_log(half / EVALUATIONS)["frames"]) == ([24, 48], [24, 48])
    assert read_log(half / LOG)["loss_critic"] == read_log(whole / LOG)["loss_critic"][:2]


def test_rows_wait_for_room_on_the_disk(tmp_path, caplog):
    log = CsvLog(tmp_path / LOG, ("frames", "seconds"))
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (25, hard))  # in the middle of a line
    try:
        with caplog.at_level(logging.WARNING):
            for frames in (1, 2, 3):
                log.write({"frames": frames, "seconds": 0.5})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert (tmp_path / LOG).stat().st_size == 25
    assert len([record for record in caplog.records if "training continues" in record.message]) == 1
    log.write({"frames": 4, "seconds": 0.5})
    log.close()
    assert read_log(tmp_path / LOG) == {"frames": [1, 2, 3, 4], "seconds": [0.5] * 4}


def test_a_log_that_cannot_be_opened_stops_nothing(tmp_path, caplog):
    (tmp_path / LOG).mkdir()
    log = CsvLog(tmp_path / LOG, ("frames", "seconds"), keep=5)
    log.write({"frames": 1, "seconds": 1.0})
    assert "training continues" in caplog.text
    (tmp_path / LOG).rmdir()
    log.close()
    assert read_log(tmp_path / LOG) == {"frames": [1.0], "seconds": [1.0]}


def test_a_logger_that_fails_stops_nothing(whole, tmp_path, monkeypatch, caplog):
    class Failing:
        def log_scalar(self, *arguments, **options):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("bsk_torch.rl.training.log._service", lambda name, out: Failing())
    monkeypatch.setattr("bsk_torch.rl.training.log.find_spec", lambda name: object())
    policy = train(dataclasses.replace(SMALL, loggers=("csv", "wandb")), tmp_path / "run", episodes=0)
    assert weights(policy).equal(weights(policy_of_file(whole)))
    assert caplog.text.count("the logger wandb fails") == 1
