"""The C++ of every preset's ticks is the one that was last reviewed, by its lines or by its hash."""

import difflib
import json
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "scripts" / "tools"))

import update_golden  # noqa: E402
from update_golden import FOLDER, TABLE, WHOLE, all_sources, golden_files  # noqa: E402

SHOWN = 60
"""Lines of a difference that a failure shows."""


@pytest.fixture(scope="module")
def sources() -> tuple[dict[str, str], dict[str, list[str]]]:
    return all_sources()


def difference(name: str, expected: str, found: str) -> str:
    """A unified difference, cut off after ``SHOWN`` lines."""
    lines = list(difflib.unified_diff(expected.splitlines(), found.splitlines(), f"golden/{name}", "now", lineterm="", n=2))
    return "\n".join([*lines[:SHOWN], *([f"... and {len(lines) - SHOWN} more lines"] if len(lines) > SHOWN else [])])


def test_sources_are_the_golden_ones(sources):
    files = golden_files(*sources)
    assert {path.name for path in FOLDER.iterdir()} == set(files), "run python scripts/tools/update_golden.py"
    for name, found in sorted(files.items(), key=lambda item: item[0] == TABLE):  # a source first, which says more than its hash
        expected = (FOLDER / name).read_text()
        assert found == expected, (
            f"the generated code has changed:\n{difference(name, expected, found)}\n"
            "If that is intended, run python scripts/tools/update_golden.py and commit the new files with the change. "
            "Where only a hash differs, compare what update_golden.py --folder folder --whole writes on both commits."
        )


def test_every_source_is_golden_in_full_or_by_its_hash(sources):
    texts, names = sources
    files = golden_files(texts, names)
    hashes = json.loads(files[TABLE])["sha256"]
    assert {name for preset in WHOLE for name in names[preset]} == set(files) - {TABLE}
    assert set(hashes) == set(texts) - set(files)
    name = next(iter(hashes))
    changed = golden_files(texts | {name: texts[name] + " "}, names)
    assert {key for key in files if files[key] != changed[key]} == {TABLE}


def test_the_script_writes_what_has_changed_and_removes_what_no_preset_uses(sources, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(update_golden, "all_sources", lambda: sources)
    monkeypatch.setattr(sys, "argv", ["update_golden.py", "--folder", str(tmp_path)])
    (tmp_path / "Old-v1.cpp").write_text("no preset has it")
    update_golden.main()
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in FOLDER.iterdir()}
    assert "written or changed: AEOS-v1.cpp, presets.json" in capsys.readouterr().out
    (tmp_path / "AEOS-v1.cpp").write_text("")
    update_golden.main()
    assert "written or changed: AEOS-v1.cpp\n" in capsys.readouterr().out


def test_differences_are_shown():
    shown = difference("a.cpp", "1\n2\n3", "1\ntwo\n3")
    assert shown.splitlines() == ["--- golden/a.cpp", "+++ now", "@@ -1,3 +1,3 @@", " 1", "-2", "+two", " 3"]
    long = difference("a.cpp", "", "\n".join(map(str, range(100))))
    assert long.splitlines()[-1] == "... and 43 more lines"


def test_sources_hold_nothing_of_the_machine(sources):
    """Vectors are as wide as the header says; the header decides by macros of the compiler."""
    assert len(sources[0]) > 1
    for source in sources[0].values():
        assert not any(word in source.lower() for word in ("avx", "_mm", "__m512", "neon", "double[8]", str(ROOT)))
