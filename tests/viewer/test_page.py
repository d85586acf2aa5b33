"""The viewer's page as text: everything in it, nothing that a name could break out of."""

import json
import re
import runpy
import shutil
from base64 import b64decode
from importlib.resources import files
from pathlib import Path

import pytest

from bsk_torch.viewer.page import build_page
from tests.support.programs import run_script
from tests.support.recordings import SCRIPT, synthetic_recording

FOLDER = files("bsk_torch.viewer").joinpath("page")
MODULES = {entry.name.removesuffix(".js"): entry.read_text() for entry in FOLDER.iterdir() if entry.name.endswith(".js")}
IMPORT = re.compile(r'import (?:\{([^}]*)\} from )?"([^"]+)"')


MAKER = Path(__file__).parents[2] / "scripts" / "tools" / "make_three.py"


def element(page, name):
    """Text of the element of an id."""
    return page.partition(f'id="{name}">')[2].partition("</script>")[0]


def test_a_page_needs_a_recording_or_a_server():
    with pytest.raises(ValueError, match="nothing to show"):
        build_page()
    assert json.loads(element(build_page(live="/api"), "settings")) == {"live": "/api"}


def test_the_recording_is_in_the_page_as_it_was_encoded():
    content = synthetic_recording().encode()
    assert b64decode(element(build_page(content), "recording")) == content


def test_every_module_is_in_the_table_of_names():
    page = build_page(b"")
    table = json.loads(page.partition('<script type="importmap">')[2].partition("</script>")[0])["imports"]
    assert set(table) == {"three"} | {f"viewer/{name}" for name in MODULES}
    start = b64decode(table["viewer/main"].partition("base64,")[2]).decode()
    assert start == MODULES["main"]


def exports_of_three():
    three = FOLDER.joinpath("vendor").joinpath("three.js").read_text()
    return set(re.findall(r"(?:as |[{,])(\w+)(?=[,}])", three[three.rindex("export{") :]))


def test_three_is_vendored_with_what_is_needed_its_version_and_its_license():
    maker = runpy.run_path(str(MAKER))
    assert set(maker["imported"]()) == exports_of_three()
    vendored = FOLDER.joinpath("vendor")
    assert f"three.js {maker['VERSIONS']['three']}, MIT license" in vendored.joinpath("three.js").read_text()[:200]
    assert "The MIT License" in vendored.joinpath("LICENSE.three.txt").read_text()


@pytest.mark.nightly
def test_three_can_be_made_again(tmp_path):
    if shutil.which("npm") is None:
        pytest.skip("npm is missing")
    done = run_script(MAKER, "--out", str(tmp_path), folder=tmp_path, environment={})
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "three.js").read_text() == FOLDER.joinpath("vendor").joinpath("three.js").read_text()


def test_modules_import_what_others_export():
    exported = {"three": exports_of_three()}
    for name, text in MODULES.items():
        exported[f"viewer/{name}"] = set(re.findall(r"^export (?:async )?(?:function|class|const) (\w+)", text, re.MULTILINE))
    wanted = [
        (name, source, word.strip())
        for name, text in MODULES.items()
        for words, source in IMPORT.findall(text)
        for word in words.split(",")
    ]
    missing = [one for one in wanted if one[2] and one[2] not in exported[one[1]]]
    assert len(wanted) > 40
    assert not missing


def test_no_module_makes_markup_or_programs_from_text():
    forbidden = re.compile(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\(|new Function|https?://")
    found = [(name, match[0]) for name, text in MODULES.items() for match in forbidden.finditer(text)]
    assert len(MODULES) > 12
    assert not found


def test_names_end_no_element():
    page = build_page(synthetic_recording(name=SCRIPT).encode(), live=f"/api{SCRIPT}", title=SCRIPT)
    assert SCRIPT not in page
    assert page.count("</script>") == page.count("<script")
    assert json.loads(element(page, "settings"))["live"] == f"/api{SCRIPT}"


def test_twelve_satellites_and_5000_targets_over_five_orbits_fit_in_10_megabytes():
    page = build_page(synthetic_recording(satellites=12, targets=5000, duration=28_500.0, tracks=1).encode())
    assert len(page) < 10_000_000
