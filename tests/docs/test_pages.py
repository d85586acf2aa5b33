"""Every block of every page runs: those of one page in order, in one namespace and one empty folder."""

import re
from itertools import pairwise
from urllib.parse import unquote

import pytest
from markdown_it import MarkdownIt

from bsk_torch.presets import PRESETS
from docs import fill
from tests.docs.quoted import checking_print
from tests.support.blocks import ROOT, blocks, run_commands, run_python

DOCS = ROOT / "docs"
PAGES = fill.pages()
RUNNABLE = [path for path in PAGES if blocks(path, "python", "bash")]


def name(path):
    return path.relative_to(DOCS).as_posix()


@pytest.fixture
def presets():
    """Presets that a page adds are forgotten after its test."""
    known = dict(PRESETS)
    yield
    PRESETS.clear()
    PRESETS.update(known)


@pytest.mark.compiled
@pytest.mark.parametrize("path", RUNNABLE, ids=name)
def test_blocks(path, tmp_path, monkeypatch, presets):
    """Results that comments behind a print quote are those that are printed; pictures of a guide are what its blocks draw."""
    monkeypatch.chdir(tmp_path)
    namespace = {"__name__": "page", "print": checking_print(path, [])}
    for block in blocks(path, "python", "bash"):
        run_python(block, path, namespace) if block.language == "python" else run_commands(block)
    drawn = re.findall(r"_static/how_to/([\w.]+)", path.read_text())
    assert all((tmp_path / name).is_file() for name in drawn)


def test_pages_have_one_heading_and_say_what_they_are_for():
    failures = []
    for path in PAGES:
        text = re.sub(r"^```.*?^```|<!--.*?-->", "", path.read_text(), flags=re.DOTALL | re.MULTILINE)
        first = re.sub(r"^# .*", "", text, count=1, flags=re.MULTILINE).strip().partition("\n")[0]
        if len(re.findall(r"^# ", text, re.MULTILINE)) == 1 and re.match(r"[\w`*\[(]", first):
            continue
        failures.append(f"{name(path)}: not one heading, or the first line is no sentence: {first}")
    assert not failures, "\n".join(failures)


@pytest.mark.parametrize("path", [path for path in PAGES if re.search(r"<!-- generated|\[\]\(", path.read_text())], ids=name)
def test_tables_and_titles_of_links_are_current(path):
    current = path.read_text() == fill.filled(path)
    assert current, f"{name(path)} is not current: run python docs/fill.py"


def damage(path):
    """What a plain viewer of Markdown, such as a repository's, shows broken: directives, roles, empty or dead links."""
    text = path.read_text()
    for block in MarkdownIt("commonmark").enable("table").parse(text):
        if block.type == "fence" and block.info.startswith("{"):
            yield f"directive {block.info}"
        if block.type == "paragraph_open" and block.map and re.match(r":::|\.\. \w+::", text.splitlines()[block.map[0]].strip()):
            yield f"directive in line {block.map[0] + 1}"
        for part, following in pairwise([*(block.children or []), None]):
            if part.type == "text" and re.search(r"\{[\w:-]+\}$", part.content) and following and following.type == "code_inline":
                yield f"role {part.content[-20:]}`{following.content}`"
            if part.type == "link_open":
                link = part.attrs["href"]
                if following.type == "link_close":
                    yield f"link without text to {link}"
                if not re.match(r"https?:|mailto:", link):
                    file, _, section = unquote(link).partition("#")
                    target = (path.parent / file) if file else path
                    if not link or not target.exists() or (section and section not in fill.headings(target.read_text())):
                        yield f"dead link to {link}"
            if part.type == "image" and not (path.parent / part.attrs["src"]).exists():
                yield f"picture {part.attrs['src']} without a file"


@pytest.mark.parametrize("path", [*sorted(ROOT.glob("*.md")), *PAGES], ids=lambda path: path.relative_to(ROOT).as_posix())
def test_a_page_reads_whole_in_a_plain_viewer(path):
    assert not list(damage(path))


def test_damage_is_found(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("# A\n\n[](b.md) {term}`tick` [b](#c)\n\n```{toctree}\n```\n\n:::{note}\n:::\n\n![x](y.png)\n")
    assert [found.split()[0] for found in damage(page)] == ["link", "dead", "role", "dead", "directive", "directive", "picture"]


def test_pages_that_messages_and_docstrings_name_exist():
    files = [path for folder in ("bsk_torch", "scripts", "examples", "benchmarks") for path in (ROOT / folder).rglob("*.py")]
    named = {(page, path.name) for path in files for page in re.findall(r"\bdocs/[\w/.]+?\.md\b", path.read_text())}
    programs = [*(DOCS / "tutorials").glob("*.py"), *(ROOT / "examples").rglob("*.py")]
    named |= {(f"docs/{page}.md", path.name) for path in programs for page in re.findall(r":doc:`/([\w/]+)`", path.read_text())}
    assert len(named) > 10
    assert not {(page, file) for page, file in named if not (ROOT / page).exists()}


WIDEST = 96
"""Columns of code that a page of 1,280 pixels shows."""


def test_code_fits_a_page():
    wide = [
        f"{name(path)}:{block.line + k}"
        for path in PAGES
        for block in blocks(path, "python", "bash")
        for k, line in enumerate(block.code.splitlines())
        if len(line) > WIDEST
    ]
    assert not wide


def test_pages_are_found():
    assert len(PAGES) >= 10
