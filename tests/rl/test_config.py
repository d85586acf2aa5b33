"""Settings from recipes, files and command lines."""

from itertools import pairwise

import pytest
from omegaconf import OmegaConf

from bsk_torch import scene
from bsk_torch.rl.marl.mappo import MAPPOConfig
from bsk_torch.rl.marl.runs import read_config
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


def test_files_give_back_what_was_saved(tmp_path):
    config = MAPPOConfig(algorithm="ippo", hidden=(32,), options={"n_targets": (10, 20), "as_set": True})
    save_config(config, tmp_path / "config.yaml")
    read = load_config(tmp_path / "config.yaml", MAPPOConfig)
    assert read.options == {"n_targets": [10, 20], "as_set": True}
    assert (read.algorithm, read.hidden) == ("ippo", (32,))
    with pytest.raises(ValueError, match="'algorithm' not in 'PPOConfig'"):
        load_config(tmp_path / "config.yaml", PPOConfig)


def test_objects_are_noted_and_logs_are_not_kept(tmp_path):
    save_config(PPOConfig(options={"scenario": scene.Wildfires(50)}), tmp_path / "config.yaml")
    assert "Wildfires" in load_config(tmp_path / "config.yaml", PPOConfig).options["scenario"]
    save_config(PPOConfig(options={"log_dir": "x", "as_set": True}), tmp_path / "config.yaml")
    assert load_config(tmp_path / "config.yaml", PPOConfig).options == {"as_set": True}


@pytest.mark.parametrize("name", SCHEDULES)
def test_schedules_begin_in_full_and_never_rise(name):
    left = [SCHEDULES[name](k / 20) for k in range(21)]
    assert left[0] == pytest.approx(1.0)
    assert all(later <= earlier for earlier, later in pairwise(left))
    assert left[-1] == pytest.approx(1.0 if name == "constant" else 0.05)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hidden: [1\n", "is no configuration: while parsing"),
        ("- 1\n", "holds no settings by name"),
        ("\x00\x01", "is no configuration"),
        ("a: &a [1]\nb: *a\n", "has aliases of YAML"),
        (
            "a: !!python/object/apply:os.getcwd []\n",
            "is no configuration: it has the tag 'tag:yaml.org,2002:python/object/apply:os.getcwd'",
        ),
        ("preset: ${oc.env:HOME}\n", r"preset='\$\{oc.env:HOME\}' would be replaced"),
        ("options:\n  a:\n  - b: x${oc.env:HOME}\n", r"options.a.b='x\$\{oc.env:HOME\}' would be replaced"),
        ("preset: ${network}\n", "would be replaced"),
        ("options:\n  log_dir: /tmp/x\n", "options.log_dir is not read from files"),
        ("preset: ???\n", "would be replaced"),
        ("frames: 0\n", "is no configuration: frames=0"),
        ("hiden: [1]\n", "'hiden' not in 'PPOConfig'"),
        ("options: 5\n", "is no configuration of this version"),
        ("4", "holds no settings by name"),
        ("a: " + "[" * 5000, "nested more than 20 levels"),
        pytest.param("#" * 2_000_000, "more than 1,000,000 bytes", id="long"),
        pytest.param(f"hidden: [{'8,' * 10_000}8]", "more than 10,000 values", id="many"),
        (f"hidden: [{'8,' * 64}8]", "65 layers; at most 64"),
        *((f"a: !!{tag}\n", f"tag 'tag:yaml.org,2002:{tag}'") for tag in ("int", "bool", "timestamp", "float", "omap")),
    ],
)
def test_files_of_others_are_refused(tmp_path, text, message):
    (tmp_path / "config.yaml").write_text(text)
    for read in (lambda: load_config(tmp_path / "config.yaml", PPOConfig), lambda: read_config(tmp_path)):
        with pytest.raises(ValueError, match=message) as caught:
            read()
        assert "config.yaml" in str(caught.value)


def test_no_resolver_runs(tmp_path):
    calls = []
    OmegaConf.register_new_resolver("bsk_torch_test", lambda: calls.append(1), replace=True)
    (tmp_path / "config.yaml").write_text("seconds: 5\noptions:\n  time_limit: ${bsk_torch_test:}\n")
    with pytest.raises(ValueError, match="would be replaced"):
        read_config(tmp_path)
    assert not calls


@pytest.mark.parametrize(
    "changes",
    [
        ["learning_rate=${oc.env:BSK_TORCH_RATE}"],
        ["hidden=[${bsk_torch_test:},64]"],
        ["options.time_limit=${bsk_torch_test:}"],
        ["options.a=${bsk_torch_test:}", "options.a.b=1"],
        ["seed=${frames}"],
        ["frames=???"],
    ],
)
def test_changes_are_literal_values(changes, monkeypatch):
    calls = []
    OmegaConf.register_new_resolver("bsk_torch_test", lambda: calls.append(1) or 64, replace=True)
    monkeypatch.setenv("BSK_TORCH_RATE", "0.001")
    with pytest.raises(ValueError, match="would be replaced; settings are literal values: numbers, true, false, null, text"):
        override(PPOConfig(), changes)
    assert not calls


def test_patience_needs_evaluations():
    with pytest.raises(ValueError, match="patience=3 needs evaluate_every"):
        PPOConfig(patience=3, evaluate_every=0)
    assert PPOConfig(patience=3).evaluate_every
