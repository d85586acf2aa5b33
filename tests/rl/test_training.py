"""Training runs: what they leave behind, how they go on after an interruption, and where experience comes from."""

import dataclasses
import importlib
import multiprocessing
import os
import signal
import time

import pytest
import torch

import bsk_torch
from bsk_torch.presets import PRESETS
from bsk_torch.rl.policies.files import POLICY, policy_of_file
from bsk_torch.rl.training import resume, train
from bsk_torch.rl.training.collect import make_collector, prepared, start_worker
from bsk_torch.rl.training.config import CONFIG, PPOConfig, load_config
from bsk_torch.rl.training.episodes import RecentEpisodes
from bsk_torch.rl.training.log import COLUMNS, EVALUATED, EVALUATIONS, LOG, read_log
from bsk_torch.rl.training.trainer import CHECKPOINT, Training, read_checkpoint
from tests.support import trainings
from tests.support.refusals import check_refusals, refusal
from tests.support.trainings import weights

pytestmark = [pytest.mark.compiled, pytest.mark.usefixtures("forked")]

SHORT = {"time_limit": 1200.0}

TINY = dataclasses.replace(trainings.TINY, epochs=2)

SAME = ("return", "survival", "collected", "fill", "decisions", "entropy", "kl", "loss_critic", "learning_rate", "simulated_days")
"""Columns of the log that do not depend on the clock."""


class Interrupted(Training):
    """Gets a Ctrl-C while it learns from its second batch."""

    def _learn(self, batch):
        if self.iteration == 1:
            os.kill(os.getpid(), signal.SIGINT)
        return super()._learn(batch)


def same_logs(one, other, columns=SAME, name=LOG):
    first, second = read_log(one / name), read_log(other / name)
    return all(
        torch.tensor(first[key]).equal(torch.tensor(second[key])) or str(first[key]) == str(second[key]) for key in columns
    )


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    out = tmp_path_factory.mktemp("run")
    return out, train(TINY, out, episodes=0)


def test_a_run_leaves_all_its_files_and_the_best_policy(run):
    out, _ = run
    assert {path.name for path in out.iterdir()} == {POLICY, LOG, EVALUATIONS, CONFIG, CHECKPOINT}
    assert load_config(out / CONFIG, PPOConfig) == TINY
    log, judged = read_log(out / LOG), read_log(out / EVALUATIONS)
    assert (tuple(log), tuple(judged), log["frames"]) == (COLUMNS, EVALUATED, [24, 48, 72, 96])
    assert judged["frames"] == [48, 96]
    assert all(0.0 <= level <= 1.0 for level in judged["fill"])
    out, policy = run
    kept = policy_of_file(out / POLICY)
    assert weights(kept).equal(weights(policy))
    env = bsk_torch.make("NadirScan-v1", num_envs=2, seed=0, **SHORT)
    now = env.reset()
    assert kept(now.clone())["logits"].equal(policy(now.clone())["logits"])
    state = torch.load(out / CHECKPOINT, weights_only=True)
    assert state["best"]["return"] == pytest.approx(max(read_log(out / EVALUATIONS)["return"]), rel=1e-5)  # the file's digits


def test_rejects_folders_that_do_not_fit_and_leaves_them(run, tmp_path):
    out, _ = run
    before = (out / LOG).read_text()
    check_refusals(refusal(lambda: Training(TINY, out), FileExistsError, "empty"))
    assert (out / LOG).read_text() == before
    check_refusals(refusal(lambda: Training(TINY, tmp_path, resume=True), FileNotFoundError, "checkpoint.pt"))
    assert not list(tmp_path.iterdir())


def test_a_resumed_run_remembers_what_its_policy_remembered(tmp_path):
    config = dataclasses.replace(TINY, network="gru", hidden=(8, 6), evaluate_every=0)
    whole = train(config, tmp_path / "whole", episodes=0)
    Interrupted(config, tmp_path / "broken").run()
    assert weights(resume(tmp_path / "broken", episodes=0)).equal(weights(whole))


def test_a_resumed_run_is_the_uninterrupted_one(run, tmp_path):
    out, policy = run
    broken = Interrupted(TINY, tmp_path / "broken")
    broken.run()
    assert broken.interrupted
    assert read_log(tmp_path / "broken" / LOG)["frames"] == [24, 48]
    policy_of_file(tmp_path / "broken" / POLICY)  # whoever stops has a policy, too
    again = resume(tmp_path / "broken", episodes=0)
    assert same_logs(out, tmp_path / "broken")
    assert same_logs(out, tmp_path / "broken", ("frames", "return", "survival", "fill"), EVALUATIONS)
    assert weights(again).equal(weights(policy))


