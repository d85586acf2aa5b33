"""The live page in Chromium, against a server with the protocol of the viewer and invented answers."""

import json
import threading
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from bsk_torch.viewer.page import build_page
from tests.support.browser import WIDE, Visitor, chromium
from tests.support.recordings import synthetic_recording

pytestmark = pytest.mark.browser

DECISION = 8
"""The decision of satellite 0 at 1,200 s; it takes action 2 of 3."""


class Answers(BaseHTTPRequestHandler):
    """Knows as many flights as were asked for."""

    asked: list[tuple[str, dict]]
    flights = 1

    def log_message(self, *_):
        """Print nothing."""

    def send(self, status, kind, content):
        self.send_response(status)
        self.send_header("X-Flights", ",".join(map(str, range(type(self).flights))))
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def recording(self):
        self.send(200, "application/octet-stream", synthetic_recording(tracks=type(self).flights).encode())

    def do_GET(self):
        if self.path == "/api/recording" and self.headers["Authorization"] == "Bearer secret":
            self.recording()
        elif self.path.startswith("/?"):
            self.send(200, "text/html; charset=utf-8", build_page(live="/api").encode())
        else:
            self.send(404, "application/json", b'{"error": "nothing here"}')

    def do_POST(self):
        assert self.headers["Authorization"] == "Bearer secret"
        name = self.path.removeprefix("/api/")
        wanted = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        self.asked.append((name, wanted))
        if name == "values":
            self.send(200, "application/json", b'{"action_value": [0.25, null, 1.5], "how": "one future each"}')
        elif len(self.asked) > 4:
            self.send(400, "application/json", b'{"error": "action=1 is not <allowed>"}')
        else:
            type(self).flights += 1
            self.recording()


@contextmanager
def answered():
    handler = type("Own", (Answers,), {"asked": [], "flights": 1})
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield handler, f"http://127.0.0.1:{server.server_address[1]}/?token=secret"
    finally:
        server.shutdown()


@pytest.fixture
def live():
    with chromium() as browser, answered() as (handler, address):
        visitor = Visitor(browser, viewport=WIDE)
        visitor.page.goto(address)
        visitor.page.wait_for_selector("#message[hidden]", state="attached")
        visitor.page.evaluate("bskViewer.seek(1210)")
        yield handler, visitor


def test_the_values_of_all_actions_are_shown(live):
    handler, visitor = live
    visitor.page.click("#values")
    best = visitor.page.wait_for_selector(".decision td.best")
    assert handler.asked == [("values", {"track": 0, "decision": DECISION})]
    assert best.inner_text() == "1.50"
    assert visitor.page.locator(".decision tr", has_text="charge").inner_text().split("\t")[2] == "0.250"
    assert "one future each" in visitor.page.inner_text(".live .note")
    assert not visitor.troubles


def test_another_action_is_flown_and_both_flights_are_drawn(live):
    handler, visitor = live
    page = visitor.page
    page.locator(".decision tr", has_text="charge").locator("button").click()
    page.wait_for_selector("#compare[aria-pressed=true]")
    state = page.evaluate("(({ track, time, comparing }) => [track, time, comparing])(bskViewer.state())")
    assert handler.asked == [("branch", {"track": 0, "decision": DECISION, "action": 0})]
    assert state == [1, 1200.0, True]
    page.evaluate("bskViewer.seek(1510)")  # and take over once more, from the next decision of the new flight
    page.locator(".decision tr:not(.chosen) button").first.click()
    page.wait_for_selector("#tracks option:nth-child(3)", state="attached")
    assert [wanted["track"] for _, wanted in handler.asked] == [0, 1]
    assert page.evaluate("bskViewer.state().track") == 2
    assert not visitor.troubles


def test_another_episode_is_flown(live):
    handler, visitor = live
    visitor.page.click("#episode")
    visitor.page.wait_for_selector("#tracks option:nth-child(2)", state="attached")
    assert handler.asked[0][0] == "episode"
    assert visitor.page.evaluate("(({ track, time }) => [track, time])(bskViewer.state())") == [1, 0.0]


def test_errors_of_the_server_are_text(live):
    handler, visitor = live
    handler.asked.extend([("", {})] * 5)
    visitor.page.locator(".decision tr", has_text="charge").locator("button").click()
    visitor.page.wait_for_selector(".live .note:has-text('<allowed>')")
    assert visitor.page.evaluate("bskViewer.state().track") == 0


def test_a_server_that_is_gone_is_named():
    with chromium() as browser, answered() as (_, address):
        visitor = Visitor(browser, viewport=WIDE)
        visitor.page.route("**/api/recording**", lambda route: route.abort())
        visitor.page.goto(address)
        visitor.page.wait_for_selector("#message:has-text('does not answer')")
        assert visitor.page.locator("#message").is_visible()
