"""The site in a browser: scripts, pictures, search, keyboard, narrow screens, dark mode."""

import pytest

from tests.support.browser import (
    CONTRAST,
    NAMELESS_PICTURES,
    NARROW,
    PICTURES_LACKING,
    WIDE,
    WIDER_THAN_SCREEN,
    Visitor,
    chromium,
    served,
)

pytestmark = [pytest.mark.docs, pytest.mark.browser, pytest.mark.xdist_group("site")]

READABLE = 3.0
"""Least ratio of luminances of a text and its background; WCAG's AA asks for 4.5, and for 3 where letters are large."""

SHOWN = (
    "index.html",
    "truth/index.html",
    "studies/paper_result.html",
    "api/reference/preset.AEOS-v1.html",
    "api/reference/bsk_torch.act.Image.html",
)
"""Pages of each kind."""


@pytest.fixture(scope="module")
def browser():
    with chromium() as browser:
        yield browser


@pytest.fixture(scope="module")
def address(site):
    with served(site) as address:
        yield address


GENERATED = "api/reference/*.html"
"""Pages of one template; every eighth of them is opened in the plain run, and all of them at night."""


def troubles_of(pages, site, browser, address):
    """By page: what is wrong with it on a narrow screen, and by how many pixels it is too wide."""
    visitor, wrong = Visitor(browser, viewport=NARROW), {}
    for path in pages:
        name = path.relative_to(site).as_posix()
        page = visitor.go(f"{address}/{name}")
        found = [*visitor.troubles, *page.evaluate(PICTURES_LACKING), *page.evaluate(NAMELESS_PICTURES)]
        wider = page.evaluate(WIDER_THAN_SCREEN)
        if found or wider > 0:
            wrong[name] = (found, wider)
        visitor.troubles.clear()
    return wrong


def test_every_page_loads_whole_and_fits_a_narrow_screen(site, browser, address):
    generated = sorted(site.glob(GENERATED))
    assert len(generated) > 100
    others = sorted({*site.rglob("*.html")} - {*generated})
    assert not troubles_of([*others, *generated[::8]], site, browser, address)


@pytest.mark.nightly
def test_every_page_of_the_reference_loads_whole_and_fits_a_narrow_screen(site, browser, address):
    assert not troubles_of(sorted(site.glob(GENERATED)), site, browser, address)


def test_search_finds_a_word(browser, address):
    visitor = Visitor(browser, viewport=WIDE)
    page = visitor.go(f"{address}/index.html")
    page.fill("input[name=q]", "eclipse")
    page.press("input[name=q]", "Enter")
    page.wait_for_selector("#search-results li a")
    assert any("Eclipse" in text for text in page.locator("#search-results li").all_inner_texts())
    assert not visitor.troubles


def test_search_works_from_files(site, browser):
    visitor = Visitor(browser, viewport=WIDE)
    page = visitor.go(f"{site.as_uri()}/search.html?q=eclipse")
    page.wait_for_selector("#search-results li a")


def test_the_keyboard_reaches_search_and_links(browser, address):
    visitor = Visitor(browser, viewport=WIDE)
    page = visitor.go(f"{address}/index.html")
    reached = []
    for _ in range(60):
        page.keyboard.press("Tab")
        reached.append(page.evaluate("[document.activeElement.tagName, document.activeElement.name || '']"))
        if page.evaluate("!!document.activeElement.checkVisibility()") and reached[-1][0] in ("A", "INPUT"):
            assert visitor.focus_is_visible(), page.evaluate("document.activeElement.outerHTML")
    assert ["INPUT", "q"] in reached
    assert sum(tag == "A" for tag, _ in reached) >= 10


def test_the_menu_of_a_narrow_screen_opens(browser, address):
    page = Visitor(browser, viewport=NARROW).go(f"{address}/index.html")
    link = page.locator(".sidebar-tree a", has_text="API").first
    box = link.bounding_box()
    assert box is None or box["x"] < 0  # outside of the screen
    page.locator("header label[for=__navigation]").click()
    page.wait_for_timeout(500)
    link.click()
    page.wait_for_url("**/api/index.html")


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("name", SHOWN)
def test_text_can_be_read(browser, address, name, scheme):
    page = Visitor(browser, viewport=WIDE, color_scheme=scheme).go(f"{address}/{name}")
    ratio, text = page.evaluate(CONTRAST)
    assert ratio >= READABLE, text
