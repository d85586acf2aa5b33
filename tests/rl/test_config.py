"""Settings from recipes, files and command lines."""

from itertools import pairwise

import pytest
from omegaconf import OmegaConf

from bsk_torch import scene
from bsk_torch.rl.marl.mappo import MAPPOConfig
from bsk_torch.rl.marl.runs import read_config
from bsk_torch.rl.training.config import SCHEDULES, PPOConfig, load_config, override, save_config
from tests.support.refusals import check_refusals, refusal


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
    assert (config.loggers, config.options) == (("csv", "tensorboard"), {"as_set": True, "time_limit": 9})


def test_files_give_back_what_was_saved(tmp_path):
    config = MAPPOConfig(algorithm="ippo", hidden=(32,), options={"n_targets": (10, 20), "as_set": True})
    save_config(config, tmp_path / "config.yaml")
    read = load_config(tmp_path / "config.yaml", MAPPOConfig)
    assert read.options == {"n_targets": [10, 20], "as_set": True}
    assert (read.algorithm, read.hidden) == ("ippo", (32,))
    check_refusals(refusal(lambda: load_config(tmp_path / "config.yaml", PPOConfig), ValueError, "'algorithm'", "'PPOConfig'"))


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


def test_rejects_files_of_others(tmp_path):
    def load(text, read):
        (tmp_path / "config.yaml").write_text(text)
        read()

    wrong = [
        ("hidden: [1\n", "line 2"),
        ("- 1\n", "settings by name"),
        ("\x00\x01", "configuration"),
        ("a: &a [1]\nb: *a\n", "aliases"),
        ("a: !!python/object/apply:os.getcwd []\n", "'tag:yaml.org,2002:python/object/apply:os.getcwd'"),
        ("preset: ${oc.env:HOME}\n", "preset='${oc.env:HOME}'"),
        ("options:\n  a:\n  - b: x${oc.env:HOME}\n", "options.a.b='x${oc.env:HOME}'"),
        ("preset: ${network}\n", "replaced"),
        ("options:\n  log_dir: /tmp/x\n", "options.log_dir"),
        ("preset: ???\n", "replaced"),
        ("frames: 0\n", "frames=0"),
        ("hiden: [1]\n", "'hiden'", "'PPOConfig'"),
        ("options: 5\n", "version"),
        ("4", "settings by name"),
        ("a: " + "[" * 5000, "20 levels"),
        ("#" * 2_000_000, "1,000,000 bytes"),
        (f"hidden: [{'8,' * 10_000}8]", "10,000 values"),
        (f"hidden: [{'8,' * 64}8]", "65 layers", "64"),
        *((f"a: !!{tag}\n", f"'tag:yaml.org,2002:{tag}'") for tag in ("int", "bool", "timestamp", "float", "omap")),
    ]
    readers = (lambda: load_config(tmp_path / "config.yaml", PPOConfig), lambda: read_config(tmp_path))
    check_refusals(
        refusal(lambda text=text, read=read: load(text, read), ValueError, "config.yaml", *names)
        for text, *names in wrong
        for read in readers
    )


def test_no_resolver_runs(tmp_path):
    calls = []
    OmegaConf.register_new_resolver("bsk_torch_test", lambda: calls.append(1), replace=True)
    (tmp_path / "config.yaml").write_text("seconds: 5\noptions:\n  time_limit: ${bsk_torch_test:}\n")
    check_refusals(refusal(lambda: read_config(tmp_path), ValueError, "replaced"))
    assert not calls


def test_changes_are_literal_values(monkeypatch):
    calls = []
    OmegaConf.register_new_resolver("bsk_torch_test", lambda: calls.append(1) or 64, replace=True)
    monkeypatch.setenv("BSK_TORCH_RATE", "0.001")
    wrong = [
        ["learning_rate=${oc.env:BSK_TORCH_RATE}"],
        ["hidden=[${bsk_torch_test:},64]"],
        ["options.time_limit=${bsk_torch_test:}"],
        ["options.a=${bsk_torch_test:}", "options.a.b=1"],
        ["seed=${frames}"],
        ["frames=???"],
    ]
    names = "literal", "numbers", "true", "false", "null", "text"
    check_refusals(refusal(lambda changes=changes: override(PPOConfig(), changes), ValueError, *names) for changes in wrong)
    assert not calls


def test_patience_needs_evaluations():
    check_refusals(refusal(lambda: PPOConfig(patience=3, evaluate_every=0), ValueError, "patience=3", "evaluate_every"))
    assert PPOConfig(patience=3).evaluate_every
