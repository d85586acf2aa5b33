"""The page of the real server in Chromium, and recordings of presets of all kinds."""

import threading

import pytest
import torch

import bsk_torch
from bsk_torch.lab.planners import Rollout
from bsk_torch.rl.policies.shared_policy import rule
from bsk_torch.viewer import record
from bsk_torch.viewer.futures import Futures
from bsk_torch.viewer.server import serve
from tests.support.browser import WIDE, Visitor, chromium

pytestmark = pytest.mark.browser

LIMIT = 1200.0

FLIGHTS = {
    "Services-v1": ("rate", "orbit", 900.0),
    "ThreeSensors-v1": ("local", "orbit", 900.0),
    "RSOInspection-v1": ("circumnavigate", "points", 900.0),
    "CWDocking-v1": ("glide", "none", 120.0),
    "AEOSBench-v1": ("nearest_task", "ground", 120.0),
}
"""Rule, kind of the targets and seconds of flight, by preset."""


@pytest.fixture
def futures():
    env = bsk_torch.make("NadirScan-v1", num_envs=1, env_ids=[0], time_limit=LIMIT)
    found = Futures(env, rule("rule", env), preset="NadirScan-v1", label="rule")
    found.episode(0)
    return found


@pytest.fixture
def visitor(futures):
    server = serve(futures, port=18865)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with chromium() as browser:
        found = Visitor(browser, viewport=WIDE)
        found.page.goto(server.url)
        found.page.wait_for_selector("#message[hidden]", state="attached")
        yield found
    server.shutdown()
    server.server_close()


def state(page):
    return page.evaluate("(({ track, time, comparing }) => ({ track, time, comparing }))(bskViewer.state())")


def test_a_user_asks_for_values_takes_over_and_gives_back(visitor, futures):
    page = visitor.page
    choice = futures.flown[0].choices[3]
    page.evaluate("t => bskViewer.seek(t)", choice.time + 1.0)
    page.click("#values")
    page.wait_for_selector(".decision td.best")
    values = futures.flown[0].track.arrays["decision_action_value"][3]
    shown = page.locator(".decision tr:not(:first-child) td:nth-child(2)").all_inner_texts()
    legal = [k for k, allowed in enumerate(choice.mask) if allowed]
    assert [float(shown[k]) for k in legal] == pytest.approx([float(values[k]) for k in legal], abs=6e-3)
    assert "the policy decides afterwards" in page.inner_text(".live .note")

    other = next(k for k in legal if k != choice.action)
    page.locator(".decision tr").nth(other + 1).locator("button").click()  # take over
    page.wait_for_selector("#compare[aria-pressed=true]")
    assert state(page) == {"track": 1, "time": choice.time, "comparing": True}
    branch = futures.flown[1]
    assert branch.choices[3].action == other
    rest = sum(one.reward for one in branch.choices[3:])
    assert rest == pytest.approx(float(values[other]), abs=1e-5)

    page.evaluate("t => bskViewer.seek(t)", branch.choices[4].time + 1.0)  # the policy has the decision again: give back
    assert page.locator(".decision tr.chosen td").first.inner_text() == futures_label(futures, branch.choices[4].action)
    page.select_option("#tracks select", "0")
    assert state(page)["track"] == 0
    page.click("#episode")
    page.wait_for_selector("#tracks option:nth-child(3)", state="attached")
    assert len(futures.scenes) == 2
    assert not visitor.troubles


def futures_label(futures, action):
    """What the page calls an action."""
    return futures.recording().satellites[0].actions[action].removeprefix("action_").replace("_", " ")


def decided_page(browser, path, env, policy):
    """The page of a short flight after its first decision, and the recording."""
    recording = record(env, policy, seed=0, until=400.0)
    path.write_text(recording.html())
    page = Visitor(browser, viewport=WIDE).page
    page.goto(f"{path.as_uri()}#t=1")
    page.wait_for_selector("#message[hidden]", state="attached")
    return page, recording


def test_values_of_a_planner_are_on_the_page_and_a_rule_is_said_to_have_none(tmp_path):
    torch.set_num_threads(1)
    env = bsk_torch.make("NadirScan-v1", num_envs=1, env_ids=[0], time_limit=LIMIT)
    with chromium() as browser:
        page, recording = decided_page(browser, tmp_path / "planner.html", env, Rollout(env, "rule"))
        assert page.locator(".decision th").all_inner_texts() == ["action", "value"]
        values = recording.tracks[0].arrays["decision_action_value"][0]
        shown = page.locator(".decision tr:not(:first-child) td:nth-child(2)").all_inner_texts()
        assert [float(text) for text in shown] == pytest.approx(values.tolist(), abs=6e-3)
        assert "of a planner, the return up to its horizon" in page.inner_text(".opinion")
        page, _ = decided_page(browser, tmp_path / "rule.html", env, rule("rule", env))
        assert page.locator(".decision th").all_inner_texts() == ["action"]
        assert page.inner_text(".opinion") == "This policy computes neither probabilities nor values of actions."


@pytest.mark.parametrize("preset", FLIGHTS)
def test_presets_of_all_kinds_are_shown(preset, tmp_path):
    name, places, until = FLIGHTS[preset]
    torch.set_num_threads(1)
    env = bsk_torch.make(preset, num_envs=1, env_ids=[0])
    recording = record(env, rule(name, env), seed=0, until=until, preset=preset, label=name)
    assert recording.places == places
    path = tmp_path / "flight.html"
    path.write_text(recording.html())
    with chromium() as browser:
        visitor = Visitor(browser, viewport=WIDE)
        page = visitor.page
        page.goto(path.as_uri())
        page.wait_for_selector("#message[hidden]", state="attached")
        for view in ("globe", "map", "hill"):
            page.click(f"[data-view={view}]")
            page.evaluate("t => bskViewer.seek(t)", 0.5 * until)
            page.keyboard.press("ArrowRight")
            page.wait_for_timeout(150)
        assert page.evaluate("bskViewer.state().failed") is None
        assert page.locator("#panels h2").count() >= 2
        page.screenshot(path=tmp_path / "page.png")
        assert not visitor.troubles
