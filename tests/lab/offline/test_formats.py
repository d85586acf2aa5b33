"""Datasets in the formats of Minari and Croissant, read by their own libraries."""

import csv
import hashlib
import json
import logging
import sys

import numpy as np
import pytest
import torch
from torchrl.data.datasets.minari_data import MinariExperienceReplay

from bsk_torch.lab.offline import write_dataset
from bsk_torch.lab.offline.minari_format import check_minari
from tests.lab.offline.conftest import LIMIT, recipe
from tests.lab.planners.conftest import scanning

minari = pytest.importorskip("minari")

pytestmark = pytest.mark.compiled

NAME = "bsk_torch/NadirScan-v1/pretrained-random-0-4-v0"


@pytest.fixture
def root(written, monkeypatch):
    """Minari's root folder is that of the dataset."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(written.folder / "minari"))
    return written.folder / "minari"


def test_minari_reads_the_episodes_and_gymnasium_repeats_them(written, root):
    found = minari.load_dataset(NAME)
    rows = written.transitions("pretrained,random=0.4")
    assert found.total_steps == len(rows)
    assert found.total_episodes == 3
    env = found.recover_environment()
    assert env.spec.kwargs["time_limit"] == LIMIT
    for episode, metadata in zip(found, found.storage.get_episode_metadata(range(3)), strict=True):
        mine = rows[rows["episode"] == episode.id]
        np.testing.assert_array_equal(episode.observations[:-1], mine["observation"].numpy())
        np.testing.assert_array_equal(episode.infos["action_log_prob"][1:], mine["action_log_prob"].numpy())
        observation, info = env.reset(seed=metadata["seed"])
        np.testing.assert_array_equal(observation, episode.observations[0])
        for k, action in enumerate(episode.actions):
            observation, reward, terminated, truncated, info = env.step(action)
            np.testing.assert_array_equal(observation, episode.observations[k + 1])
            np.testing.assert_array_equal(info["action_mask"], episode.infos["action_mask"][k + 1])
            assert info["duration"] == episode.infos["duration"][k + 1]
            assert (np.float32(reward), terminated, truncated) == (
                episode.rewards[k],
                episode.terminations[k],
                episode.truncations[k],
            )


@pytest.mark.xfail(reason="TorchRL 0.14.1 allocates memory for a local dataset of Minari, and copies nothing", strict=True)
def test_torchrl_reads_what_minari_has_written(written, root, tmp_path):
    buffer = MinariExperienceReplay(NAME, batch_size=4, root=tmp_path, load_from_local_minari=True)
    rows = written.transitions("pretrained,random=0.4")
    assert len(buffer) == len(rows)
    assert torch.equal(buffer[:]["observation"], rows["observation"])
    assert torch.equal(buffer[:]["next", "reward"], rows["next", "reward"])


def test_a_version_of_minari_that_reads_something_else_is_found_before_episodes_are_played(tmp_path, monkeypatch):
    env = scanning(1, LIMIT)
    load = minari.load_dataset

    def shifted(name):
        for episode in load(name):
            episode.rewards[0] += 1.0
            yield episode

    monkeypatch.setattr(minari, "load_dataset", shifted)
    with pytest.raises(ImportError, match=r"Minari [\d.]+ does not read what it writes; pip install"):
        write_dataset(tmp_path / "d", env, recipe(env, minari=True))

    def broken(name):
        raise KeyError("data_format")

    monkeypatch.setattr(minari, "load_dataset", broken)
    with pytest.raises(ImportError, match=r"cannot write and read a dataset \('data_format'\)"):
        check_minari()
    monkeypatch.setitem(sys.modules, "minari", None)
    with pytest.raises(ImportError, match=r"pip install 'bsk_torch\[minari\]'"):
        check_minari()
    assert not list(tmp_path.iterdir())


def test_mlcroissant_validates_the_metadata_and_reads_the_table(written, caplog):
    mlcroissant = pytest.importorskip("mlcroissant")
    path = written.folder / "croissant.json"
    with caplog.at_level(logging.WARNING):
        found = mlcroissant.Dataset(str(path))
    assert not found.metadata.ctx.issues.errors
    told = [line for line in found.metadata.ctx.issues.warnings if "is recommended" not in line]
    assert not told
    assert "not standard" not in caplog.text
    records = list(found.records("episodes"))
    with open(written.folder / "episodes.csv") as file:
        rows = list(csv.DictReader(file))
    assert len(records) == len(rows) == 9
    assert [record["episodes/return"] for record in records] == [float(row["return"]) for row in rows]
    assert [record["episodes/seed"] for record in records] == [11, 12, 13] * 3


def test_every_file_is_listed_with_its_checksum(written):
    listed = {
        part["contentUrl"]: part["sha256"] for part in json.loads((written.folder / "croissant.json").read_text())["distribution"]
    }
    files = {path.relative_to(written.folder).as_posix() for path in written.folder.rglob("*") if path.is_file()}
    assert set(listed) == files - {"croissant.json"}
    for name, digest in listed.items():
        assert hashlib.sha256((written.folder / name).read_bytes()).hexdigest() == digest
