"""Make the film of the viewer in README.md and docs/how_to/view.md, in headless Chromium.

    python scripts/tools/make_viewer_film.py [--preset Constellation-v1] [--until 1500] [--step 25] [--out FILE.webp]

A flight of the pretrained policy plays until a decision, another action is chosen there, and both futures play together. The time
of the page is set for every frame, so the film does not depend on the speed of the machine. Needs Chromium and the extra ``viz``.
"""

from __future__ import annotations

import argparse
import shutil
import threading
from io import BytesIO
from pathlib import Path
from typing import Any

import torch
from PIL import Image
from playwright.sync_api import sync_playwright

from bsk_torch import make
from bsk_torch.rl.policies import pretrained, pretrained_file, read_card
from bsk_torch.rl.policies.shared_policy import shared
from bsk_torch.viewer.futures import Futures
from bsk_torch.viewer.server import serve

FILM = Path(__file__).parents[2] / "docs" / "_static" / "viewer" / "film.webp"
SEED, TARGETS = 3, 1000

SHARE = 0.5
"""Share of the flight after which another action is chosen."""

FRAME_MS, HELD = 110, 1200
"""Milliseconds that a frame is shown, and that the choice is shown."""

QUALITY = 30

SCROLL = """() => {
  const line = document.querySelector('.decision');
  document.getElementById('panels').scrollTop = line.offsetTop - 90;
}"""
"""Brings the table of actions into view."""


def futures_of(preset: str, until: float) -> Futures:
    """Return the flight of a pretrained policy."""
    options = {name: value for name, value in read_card(pretrained_file(preset))["options"].items() if name != "time_limit"}
    if "n_targets" in options:
        options["n_targets"] = TARGETS
    env = make(preset, num_envs=1, env_ids=[0], **options, time_limit=until)
    found = Futures(env, shared(pretrained(preset), env), preset=preset, label="pretrained policy")
    found.episode(SEED)
    return found


def choice_of(futures: Futures, time: float) -> tuple[int, int]:
    """Return the first decision after a time that allows another kind of action, and that action."""
    for number, choice in enumerate(futures.flown[0].choices):
        legal = [action for action, allowed in enumerate(choice.mask) if allowed and action != choice.action]
        if choice.time >= time and legal:
            return number, legal[0]
    raise SystemExit(f"no decision after {time:,.0f} s allows another action; give a later --until")


def filmed(page: Any, futures: Futures, step: float) -> list[tuple[Image.Image, int]]:
    """Return the frames, with the milliseconds that each is shown."""
    until = futures.flown[0].track.duration
    decision, action = choice_of(futures, SHARE * until)
    choice = futures.flown[0].choices[decision]
    frames: list[tuple[Image.Image, int]] = []

    def shoot(time: float, shown: int = FRAME_MS) -> None:
        page.evaluate("t => bskViewer.seek(t)", time)
        page.evaluate(SCROLL)
        frames.append((Image.open(BytesIO(page.screenshot())).convert("RGB"), shown))

    page.evaluate("s => bskViewer.viewer.visit(s, 0)", choice.satellite)
    time = 0.0
    while time < choice.time:
        shoot(time)
        time += step
    shoot(choice.time + 1.0, HELD)
    button = page.locator(".decision tr").nth(action + 1).locator("button")
    button.focus()
    shoot(choice.time + 1.0, HELD)
    button.click()
    page.wait_for_selector("#compare[aria-pressed=true]")
    time = choice.time + 1.0
    shoot(time, HELD)
    while time < until:
        time += step
        shoot(min(time, until))
    return frames


def main() -> None:
    """Fly, film and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", default="Constellation-v1")
    parser.add_argument("--until", type=float, default=1500.0, metavar="SECONDS")
    parser.add_argument("--step", type=float, default=25.0, metavar="SECONDS", help="simulated time between two frames")
    parser.add_argument("--out", type=Path, default=FILM, metavar="FILE.webp")
    options = parser.parse_args()
    torch.set_num_threads(1)
    futures = futures_of(options.preset, options.until)
    server = serve(futures)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_page(viewport={"width": 960, "height": 600}, color_scheme="dark")
        page.set_default_timeout(300_000)
        page.goto(server.url)
        page.wait_for_selector("#message[hidden]", state="attached")
        frames = filmed(page, futures, options.step)
        browser.close()
    server.shutdown()
    server.server_close()
    (first, _), *rest = frames
    shown = [milliseconds for _, milliseconds in frames]
    pictures = [picture for picture, _ in rest]
    first.save(options.out, save_all=True, append_images=pictures, duration=shown, loop=0, quality=QUALITY, method=4)
    print(f"{options.out}: {len(frames)} frames, {sum(shown) / 1e3:.1f} s, {options.out.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
