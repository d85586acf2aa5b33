"""Pages in Chromium: what the tests of the site and of reports ask of them."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

PROGRAM = "chromium"
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]
NARROW, WIDE = {"width": 390, "height": 844}, {"width": 1280, "height": 900}
"""Sizes of a telephone and of a laptop, in CSS pixels."""

PATIENCE = 120_000
"""Milliseconds that a page may take, on a machine that does other things."""

WIDER_THAN_SCREEN = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
PICTURES_LACKING = "[...document.images].filter(image => !image.complete || image.naturalWidth === 0).map(image => image.src)"
NAMELESS_PICTURES = "[...document.images].filter(image => !image.hasAttribute('alt')).map(image => image.src)"

CONTRAST = """() => {
  const canvas = document.createElement('canvas').getContext('2d', {willReadFrequently: true});
  const rgba = color => {
    canvas.clearRect(0, 0, 1, 1); canvas.fillStyle = color; canvas.fillRect(0, 0, 1, 1);
    return [...canvas.getImageData(0, 0, 1, 1).data];
  };
  const light = rgb => rgb.slice(0, 3).map(v => v / 255).map(v => v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    .reduce((sum, v, k) => sum + v * [0.2126, 0.7152, 0.0722][k], 0);
  const ground = element => {
    for (let e = element; e; e = e.parentElement) {
      const color = rgba(getComputedStyle(e).backgroundColor);
      if (color[3] > 200) return color;
    }
    return rgba('white');
  };
  let worst = [99, ''];
  for (const e of document.querySelectorAll('h1, h2, h3, p, li, td, th, dt, dd, a, code, pre span, figcaption')) {
    const text = [...e.childNodes].filter(n => n.nodeType === 3).map(n => n.data.trim()).join('');
    if (!text || !e.checkVisibility({opacityProperty: true, visibilityProperty: true})) continue;
    const [a, b] = [light(rgba(getComputedStyle(e).color)), light(ground(e))].sort((x, y) => y - x);
    const ratio = (a + 0.05) / (b + 0.05);
    if (ratio < worst[0]) worst = [ratio, e.tagName + ' ' + e.className + ': ' + text.slice(0, 40)];
  }
  return worst;
}"""
"""The least ratio of luminances of a text and what lies behind it (WCAG), and that text."""

FOCUS = """() => {
  const names = ['outlineStyle', 'outlineWidth', 'boxShadow', 'borderColor', 'backgroundColor', 'textDecoration'];
  const look = e => { const style = getComputedStyle(e); return names.map(name => style[name]).join(); };
  const element = document.activeElement;
  const near = [element, element.parentElement, element.parentElement.parentElement];
  const focused = near.map(look).join();
  element.blur();
  const changed = focused !== near.map(look).join();
  element.focus({focusVisible: true});
  return changed;
}"""
"""Whether the element with the focus, or what it is in, looks otherwise than without it."""


@contextmanager
def chromium() -> Iterator[Any]:
    """Start a browser of Playwright's with the program of the system."""
    import shutil

    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which(PROGRAM), headless=True, args=FLAGS)
        yield browser
        browser.close()


class Quiet(SimpleHTTPRequestHandler):
    """Serves files and says nothing."""

    def log_message(self, *_: Any) -> None:
        """Print nothing."""


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """Serve a folder; give its address."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()


class Visitor:
    """A page of a browser that keeps a list of its troubles: errors of scripts and requests that fail or leave the machine."""

    def __init__(self, browser: Any, **options: Any) -> None:
        self.page, self.troubles = browser.new_page(**options), []
        self.page.set_default_timeout(PATIENCE)
        self.page.on("console", lambda message: self.troubles.append(message.text) if message.type == "error" else None)
        self.page.on("pageerror", lambda error: self.troubles.append(str(error)))
        self.page.on("requestfailed", lambda request: self.troubles.append(f"failed: {request.url}"))
        self.page.on("request", self._asked)
        self.page.on("response", self._answered)

    def _asked(self, request: Any) -> None:
        if not request.url.startswith(("http://127.0.0.1", "file:", "data:", "blob:", "about:")):
            self.troubles.append(f"leaves the machine: {request.url}")

    def _answered(self, response: Any) -> None:
        if response.status >= 400:
            self.troubles.append(f"{response.status}: {response.url}")

    def go(self, address: str) -> Any:
        """Open an address and load all pictures, those that are off the screen too."""
        self.page.goto(address)
        self.page.evaluate("for (const image of document.images) image.loading = 'eager'")
        self.page.wait_for_function("[...document.images].every(image => image.complete)")
        return self.page

    def focus_is_visible(self) -> bool:
        """Whether what has the focus looks otherwise than without it."""
        return bool(self.page.evaluate(FOCUS))
