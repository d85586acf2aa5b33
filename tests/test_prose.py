"""The linter of prose, which scripts/test.sh runs: each pattern is found in prose, but not in code."""

import subprocess
import sys

import pytest

from tests.support.blocks import ROOT

SCRIPT = ROOT / "scripts" / "tools" / "check_prose.py"

PAGE = """# Title

Use `an option of your own` or [a link](beside.md).

```python
beside = "nobody"  # goes on
```
"""


def check(*files):
    command = [sys.executable, str(SCRIPT), *map(str, files)]
    return subprocess.run(command, capture_output=True, text=True)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("An action\nof your own.", ":2: 'of your own': your own X"),
        ("Two lines.\n\nThe run goes\non.", ":3: 'goes on': continue"),
        ("## What is kept\n", ":1: '## What is kept': a noun"),
        ("A policy that was trained by PPO.", "'that was trained': the participle alone"),
        ("The behaviour in grey colours, learnt by an optimiser towards the centre, a metre away.", "'behaviour'"),
    ],
)
def test_a_pattern_is_found_across_lines(tmp_path, text, found):
    page = tmp_path / "page.md"
    page.write_text(text)
    result = check(page)
    assert result.returncode == 1
    assert found in result.stdout


def test_british_words_are_found_and_american_ones_code_links_and_identifiers_are_not(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("manoeuvre behaviour colours neighbouring favour centre metres kilometre optimiser normalised learnt grey")
    assert len(check(page).stdout.splitlines()) == 12
    page.write_text(
        PAGE + "Maneuver, behavior, colors, neighbor, center, meter, parameter, diameter, optimizer, besides, precise, noise.\n"
    )
    assert check(page).stdout.startswith("no pattern")


def test_comments_docstrings_and_messages_of_programs_are_read(tmp_path):
    program = tmp_path / "program.py"
    program.write_text(
        '"""An action of your own."""\n\nbeside = {"manoeuvre": 1}  # code in ``nobody``\n# the run goes\n# on\n'
        'raise ValueError(f"{beside} is refused")\n'
    )
    lines = [line.partition(".py:")[2] for line in check(program).stdout.splitlines()]
    assert [line.partition(": ")[0] for line in lines] == ["4", "1", "6"]


def test_released_sections_of_the_changelog_are_not_read(tmp_path):
    page = tmp_path / "CHANGELOG.md"
    page.write_text("## 0.3.0 (in development)\n\nA fix.\n\n## 0.2.0 - 2026-11-24\n\nNobody goes on anew.\n")
    assert check(page).returncode == 0
