"""The site builds without warnings, its links lead somewhere, and it needs nothing from elsewhere."""

import re
import subprocess
import sys
from urllib.parse import unquote, urlsplit
from xml.etree import ElementTree

import pytest

from tests.support.blocks import ROOT

pytestmark = [pytest.mark.docs, pytest.mark.xdist_group("site")]

GENERATED = re.compile(r"^<!-- generated: ", re.MULTILINE)


@pytest.fixture(scope="session")
def pages(site):
    """The parsed pages by path."""
    from bs4 import BeautifulSoup

    return {path: BeautifulSoup(path.read_text(), "html.parser") for path in sorted(site.rglob("*.html"))}


def targets(soup):
    """Places that links of a page can lead to."""
    return {element["id"] for element in soup.find_all(id=True)} | {
        element["name"] for element in soup.find_all("a", attrs={"name": True})
    }


def test_links_lead_somewhere(site, pages):
    places = {path: targets(soup) for path, soup in pages.items()}
    dead = []
    for path, soup in pages.items():
        for element, attribute in (("a", "href"), ("img", "src"), ("link", "href"), ("script", "src")):
            for link in soup.find_all(element, attrs={attribute: True}):
                parts = urlsplit(link[attribute])
                if parts.scheme or parts.netloc:
                    continue
                target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
                target = target / "index.html" if target.is_dir() else target
                missing = (
                    target.suffix == ".html" and target in places and parts.fragment and parts.fragment not in places[target]
                )
                if not target.exists() or missing:
                    dead.append(f"{path.relative_to(site)}: {link[attribute]}")
    assert not dead


def test_nothing_is_loaded_from_elsewhere(site, pages):
    assert len(pages) > 100
    for path, soup in pages.items():
        loaded = [element.get("src") for element in soup.find_all(["script", "img", "iframe", "source"])]
        loaded += [element.get("href") for element in soup.find_all("link") if "canonical" not in element.get("rel", ())]
        assert not [link for link in loaded if link and urlsplit(link).netloc], path
    for path in site.rglob("*.css"):
        assert not re.findall(r"(?:url\(|@import\s)[\"']?(?:https?:)?//", path.read_text()), path


def test_files_for_machines_exist(site, pages):
    locations = ElementTree.parse(site / "sitemap.xml").getroot().iter("{http://www.sitemaps.org/schemas/sitemap/0.9}loc")
    listed = {urlsplit(location.text).path.lstrip("/") for location in locations}
    own = {path.relative_to(site).as_posix() for path in pages} - {"search.html", "genindex.html", "py-modindex.html"}
    assert {name for name in own if not name.startswith("_modules")} <= listed
    assert "bsk_torch" in (site / "llms.txt").read_text()
    assert not GENERATED.search((site / "llms-full.txt").read_text())
    assert '"eclips' in (site / "searchindex.js").read_text()


def test_pages_have_the_version_of_the_package_and_formulas_in_mathml(pages, site):
    import bsk_torch

    assert bsk_torch.__version__ in pages[site / "index.html"].title.text
    assert sum(len(soup.find_all("math")) for soup in pages.values()) > 20
    assert not [path for path, soup in pages.items() if soup.find(string=re.compile(r"\\\(|\\\[.*\\\]"), class_="math")]


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
    from docs._ext import generated

    pages = sorted((ROOT / "docs").glob("*/*.md"))
    marks = [(path, mark) for path in pages for mark in generated.MARK.finditer(path.read_text())]
    assert len(marks) > 30
    for path, mark in marks:
        text = generated.filled(mark[0])
        assert text.strip(), path
        assert "@@" not in text, path
        assert not re.search(r"\|[ \t]*\|", re.sub(r"`[^`\n]*`", "`", text)), (path, mark[0])
