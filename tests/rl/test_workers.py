"""How many processes collect, and Ray clusters that cannot be reached."""

import dataclasses
import logging
import os
import socket
import time

import pytest

from bsk_torch.rl.training import PPOConfig
from bsk_torch.rl.training.cluster import PATIENCE, check_ray, share_of_core
from bsk_torch.rl.training.trainer import Training
from bsk_torch.rl.training.workers import Cores, available_cores, warn_of_few_cores, with_workers

AUTO = PPOConfig(workers="auto")


def chosen(monkeypatch, cores, **changes):
    monkeypatch.setattr("bsk_torch.rl.training.workers.available_cores", lambda: Cores(cores, f"{cores} available cores"))
    config = with_workers(dataclasses.replace(AUTO, **changes))
    return config.collector, config.processes


@pytest.mark.parametrize(
    ("cores", "changes", "expected"),
    [
        (1, {}, ("single", 1)),
        (1, {"collector": "multi"}, ("multi", 1)),
        (1, {"ahead": True}, ("multi", 1)),
        (2, {}, ("multi", 2)),
        (2, {"ahead": True}, ("multi", 1)),  # the learner has the other core
        (5, {}, ("multi", 4)),  # 1,024 episodes are shared out evenly
        (100, {}, ("multi", 32)),  # of at least 32 episodes each
        (100, {"num_envs": 20}, ("single", 1)),
        (7, {"num_envs": 7 * 32, "ahead": True}, ("multi", 4)),
    ],
)
def test_processes_suit_cores_and_episodes(monkeypatch, caplog, cores, changes, expected):
    caplog.set_level(logging.INFO, "bsk_torch")
    assert chosen(monkeypatch, cores, **changes) == expected
    collector, workers = expected
    assert f"workers=auto: collector={collector} workers={workers}, for {cores} available cores" in caplog.text


def test_processes_are_as_many_as_cores(monkeypatch, caplog):
    monkeypatch.setattr("bsk_torch.rl.training.workers.available_cores", lambda: Cores(6, "6 available cores"))
    warn_of_few_cores(PPOConfig(collector="multi", workers=4))
    assert not caplog.records
    warn_of_few_cores(PPOConfig(collector="multi", workers=8))
    assert "workers=8 is more than 6 available cores: the processes share them; workers=4 is as fast" in caplog.text
    assert 1 <= available_cores().number <= (os.cpu_count() or 1)
    config = PPOConfig(collector="multi", workers=4)
    assert with_workers(config) is config
    with pytest.raises(ValueError, match="workers='auto' has no number yet"):
        AUTO.processes  # noqa: B018  - raises


@pytest.mark.parametrize(("workers", "cores", "share"), [(2, [1, 1], 1.0), (2, [1], 0.5), (16, [4, 1], 0.25), (3, [0, 0], 0.0)])
def test_all_processes_fit_on_a_cluster(workers, cores, share):
    assert share_of_core(workers, cores) == share
    assert not share or sum(int(count / share) for count in cores) >= workers


def closed_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


@pytest.mark.parametrize("form", ["127.0.0.1:{}", "ray://127.0.0.1:{}"])
def test_a_cluster_that_does_not_answer_is_named_before_anything_is_made(tmp_path, monkeypatch, form):
    monkeypatch.setattr("bsk_torch.rl.training.cluster.find_spec", lambda name: object())
    address = form.format(closed_port())
    monkeypatch.setenv("RAY_ADDRESS", address)
    begin = time.monotonic()
    with pytest.raises(ConnectionError, match=f"RAY_ADDRESS={address} does not answer .* 'ray start --head --port=6379'"):
        Training(PPOConfig(collector="ray"), tmp_path / "run")
    assert time.monotonic() - begin < PATIENCE
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("address", "expected"), [("head", ("head", 6379)), ("head:7000", ("head", 7000)), ("ray://head:10001", ("head", 10001))]
)
def test_addresses_are_read_as_ray_reads_them_and_waited_for_a_bounded_time(monkeypatch, address, expected):
    monkeypatch.setattr("bsk_torch.rl.training.cluster.find_spec", lambda name: object())
    monkeypatch.setenv("RAY_ADDRESS", address)

    def silent(found, timeout):
        assert (found, timeout) == (expected, PATIENCE)
        raise TimeoutError("timed out")

    monkeypatch.setattr(socket, "create_connection", silent)
    with pytest.raises(ConnectionError, match=r"does not answer \(timed out\)"):
        check_ray()
