"""What a training in Python ends with."""

import json

import pytest

import bsk_torch
from bsk_torch.data import ScanningTimeReward
from bsk_torch.rl.evaluation import FRESH, evaluate
from bsk_torch.rl.marl.runs import told, training_of
from bsk_torch.rl.training import configure, resume, train

pytestmark = pytest.mark.compiled

OPTIONS = {"time_limit": 300.0}
SIZES = dict(frames=32, seconds=None, num_envs=4, rollout=4, hidden=(8,), evaluate_episodes=2, seed=3)


def settings(**changes):
    return configure("NadirScan-v1", **(SIZES | {"options": OPTIONS} | changes))


def test_a_training_ends_with_table_folder_and_next_command(tmp_path, capsys):
    out = tmp_path / "my run"
    policy = train(settings(), out, episodes=4)
    shown = capsys.readouterr().out
    assert "NadirScan-v1, 4 unseen episodes" in shown
    names = ("random", "rule", "cautious", "untrained", "trained")
    rows = [line.split()[0] for line in shown.splitlines() if line.split() and line.split()[0] in names]
    assert rows == list(names)
    assert f"results: {out}\nnext: bsk-torch report '{out}'\n" in shown
    kept = json.loads((out / "evaluation.json").read_text())
    assert set(kept) == set(names)
    assert set(kept["trained"]["gain"]) == {"random", "rule", "cautious", "untrained"}
    again = evaluate(policy, bsk_torch.make("NadirScan-v1", num_envs=4, **OPTIONS), seed=3 + FRESH)
    assert kept["trained"]["return"]["mean"] == pytest.approx(again.mean_return.mean)


def test_a_quiet_training_writes_the_table_and_shows_nothing(tmp_path, capsys):
    train(settings(), tmp_path / "run", episodes=2, quiet=True)
    shown = capsys.readouterr()
    assert (shown.out, shown.err) == ("", "")
    assert (tmp_path / "run" / "evaluation.json").is_file()


def test_no_comparison_where_none_is_wanted(tmp_path, capsys):
    train(settings(), tmp_path / "run", episodes=0)
    assert capsys.readouterr().out == ""
    assert not (tmp_path / "run" / "evaluation.json").exists()
    with pytest.raises(ValueError, match="episodes=-1 must be at least 0"):
        train(settings(), tmp_path / "other", episodes=-1)
    assert not (tmp_path / "other").exists()


def test_a_resumed_training_is_compared_without_the_untrained_policy(tmp_path, capsys):
    out = tmp_path / "run"
    train(settings(), out, episodes=0)
    resume(out, episodes=2)
    assert "untrained" not in capsys.readouterr().out
    assert set(json.loads((out / "evaluation.json").read_text())) == {"random", "rule", "cautious", "trained"}


def test_an_interrupted_training_says_how_to_resume(tmp_path):
    run = training_of(settings(), tmp_path / "run")
    assert told(run, {}).endswith(f"next: bsk-torch report {tmp_path / 'run'}")
    run.interrupted = True
    assert told(run, {}).endswith(f"next: bsk-torch train {tmp_path / 'run'} --resume, or bsk-torch report {tmp_path / 'run'}")


def test_policies_that_only_a_program_can_build_are_loaded_there(tmp_path, capsys):
    out = tmp_path / "run"
    train(settings(options=OPTIONS | {"rewarder": ScanningTimeReward()}), out, episodes=2)
    assert f"next: bsk_torch.load_policy({str(out)!r}, env)\n" in capsys.readouterr().out
