"""The site builds without warnings, its links lead somewhere, and it needs nothing from elsewhere."""

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit
from xml.etree import ElementTree

import pytest

from tests.support.blocks import ROOT

pytestmark = [pytest.mark.docs, pytest.mark.xdist_group("site")]

LINKS = {"a": "href", "img": "src", "iframe": "src", "link": "href", "script": "src", "source": "src"}
"""Attribute that names another file, by element."""


class Page(HTMLParser):
    """What tests ask of a page: its links as element, address and attributes, and the places to which links can lead."""

    def __init__(self, path: Path):
        super().__init__()
        self.text, self.links, self.places = path.read_text(), [], set()
        self.feed(self.text)

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.places |= {given.get("id"), given.get("name") if tag == "a" else None} - {None}
        if given.get(LINKS.get(tag)):
            self.links.append((tag, given[LINKS[tag]], given))


@pytest.fixture(scope="session")
def pages(site):
    """The parsed pages by path."""
    return {path: Page(path) for path in sorted(site.rglob("*.html"))}


def test_links_lead_somewhere(site, pages):
    places, dead, counted = {str(path): page.places for path, page in pages.items()}, [], 0
    for path, page in pages.items():
        for link in {link for _, link, _ in page.links}:
            parts, counted = urlsplit(link), counted + 1
            if parts.scheme or parts.netloc:
                continue
            target = os.path.normpath(path.parent / unquote(parts.path)) if parts.path else str(path)
            known = places.get(target) or places.get(f"{target}/index.html")
            if parts.fragment not in known if known and parts.fragment else not known and not os.path.exists(target):
                dead.append(f"{path.relative_to(site)}: {link}")
    assert counted > 1000
    assert not dead


def test_nothing_is_loaded_from_elsewhere(site, pages):
    assert len(pages) > 100
    for path, page in pages.items():
        loaded = [link for tag, link, given in page.links if tag != "a" and given.get("rel") != "canonical"]
        assert not [link for link in loaded if urlsplit(link).netloc], path
    for path in site.rglob("*.css"):
        assert not re.findall(r"(?:url\(|@import\s)[\"']?(?:https?:)?//", path.read_text()), path


def test_files_for_machines_exist(site, pages):
    locations = ElementTree.parse(site / "sitemap.xml").getroot().iter("{http://www.sitemaps.org/schemas/sitemap/0.9}loc")
    listed = {urlsplit(location.text).path.lstrip("/") for location in locations}
    own = {path.relative_to(site).as_posix() for path in pages} - {"search.html", "genindex.html", "py-modindex.html"}
    assert {name for name in own if not name.startswith("_modules")} <= listed
    assert "bsk_torch" in (site / "llms.txt").read_text()
    assert '"eclips' in (site / "searchindex.js").read_text()


def test_pages_have_the_version_of_the_package_and_formulas_in_mathml(pages, site):
    import bsk_torch

    assert re.search(rf"<title>[^<]*{re.escape(bsk_torch.__version__)}[^<]*</title>", pages[site / "index.html"].text)
    assert sum(page.text.count("<math") for page in pages.values()) > 20
    assert '<td class="number"><p>1e-3</p></td>' in pages[site / "truth/index.html"].text
    assert not [path for path, page in pages.items() if re.search(r'class="[^"]*\bmath\b[^>]*>[^<]*(\\\(|\\\[)', page.text)]


def test_versions_lie_side_by_side(site, tmp_path):
    """scripts/docs.sh calls this script with the folder of a site that has several versions."""
    import bsk_torch

    script = ROOT / "scripts" / "tools" / "publish_docs.py"
    assert "publish_docs.py" in (ROOT / "scripts" / "docs.sh").read_text()
    (tmp_path / "0.0.9").mkdir()
    (tmp_path / "0.0.9" / "index.html").write_text("old")
    subprocess.run([sys.executable, str(script), str(site), str(tmp_path)], check=True, cwd=ROOT)
    names = re.findall(r'href="([^/]+)/index.html"', (tmp_path / "index.html").read_text())
    assert names == ["latest", bsk_torch.__version__, "0.0.9"]
    assert all((tmp_path / name / "index.html").exists() for name in names)


def test_generated_parts_have_no_gaps():
    from docs import fill

    parts = [(path, part[0]) for path in fill.pages() for part in fill.MARK.finditer(path.read_text())]
    assert len(parts) > 100
    for path, text in parts:
        assert "@@" not in text, path
        assert not re.search(r"\|[ \t]*\|", re.sub(r"`[^`\n]*`", "`", text)), (path, text[:80])
