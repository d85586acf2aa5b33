"""Constellations on the command line, from training to the report."""

import json

import pytest

import bsk_torch
from bsk_torch.rl.evaluation.evaluate import evaluate
from bsk_torch.rl.marl import MAPPOConfig, read_config
from bsk_torch.rl.policies import policy_of_file, read_card
from bsk_torch.rl.policies.shared_policy import shared
from bsk_torch.rl.training.log import read_log
from tests.support.blocks import ROOT
from tests.support.programs import run_script

pytestmark = pytest.mark.compiled

SMALL = ("options.n_satellites=3", "options.n_planes=1", "options.phasing=0", "options.n_targets=300")
CREW = ("options.n_imagers=2", "options.n_relays=1", "options.n_targets=200", "--time-limit", "100")
SHORT = ("--time-limit", "400", "--episodes", "2", "num_envs=2", "rollout=8")
RULES = ["random", "greedy", "nearest", "hasty", "farsighted"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """An empty folder for the tests of this module, which build upon each other's results."""
    return tmp_path_factory.mktemp("runs") / "ippo"


@pytest.fixture
def trained(run, folder):
    """Folder of a run, which is trained once."""
    if not folder.exists():
        result = run("train", "Constellation-v1", "--algorithm", "ippo", "--frames", 32, *SMALL, *SHORT, "--out", folder)
        assert result.exit_code == 0, result.output
    return folder


def test_training_compares_with_the_rules_and_draws(trained):
    names = {"checkpoint.pt", "config.yaml", "evaluation.json", "evaluations.csv", "log.csv", "policy.pt"}
    assert {path.name for path in trained.iterdir()} >= names | {"learning_curve.png", "constellation.png"}
    kept = json.loads((trained / "evaluation.json").read_text())
    assert list(kept) == [*RULES, "untrained", "trained"]
    assert kept["nearest"]["counts"]["imaged"] > 0.0
    config = read_config(trained)
    assert isinstance(config, MAPPOConfig)
    assert (config.algorithm, config.options["as_set"], config.options["n_satellites"]) == ("ippo", True, 3)
    assert policy_of_file(trained).in_keys


def test_policies_are_evaluated_and_shielded(run, trained, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend("")
    (tmp_path / "first_target.py").write_text(
        "from bsk_torch.act import allow_only\n\n\n"
        "def rule(see, actions):\n"
        "    return allow_only(actions, actions[0], where=see.observation['time'] >= 0.0)\n"
    )
    out = ("--out", "e.json", "--episodes-out", "e.csv")
    result = run("eval", trained, "--seeds", "0:3", "--time-limit", "400", "--shield", "first_target:rule", *out)
    assert result.exit_code == 0, result.output
    kept = json.loads((tmp_path / "e.json").read_text())
    assert list(kept) == ["trained + first_target:rule", "trained", *RULES]
    assert set(kept["trained + first_target:rule"]["gain"]) == {"trained", *RULES}
    assert len((tmp_path / "e.csv").read_text().splitlines()) == 1 + 3 * 7


def test_the_report_shows_all_satellites(run, trained):
    result = run("report", trained, "--episodes", 3)
    assert result.exit_code == 0, result.output
    page = (trained / "report.html").read_text()
    assert "images by 3 satellites" in page or "image by 3 satellites" in page
    assert "Episodes in the viewer" in page
    assert len(page) < 5e6
    assert "bsk-torch train Constellation-v1 --algorithm ippo --network attention --frames" in page


def test_what_was_learned_by_few_is_published_for_all(trained, tmp_path):
    script, drop = ROOT / "scripts/tools/publish_policy.py", ("--drop", "n_satellites", "--drop", "n_planes")
    done = run_script(script, str(trained), "--episodes", "4", "--folder", ".", *drop, folder=tmp_path, environment={})
    assert "Constellation-v1: " in done.stdout, done.stderr
    kept, card = read_card(trained), read_card(tmp_path / "Constellation-v1.pt")
    dropped = {"n_satellites": 3, "n_planes": 1}
    assert card["options"] | dropped == kept["options"]
    assert not card["options"].keys() & dropped.keys()
    env = bsk_torch.make("Constellation-v1", num_envs=4, **card["options"])
    assert env.fleet.size == 12
    noted = json.loads((tmp_path / "policies.json").read_text())["Constellation-v1"]
    assert noted["command"].startswith("bsk-torch train Constellation-v1 --algorithm ippo")
    assert "options.n_satellites=3" in noted["command"]
    assert (noted["score"]["episodes"], noted["score"]["seed"]) == (4, 1_000_003)
    result = evaluate(shared(policy_of_file(tmp_path / "Constellation-v1.pt"), env), env, seed=1_000_003)
    assert result.returns.tolist() == pytest.approx(noted["first"])
    assert sum(noted["first"]) / 4 == pytest.approx(noted["score"]["return"])


def test_a_run_goes_on(run, trained):
    before = read_log(trained / "log.csv")["frames"][-1]
    again = run("train", trained, "--resume", f"frames={int(before) + 16}", "--episodes", 2)
    assert again.exit_code == 0, again.output
    assert read_log(trained / "log.csv")["frames"][-1] == before + 16


@pytest.fixture
def crew(run, folder):
    """Folder of a run with satellites of two types, which is trained once."""
    place = folder.with_name("crew")
    if not place.exists():
        result = run("train", "RelayConstellation-v1", "--algorithm", "mappo", "--frames", 16, *SHORT, *CREW, "--out", place)
        assert result.exit_code == 0, result.output
    return place


def test_satellites_of_several_types_are_trained_together(crew):
    assert (crew / "constellation.png").is_file()
    assert list(json.loads((crew / "evaluation.json").read_text())) == [*RULES, "untrained", "trained"]
    assert list(read_card(crew)["groups"]) == ["broadcasting_set_imager", "relay"]


def test_satellites_of_several_types_are_evaluated_and_shielded(run, crew, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend("")
    (tmp_path / "no_charging.py").write_text(
        "import torch\n\n\n"
        "def rule(see, actions):\n"
        "    time = see.observation[..., -1] if isinstance(see.observation, torch.Tensor) else see.observation['time']\n"
        "    return torch.tensor([name != 'action_charge' for name in actions]).expand(*time.shape, -1)\n"
    )
    result = run("eval", crew, "--seeds", "0:2", "--time-limit", "100", "--shield", "no_charging:rule", "--out", "e.json")
    assert result.exit_code == 0, result.output
    assert list(json.loads((tmp_path / "e.json").read_text())) == ["trained + no_charging:rule", "trained", *RULES]


@pytest.mark.nightly
def test_the_report_shows_satellites_of_several_types(run, crew):
    result = run("report", crew, "--episodes", 2)
    assert result.exit_code == 0, result.output
    page = (crew / "report.html").read_text()
    assert "by 3 satellites" in page
    assert "bsk-torch train RelayConstellation-v1 --algorithm mappo --network attention --frames 16" in page


def test_failures_of_several_satellites_are_not_explained(run, crew):
    result = run("explain", crew, "--seeds", "0:2", "--num-envs", 1)
    assert result.exit_code == 1
    assert "RelayConstellation-v1 has many satellites; failures are explained of one" in result.output


@pytest.mark.nightly
def test_a_run_with_several_types_goes_on(run, crew):
    again = run("train", crew, "--resume", "frames=32", "--episodes", 2)
    assert again.exit_code == 0, again.output
    assert read_log(crew / "log.csv")["frames"][-1] == 32