SEVERAL = dataclasses.replace(TINY, collector="multi", workers=2, evaluate_every=0, checkpoint_every=24)


@pytest.fixture(scope="module")
def by_several(tmp_path_factory):
    """Folder of a run of two processes, and its policy."""
    out = tmp_path_factory.mktemp("several") / "whole"
    return out, train(SEVERAL, out, episodes=0)


def test_an_interrupted_run_of_several_processes_continues_as_the_uninterrupted_one(by_several, tmp_path):
    out, policy = by_several
    assert read_log(out / LOG)["frames"] == [24, 48, 72, 96]
    Interrupted(SEVERAL, tmp_path / "broken").run()
    assert not multiprocessing.active_children()
    assert weights(resume(tmp_path / "broken", episodes=0)).equal(weights(policy))


class Losing(Training):
    """Loses a process that collects while it learns from its third batch."""

    def lose(self):
        process = multiprocessing.active_children()[0]
        os.kill(process.pid, signal.SIGKILL)
        process.join()

    def _loop(self, batches, *others):
        self.collector = batches.collector
        super()._loop(batches, *others)

    def _learn(self, batch):
        if self.iteration == 2:
            self.lose()
        return super()._learn(batch)


@pytest.mark.parametrize("ahead", [False, True])
def test_a_killed_process_ends_a_run_that_can_be_resumed(tmp_path, ahead):
    config = dataclasses.replace(SEVERAL, ahead=ahead, workers=1)
    out = tmp_path / "run"
    names = "process 0 of 1 was ended by SIGKILL", "memory is full", f"bsk-torch train {out} --resume"
    check_refusals(refusal(lambda: Losing(config, out).run(), RuntimeError, *names))
    assert not multiprocessing.active_children()
    assert read_log(out / LOG)["frames"] == [24, 48, 72]
    assert read_checkpoint(out, config)["progress"][0] in (24, 48)


class Failing(Losing):
    """Code in a process that collects fails."""

    def lose(self):
        self.collector.pipes[0].send((None, "nonsense"))


def test_rejects_code_that_fails_in_a_process(tmp_path):
    out = tmp_path / "run"
    check_refusals(
        refusal(lambda: Failing(dataclasses.replace(SEVERAL, workers=1), out).run(), RuntimeError, "process", "experience", out)
    )


@pytest.mark.ray
def test_a_ray_cluster_collects_what_processes_of_this_machine_do(by_several, tmp_path):
    _, policy = by_several
    assert weights(Training(dataclasses.replace(SEVERAL, collector="ray"), tmp_path / "run").run()).equal(weights(policy))


class LosingActor(Losing):
    """Loses an actor of Ray."""

    def lose(self):
        importlib.import_module("ray").kill(self.collector.remote_collectors[0])


@pytest.mark.ray
def test_a_lost_actor_of_ray_ends_a_run_that_can_be_resumed(by_several, tmp_path):
    _, policy = by_several
    config, out = dataclasses.replace(SEVERAL, collector="ray"), tmp_path / "run"
    check_refusals(refusal(lambda: LosingActor(config, out).run(), RuntimeError, "died", f"bsk-torch train {out} --resume"))
    assert weights(resume(out, episodes=0)).equal(weights(policy))


def test_processes_share_out_the_episodes_of_one(tmp_path):
    whole = prepared(TINY.make_env(), TINY, None)
    parts = [start_worker(TINY, first, 2, None, PRESETS[TINY.preset]) for first in (0, 2)]
    action = torch.tensor([0, 1, 0, 1])
    expected = whole.step(whole.reset().set("action", action))["next"]
    found = [env.step(env.reset().set("action", some))["next"] for env, some in zip(parts, action.split(2), strict=True)]
    for key in ("observation", "reward", "truncated"):
        assert torch.cat([part[key] for part in found]).equal(expected[key])


def test_rejects_checkpoints_of_something_else(run, tmp_path):
    def resumed(**change):
        torch.save(saved | change, tmp_path / CHECKPOINT)
        resume(tmp_path, episodes=0)

    out, _ = run
    (tmp_path / CONFIG).write_text((out / CONFIG).read_text())
    saved = torch.load(out / CHECKPOINT, weights_only=True)
    check_refusals(
        refusal(lambda: resumed(preset="AEOS-v1"), ValueError, "preset", "'AEOS-v1'", "'NadirScan-v1'"),
        refusal(lambda: resumed(bsk_torch="0.0.1"), ValueError, "bsk_torch", "'0.0.1'", bsk_torch.__version__),
        refusal(lambda: resumed(num_envs=8), ValueError, "num_envs=8", 4),
    )


