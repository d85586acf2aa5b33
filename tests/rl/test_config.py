"""Settings from recipes, files and command lines."""

from itertools import pairwise

import pytest

from bsk_torch import scene
from bsk_torch.rl.marl.mappo import MAPPOConfig
from bsk_torch.rl.training.config import SCHEDULES, PPOConfig, load_config, override, save_config


def test_changes_are_read_in_their_types():
    changes = [
        "hidden=[32,16]",
        "seconds=null",
        "frames=1000",
        "learning_rate=1e-4",
        "loggers=[csv,tensorboard]",
        "options.time_limit=9",
    ]
    config = override(PPOConfig(options={"as_set": True}), changes)
    assert (config.hidden, config.seconds, config.frames, config.learning_rate) == ((32, 16), None, 1000, 1e-4)
    assert config.loggers == ("csv", "tensorboard")
    assert config.options == {"as_set": True, "time_limit": 9}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("learning_rat=1", "did you mean 'learning_rate'"),
        ("learning_rate", "must read name=value"),
        ("frames=many", "could not be converted to Integer"),
        ("hidden=[wide]", "could not be converted to Integer"),
        ("gamma=1.5", r"must lie in \(0, 1\]"),
        ("network=mpl", "did you mean 'mlp'"),
        ("reward_time=ende", "did you mean 'end'"),
        ("entropy_schedule=lienar", "did you mean 'linear'"),
        ("loggers=[cvs]", "did you mean 'csv'"),
        ("collector=mutli", "did you mean 'multi'"),
        ("epochs=0", "at least 1"),
        ("checkpoint_every=-1", "not be negative"),
        ("patience=3", "needs evaluate_every"),
    ],
)
def test_what_cannot_be_is_named(change, message):
    with pytest.raises(ValueError, match=message):
        override(PPOConfig(), [change])


def test_episodes_are_shared_out_evenly():
    with pytest.raises(ValueError, match="evenly"):
        PPOConfig(collector="multi", workers=3, num_envs=16)


def test_files_give_back_what_was_saved(tmp_path):
    config = MAPPOConfig(algorithm="ippo", hidden=(32,), options={"n_targets": (10, 20), "as_set": True})
    save_config(config, tmp_path / "config.yaml")
    read = load_config(tmp_path / "config.yaml", MAPPOConfig)
    assert read.options == {"n_targets": [10, 20], "as_set": True}
    assert (read.algorithm, read.hidden) == ("ippo", (32,))
    with pytest.raises(ValueError, match="'algorithm' not in 'PPOConfig'"):
        load_config(tmp_path / "config.yaml", PPOConfig)


def test_objects_are_noted(tmp_path):
    save_config(PPOConfig(options={"scenario": scene.Wildfires(50)}), tmp_path / "config.yaml")
    assert "Wildfires" in load_config(tmp_path / "config.yaml", PPOConfig).options["scenario"]


@pytest.mark.parametrize("name", SCHEDULES)
def test_schedules_begin_in_full_and_never_rise(name):
    left = [SCHEDULES[name](k / 20) for k in range(21)]
    assert left[0] == pytest.approx(1.0)
    assert all(later <= earlier for earlier, later in pairwise(left))
    assert left[-1] == pytest.approx(1.0 if name == "constant" else 0.05)
