"""``bsk-torch dataset``."""

import pytest

from bsk_torch.lab.offline import open_dataset

pytestmark = pytest.mark.compiled

SHORT = ["--time-limit", "600", "--seeds", "0:2"]


def test_behaviors_are_written_and_described(run, tmp_path):
    pytest.importorskip("minari")
    folder = tmp_path / "scan"
    result = run("dataset", "NadirScan-v1", "--out", folder, *SHORT, "--share", 0.2, "--minari")
    assert result.exit_code == 0, result.output
    assert "NadirScan-v1; targets: pretrained" in result.output
    assert "bsk_torch/NadirScan-v1/rule-v0" in result.output
    data = open_dataset(folder)
    assert data.behaviors == ["random", "rule", "pretrained"]
    assert data.card["options"] == {"time_limit": 600.0}
    assert data.starts()["action_value", "pretrained"].shape == (2,)


def test_planners_mixtures_and_targets_of_another_name(run, tmp_path):
    folder = tmp_path / "scan"
    acting = ["--behavior", "plan:rollout,random=0.5,base=rule,horizon=300", "--behavior", "rule,random=0.2"]
    result = run("dataset", "NadirScan-v1", "--out", folder, *SHORT, *acting, "--target", "rule", "--share", 0.2)
    assert result.exit_code == 0, result.output
    data = open_dataset(folder)
    assert data.card["targets"] == ["rule"]
    assert data.card["behaviors"]["rule,random=0.2"]["random"] == 0.2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("NadirScan-v2",), "did you mean 'NadirScan-v1'"),
        (("NadirScan-v1", "--behavior", "ruel"), "did you mean 'rule'"),
        (("NadirScan-v1", "--behavior", "plan:rolout"), "did you mean 'plan:rollout'"),
        (("NadirScan-v1", "--behavior", "rule,randm=0.2"), "'randm=0.2' is not an option of a policy"),
        (("NadirScan-v1", "--behavior", "rule,random=x"), "'random=x' must be a probability"),
        (("NadirScan-v1", "--behavior", "rule,random=2"), "random=2"),
        (("NadirScan-v1", "--behavior", "random,random=1"), "random actions have no options"),
        (("NadirScan-v1", "--target", "pretraind"), "did you mean 'pretrained'"),
        (("NadirScan-v1", "--target", "random"), "draws its actions"),
        (("NadirScan-v1", "--gamma", "0"), "gamma=0"),
        (("NadirScan-v1", "--seeds", "5:5"), "names no episode"),
        (("CWDocking-v1", "--backend", "eager"), "are real numbers"),
        (("HeteroCluster-v1",), "has several agents"),
    ],
)
def test_wrong_arguments_are_named_before_anything_is_written(run, tmp_path, arguments, message):
    result = run("dataset", *arguments, "--out", tmp_path / "d")
    assert result.exit_code == 1, result.output
    assert message in " ".join(result.output.split())
    assert not list(tmp_path.iterdir())


def test_a_folder_that_exists_is_kept(run, tmp_path):
    result = run("dataset", "NadirScan-v1", "--out", tmp_path)
    assert result.exit_code == 1
    assert "exists; a dataset is written into a new folder" in result.output
