"""What is published: the wheel, the conda recipe and the image."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
import yaml

import bsk_torch

tomllib = pytest.importorskip("tomllib")  # Python 3.11

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
CONDA_NAMES = {"torch": "pytorch"}
"""Packages that conda calls otherwise than PyPI."""

PLAY = """
import sys
import bsk_torch
from bsk_torch.rl.policies.pretrained import pretrained
assert bsk_torch.__file__.startswith(sys.argv[1]), bsk_torch.__file__
env = bsk_torch.make("NadirScan-v1", num_envs=2, seed=0, backend="eager", max_step_duration=5.0)
print(env.rollout(2, pretrained("NadirScan-v1"))["next", "reward"].shape)
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel, built as for a release from the files that git knows."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("dist")
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout.decode().split("\0")
    for name in filter(None, names):
        if name.startswith("bsk_torch/") or name in ("pyproject.toml", "README.md", "LICENSE"):
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            (source / name).write_bytes((ROOT / name).read_bytes())
    run(sys.executable, "-m", "build", "--wheel", "--outdir", str(out), str(source))
    (made,) = out.glob("*.whl")
    return made


def run(*command, **options):
    """Run a command; return what it prints."""
    done = subprocess.run(command, capture_output=True, text=True, check=False, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_wheel_has_every_file_of_the_package(wheel):
    files = subprocess.run(["git", "ls-files", "bsk_torch"], cwd=ROOT, capture_output=True, check=True, text=True).stdout.split()
    assert set(files) - set(zipfile.ZipFile(wheel).namelist()) == set()


def test_the_wheel_runs_without_the_source(wheel, tmp_path):
    place = tmp_path / "place"
    zipfile.ZipFile(wheel).extractall(place)
    environment = {"PYTHONPATH": str(place), "PATH": "/usr/bin:/bin", "HOME": str(tmp_path), "OMP_NUM_THREADS": "1"}
    shape = run(sys.executable, "-c", PLAY, str(place), cwd=tmp_path, env=environment)
    assert shape.strip() == "torch.Size([2, 2, 1])"
    assert "NadirScan-v1" in run(sys.executable, "-m", "bsk_torch", "list", cwd=tmp_path, env=environment)


def test_versions_and_extras_are_the_same_everywhere():
    recipe = yaml.safe_load((ROOT / "packaging" / "conda" / "recipe.yaml").read_text())
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert {PROJECT["version"], recipe["context"]["version"], citation["version"]} == {bsk_torch.__version__}
    extras = PROJECT["optional-dependencies"]
    (whole,) = extras["all"]
    named = set(whole.partition("[")[2].rstrip("]").split(","))
    assert named == set(extras) - {"all", "basilisk", "dev", "docs", "test"}


def test_conda_reads_the_recipe_and_it_asks_for_what_pip_asks_for():
    rattler = pytest.importorskip("rattler_build")
    recipe = rattler.Stage0Recipe.from_file(str(ROOT / "packaging" / "conda" / "recipe.yaml"))
    (variant,) = recipe.render()
    rendered = variant.recipe.to_dict()
    asked = {" ".join(str(need).split()) for need in rendered["requirements"]["run"]}
    assert len(PROJECT["dependencies"]) > 8
    for need in PROJECT["dependencies"]:
        name = next(name for name in sorted(PROJECT_NAMES, key=len, reverse=True) if need.startswith(name))
        assert f"{CONDA_NAMES.get(name, name)} {need.removeprefix(name)}" in asked


PROJECT_NAMES = [need.split(">")[0].split("<")[0].split("=")[0] for need in PROJECT["dependencies"]]


def test_the_image_is_described_as_the_linter_wants_it():
    linter = Path(sys.executable).with_name("hadolint")
    if not linter.exists():
        pytest.skip("needs the extra dev")
    run(str(linter), "Dockerfile", cwd=ROOT)


def test_the_newest_versions_are_tried_by_a_script(tmp_path):
    """With a Python that only notes what it is asked to do: the true one would download gigabytes."""
    python = tmp_path / "bin" / "python"
    python.parent.mkdir()
    python.write_text(
        '#!/bin/sh\necho "$*" >> "$0.log"\ncase "$*" in *-m\\ pytest*) echo "7 passed";; -c*) echo "2 | 1 | 1";; esac\n'
    )
    python.chmod(0o755)
    row = run(
        str(ROOT / "scripts" / "tools" / "try_newest.sh"), "tests/some.py", env={"PATH": "/usr/bin:/bin", "VENV": str(tmp_path)}
    )
    assert row.splitlines()[-1].endswith("| 2 | 1 | 1 | 7 passed |")
    asked = Path(f"{python}.log").read_text()
    assert "pip install -q --upgrade torch torchrl tensordict" in asked
    assert "-m pytest tests/some.py" in asked


def test_nothing_that_is_built_is_kept():
    names = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, check=True, text=True).stdout.split()
    assert len(names) > 500
    assert not [name for name in names if name.endswith((".so", ".o", ".cpp.lock", ".pyc", ".whl"))]
    folders = {name.partition("/")[0] for name in names if "/" in name}
    assert folders == {".ci", ".github", "benchmarks", "bsk_torch", "docs", "examples", "packaging", "paper", "scripts", "tests"}
