"""Every tutorial runs from end to end at its smallest size; what it learns in a moment is not tested."""

import importlib.util
import re
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "tutorials"

SIZES: dict[str, dict[str, str]] = {
    "01_scanning.py": {"EPISODES": "4", "SECONDS": "900.0"},
    "02_agile_imaging.py": {"EPISODES": "5", "ORBIT": "400.0", "STEPS": "1"},
    "03_constellations.py": {"SATELLITES, TARGETS": "6, 500", "EPISODES": "2", "SECONDS": "600.0"},
    "04_training_torchrl.py": {
        "NUM_ENVS, ROLLOUT": "4, 8",
        "FRAMES": "64",
        "LOOP_FRAMES": "64",
        "EPISODES": "4",
        "SECONDS": "900.0",
    },
    "05_stable_baselines3.py": {"NUM_ENVS, ROLLOUT": "4, 8", "STEPS": "96", "EPISODES": "4", "SECONDS": "900.0"},
    "06_rllib_benchmarl.py": {"ITERATIONS": "1", "NUM_ENVS, ROLLOUT": "4, 8", "EPISODES": "2", "SECONDS": "400.0"},
    "07_curriculum_and_shields.py": {"NUM_ENVS": "4", "STEPS": "12", "EPISODES": "4", "SECONDS": "600.0"},
    "08_evaluating_and_publishing.py": {
        "EPISODES": "8",
        "FRAMES": "32",
        "SECONDS": "900.0",
        "SEEDS, SHOWN": '"0:2", "1"',
        "LIMIT": '["--time-limit", "300"]',
    },
    "09_watch_an_episode.py": {"FRAMES": "3", "MEMBERS": "3", "UNTIL": "600.0"},
    "10_inspection.py": {"EPISODES": "2", "SECONDS": "1200.0", "FRAMES, NUM_ENVS": "64, 4"},
    "11_planning.py": {"EPISODES": "2", "SECONDS": "600.0", "TARGETS": "2000", "LIMIT": "1.0"},
    "12_cubesat.py": {"DAY": "3_600.0"},
    "13_imaging_satellites.py": {"OBJECTS": "20", "SECONDS": "900.0", "EPISODES": "2"},
    "14_your_constellation.py": {"HOURS": "0.1"},
}
"""Values of constants, by tutorial and by what stands left of the equals sign."""

NEEDS = {"05_stable_baselines3.py": "sb3_contrib", "06_rllib_benchmarl.py": "benchmarl"}
"""Modules beyond those that scripts/test.sh always installs."""


def gallery() -> ModuleType:
    """The settings of the gallery, ``docs/gallery.py``."""
    spec = importlib.util.spec_from_file_location("gallery", ROOT / "docs" / "gallery.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def small(name: str) -> str:
    """Source of a tutorial at its smallest size."""
    source = (FOLDER / name).read_text()
    for constant, value in SIZES[name].items():
        source, found = re.subn(rf"^{re.escape(constant)} = .*$", f"{constant} = {value}", source, flags=re.MULTILINE)
        assert found == 1, f"{name} has {found} assignments of {constant}"
    return source


@pytest.mark.compiled
@pytest.mark.parametrize("name", SIZES)
def test_runs(name, tmp_path, monkeypatch):
    """It draws at least one picture, of which its thumbnail is made."""
    if name in NEEDS and find_spec(NEEDS[name]) is None:
        pytest.skip(f"needs {NEEDS[name]}")
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pyplot.switch_backend("agg")
    monkeypatch.chdir(tmp_path)
    exec(compile(small(name), name, "exec"), {"__name__": "__main__"})
    written = [path for path in tmp_path.iterdir() if path.suffix in gallery().PICTURES]
    assert written or pyplot.get_fignums()
    pyplot.close("all")


def test_every_tutorial_is_run_and_links_lead_somewhere():
    assert {path.name for path in FOLDER.glob("*.py")} == set(SIZES)
    everything = "\n".join(path.read_text() for path in FOLDER.glob("*.py"))
    labels = set(re.findall(r"^\.\. _(tutorial-[a-z0-9]+):$", everything, re.MULTILINE))
    assert set(re.findall(r":ref:`(tutorial-[a-z0-9]+)`", everything)) <= labels
    pages = {f"sphx_glr_gallery_{path.relative_to(ROOT / 'examples')}".replace("/", "_") for path in programs()}
    assert set(re.findall(r":ref:`(sphx_glr_[^`]+)`", everything)) <= pages
    # What the page of RLlib includes is code that the tests of the marker rllib run.
    source = (FOLDER / "06_rllib_benchmarl.py").read_text()
    included = re.findall(r"literalinclude:: /\.\./([^\n]+)\n#     :pyobject: (\w+)", source)
    assert len(included) == 4
    for path, name in included:
        assert re.search(rf"^(def|class) {name}\b", (ROOT / path).read_text(), re.MULTILINE)


@pytest.mark.parametrize("name", SIZES)
def test_structure(name):
    """A label, a title, the result first, where to go next, and a thumbnail."""
    source = (FOLDER / name).read_text()
    assert re.match(r'"""\n\.\. _tutorial-[a-z0-9]+:\n\n[^\n]+\n=+\n\n', source)
    before, headings = zip(*re.findall(r"^(.*)\n# ([^\n]+)\n# -{3,}$", source, re.MULTILINE), strict=True)
    assert (headings[0], headings[-1]) == ("Result", "Next steps")
    assert {*before} <= {"# %%", "#"}  # a heading after text without a blank line is text
    [(above, _)] = re.findall(r"^(.*)\n(# sphinx_gallery_thumbnail_\w+ = .+)$", source, re.MULTILINE)
    assert not above.startswith("#")  # in a cell of text it would be shown


def programs() -> list[Path]:
    """The examples; tests/test_scripts.py says which tests run them."""
    return sorted((ROOT / "examples").rglob("*.py"))


def test_every_example_has_arguments_in_the_gallery_or_is_left_out():
    settings = gallery()
    names = {settings.name_of(path) for path in programs()}
    skipped = {name for name in names if Path(name).stem in settings.NOT_EXECUTED}
    assert set(settings.ARGUMENTS) == names - skipped
    assert {Path(name).stem for name in skipped} == set(settings.NOT_EXECUTED)
    pattern = gallery().settings(execute=True)["filename_pattern"]
    executed = {path.stem for path in [*programs(), *FOLDER.glob("*.py")] if re.search(pattern, str(path))}
    assert executed == {path.stem for path in [*programs(), *FOLDER.glob("*.py")]} - set(gallery().NOT_EXECUTED)


@pytest.mark.parametrize("path", programs(), ids=lambda path: path.stem)
def test_examples_have_a_title_and_take_their_arguments(path):
    source, settings = path.read_text(), gallery()
    title = re.match(r'"""\n([^\n]+)\n(=+)\n\n', source)
    assert len(title[1]) == len(title[2])
    given = settings.ARGUMENTS.get(settings.name_of(path), "")
    assert all(f'"{option}"' in source for option in re.findall(r"--[a-z-]+", given))
