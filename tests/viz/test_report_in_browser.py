"""The report of a training in a browser: pictures, narrow screens, legibility, and nothing that it loads."""

import dataclasses

import pytest

from bsk_torch.viz.report.page import write_report
from tests.support.browser import (
    CONTRAST,
    NAMELESS_PICTURES,
    NARROW,
    PICTURES_LACKING,
    WIDE,
    WIDER_THAN_SCREEN,
    Visitor,
    chromium,
)
from tests.support.recordings import SCRIPT, synthetic_recording

pytestmark = pytest.mark.browser


@pytest.mark.parametrize("screen", [NARROW, WIDE], ids=["narrow", "wide"])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_loads_whole_fits_the_screen_and_can_be_read(run, tmp_path, screen, scheme):
    path = write_report(run, tmp_path / "report.html")
    with chromium() as browser:
        visitor = Visitor(browser, viewport=screen, color_scheme=scheme)
        page = visitor.go(path.as_uri())
        assert not [*visitor.troubles, *page.evaluate(PICTURES_LACKING), *page.evaluate(NAMELESS_PICTURES)]
        assert page.evaluate(WIDER_THAN_SCREEN) <= 0
        assert page.evaluate("document.images.length") >= 4
        ratio, text = page.evaluate(CONTRAST)
        assert ratio >= 4.5, text


def test_the_viewer_in_it_shows_the_episodes(run, tmp_path):
    flights = synthetic_recording(name=SCRIPT, tracks=3).html()
    path = write_report(dataclasses.replace(run, flights=flights), tmp_path / "report.html")
    with chromium() as browser:
        visitor = Visitor(browser, viewport=WIDE)
        page = visitor.go(path.as_uri())
        page.locator("iframe").scroll_into_view_if_needed()
        inside = page.frame_locator("iframe")
        inside.locator("#message").wait_for(state="hidden")
        assert inside.locator("#tracks option").count() == 3
        assert not visitor.troubles