def test_training_stops_when_the_return_does_not_grow(tmp_path):
    config = dataclasses.replace(TINY, frames=2400, evaluate_every=24, patience=2, learning_rate=0.0)
    train(config, tmp_path / "stopped", episodes=0)
    assert len(read_log(tmp_path / "stopped" / EVALUATIONS)["return"]) == 3  # the first is the best, two do not beat it
    assert (tmp_path / "stopped" / CHECKPOINT).exists()


def test_evaluations_do_not_change_what_is_learned(run, tmp_path):
    out, _ = run
    train(dataclasses.replace(TINY, evaluate_every=0), tmp_path / "unseen", episodes=0)
    assert same_logs(out, tmp_path / "unseen")


def test_a_run_ends_when_it_is_enough_and_waits_without_time_or_chance(run, tmp_path):
    """What is asked draws random numbers and takes half a second, three times."""
    asked = []

    def enough():
        asked.append((training.progress.frames, training.progress.seconds, torch.rand(3)))
        time.sleep(0.5)
        return training.progress.frames >= 48

    training = Training(dataclasses.replace(TINY, evaluate_every=0), tmp_path / "run")
    begin = time.perf_counter()
    training.run(bar=False, enough=enough)
    took = time.perf_counter() - begin
    assert [frames for frames, *_ in asked] == [0, 24, 48]
    assert training.progress.seconds < took - 1.4
    columns = ("return", "entropy", "kl", "loss_critic")
    ours, whole = read_log(tmp_path / "run" / LOG), read_log(run[0] / LOG)
    for key in columns:
        torch.testing.assert_close(torch.tensor(ours[key]), torch.tensor(whole[key][:2]), rtol=0, atol=0, equal_nan=True)


def test_tensorboard_gets_what_the_files_get(tmp_path):
    events = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    train(dataclasses.replace(TINY, loggers=("csv", "tensorboard")), tmp_path / "run", episodes=0)
    folder = next(path for path in (tmp_path / "run").rglob("events*")).parent
    told = events.EventAccumulator(str(folder))
    told.Reload()
    assert [event.step for event in told.Scalars("training/entropy")] == [24, 48, 72, 96]
    values = [event.value for event in told.Scalars("evaluation/return")]
    assert values == pytest.approx(read_log(tmp_path / "run" / EVALUATIONS)["return"], rel=1e-5)


def test_missing_packages_are_named_before_anything_is_made(tmp_path, monkeypatch):
    monkeypatch.setattr("bsk_torch.rl.training.cluster.find_spec", lambda name: None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'bsk_torch\[ray\]'"):
        Training(dataclasses.replace(TINY, collector="ray"), tmp_path / "run")
    assert not (tmp_path / "run").exists()
    monkeypatch.setattr("bsk_torch.rl.training.log.find_spec", lambda name: None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'bsk_torch\[wandb\]'"):
        Training(dataclasses.replace(TINY, loggers=("csv", "wandb")), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_recent_episodes_skip_the_first_of_each_environment():
    recent = RecentEpisodes(2, penalty=-1.0)
    nothing = torch.zeros(2, 3, dtype=torch.bool)
    done, alive, reward = nothing.clone(), nothing.clone(), torch.ones(2, 3)
    done[0, 0] = done[0, 2] = alive[0, 0] = True
    reward[0, 2] = 0.5 - 1.0  # dies: collected 0.5 in that step
    recent.add(reward, done, alive, torch.tensor([[0.1, 0.2, 0.3]] * 2))
    assert recent.count == 2
    means = recent.means()
    assert means == pytest.approx({"return": 0.5, "survival": 0.0, "collected": 1.5, "fill": 0.3, "decisions": 2.0})


def test_staggered_first_episodes_end_early_and_only_those(tmp_path):
    config = dataclasses.replace(TINY, num_envs=8, rollout=40)
    training = Training(config, tmp_path / "run")
    collector = make_collector(config, training.env, training.actor, None)
    batch = next(iter(collector))
    collector.shutdown()
    cut = batch["next", "done"] & ~batch["next", "terminated"]  # a time limit terminates in this preset
    elapsed = torch.zeros(8)
    seen = []
    for step in range(40):
        elapsed = elapsed + batch["next", "duration"][:, step, 0]
        ends = batch["next", "done"][:, step, 0]
        seen += [(row, float(elapsed[row]), bool(cut[row, step])) for row in torch.nonzero(ends).squeeze(-1).tolist()]
        elapsed = elapsed.masked_fill(ends, 0.0)
    firsts = {row: (seconds, was_cut) for row, seconds, was_cut in reversed(seen)}
    assert sum(was_cut for _, was_cut in firsts.values()) >= 6  # the others reach their limit within their last step
    assert len({seconds for seconds, _ in firsts.values()}) > 3
    assert sum(was_cut for _, _, was_cut in seen) == sum(was_cut for _, was_cut in firsts.values())
