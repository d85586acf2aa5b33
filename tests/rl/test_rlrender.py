"""TorchRL's rlrender films policy files by the factories of this package."""

import json

import pytest
from PIL import Image
from torchrl.render.cli import main

from bsk_torch.rl.policies.pretrained import pretrained_file

FACTORIES = "bsk_torch.rl.policies.rlrender"


def film(preset, out, **options):
    kwargs = json.dumps({"time_limit": 600.0, **options})
    names = ("--env", f"{FACTORIES}:make_env", "--policy", f"{FACTORIES}:make_policy", "--env-kwargs", kwargs)
    arguments = ("--ckpt", pretrained_file(preset), *names, "--no-auto-load-policy", "--max-steps", 3, "--out", out)
    return main([*map(str, arguments)])


@pytest.mark.parametrize("preset", ["NadirScan-v1", "Constellation-v1"])
def test_policies_of_one_and_of_several_satellites_are_filmed(preset, tmp_path):
    assert film(preset, tmp_path / "film.gif") == 0
    with Image.open(tmp_path / "film.gif") as picture:
        assert (picture.n_frames, picture.size) == (4, (640, 480))


def test_options_that_do_not_exist_are_named(tmp_path, capsys):
    with pytest.raises(SystemExit):
        film("NadirScan-v1", tmp_path / "film.gif", n_target=3)
    assert "n_target" in capsys.readouterr().err
    assert not (tmp_path / "film.gif").exists()
