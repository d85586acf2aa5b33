"""The viewer in Chromium: pixels where geometry says, play, scrub, keys, narrow screens, names that stay text, bad recordings."""

import gzip
import io
import math
import struct

import numpy as np
import pytest
from PIL import Image

from bsk_torch.viewer.page import build_page
from tests.support.browser import CONTRAST, NARROW, WIDE, WIDER_THAN_SCREEN, Visitor, chromium
from tests.support.recordings import SCRIPT, SUN_N, states, synthetic_recording

pytestmark = pytest.mark.browser

RADIUS = 6378136.6
STATE = """() => {
  const { satellites, below, targets, subSolar, ground, ...others } = window.bskViewer.state();
  return { satellites, below, subSolar, first: targets?.([0, 1, 2]), ...others };
}"""


@pytest.fixture(scope="module")
def browser():
    with chromium() as browser:
        yield browser


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """A page with two satellites and two flights, the second one a branch."""
    path = tmp_path_factory.mktemp("page") / "flight.html"
    path.write_text(build_page(synthetic_recording(satellites=2, targets=40, duration=3000.0, tracks=2).encode()))
    return path


def opened(browser, path, where="", **options):
    """A visitor who has opened the page of a file; the page has read its recording."""
    visitor = Visitor(browser, **({"viewport": WIDE} | options))
    visitor.page.goto(f"{path.as_uri()}{where}")
    visitor.page.wait_for_selector("#message[hidden]", state="attached")
    visitor.page.evaluate("window.bskViewer.ready")
    return visitor, visitor.page


def pixels(page):
    """The scene as it is drawn, [height, width, 3]; the origin is the upper left corner of the scene."""
    return np.asarray(Image.open(io.BytesIO(page.locator("#overlay").screenshot())).convert("RGB")).astype(float)


def seek(page, t):
    page.evaluate("t => window.bskViewer.seek(t)", t)
    return page.evaluate(STATE)


def projected(page, place_N):
    """Where the camera of the page sees a point of N, m, in CSS pixels of the scene; computed here."""
    view = page.evaluate(
        """() => { const { stage } = bskViewer.viewer; const { camera, width, height } = stage;
        const { fov, view: { offsetY: up } } = camera;
        return { eye: camera.position.toArray(), world: camera.matrixWorld.elements, fov, width, height, up }; }"""
    )
    axes = np.array(view["world"]).reshape(4, 4).T[:3, :3]
    x, y, z = axes.T @ (np.asarray(place_N) / RADIUS - view["eye"])
    scale = view["height"] / 2.0 / math.tan(math.radians(view["fov"]) / 2.0)
    return view["width"] / 2.0 + scale * x / -z, view["height"] / 2.0 - scale * y / -z - view["up"]


def test_it_opens_without_errors_and_rests(browser, flight):
    visitor, page = opened(browser, flight)
    page.wait_for_timeout(500)
    drawn = page.evaluate(STATE)["drawn"]
    page.wait_for_timeout(700)
    assert not visitor.troubles
    assert page.title() == page.inner_text("#title") == "A synthetic flight"
    assert page.evaluate(STATE)["drawn"] == drawn >= 1  # nothing is drawn while nothing changes


def test_the_earth_is_drawn_again_only_when_it_would_look_different(browser, flight):
    _, page = opened(browser, flight, "#t=600")

    def drawn(change):
        before = page.evaluate("bskViewer.viewer.stage.backdrop.drawn")
        page.evaluate(change)
        return page.evaluate("bskViewer.viewer.stage.backdrop.drawn") - before

    assert drawn("bskViewer.seek(600)") == 0
    assert drawn("bskViewer.seek(604)") == 0  # the Earth has turned by 0.0003 rad, less than a third of a pixel
    assert drawn("for (let t = 604; t < 644; t += 2) bskViewer.seek(t)") in (2, 3, 4)  # of 20 frames
    assert drawn("bskViewer.viewer.turn(0.1, 0); bskViewer.viewer.draw()") == 1
    assert drawn("bskViewer.viewer.stage.detail = 0.5; bskViewer.viewer.draw()") == 1
    assert drawn("bskViewer.viewer.show.targets = false; bskViewer.viewer.draw()") == 0


@pytest.mark.parametrize("time", [0.0, 90.0, 1234.5, 2990.0])
def test_a_satellite_is_where_its_orbit_is(browser, flight, time):
    _, page = opened(browser, flight)
    shown = seek(page, time)["satellites"]
    expected = [projected(page, states(k, np.array([time]))[0][0]) for k in range(2)]
    assert [(spot["x"], spot["y"]) for spot in shown] == [pytest.approx(place, abs=1.0) for place in expected]


def test_pixels_show_the_selected_satellite_over_its_sub_point(browser, flight):
    _, page = opened(browser, flight)
    page.evaluate("bskViewer.viewer.stage.face(bskViewer.viewer.track, 0, 600)")
    spot = seek(page, 600.0)["satellites"][0]
    assert spot["visible"]
    picture = pixels(page)
    x, y = round(spot["x"]), round(spot["y"])
    around = picture[y - 5 : y + 6, x - 5 : x + 6]
    assert around.max() > 150.0  # its body is bright
    r_N, _ = states(0, np.array([600.0]))
    below = projected(page, RADIUS * r_N[0] / np.linalg.norm(r_N))
    shown = page.evaluate(STATE)["below"][0]
    assert (shown["x"], shown["y"]) == pytest.approx(below, abs=1.0)


def test_the_terminator_is_where_the_sun_says(browser, flight):
    _, page = opened(browser, flight)
    page.evaluate(
        """() => { const v = bskViewer.viewer; v.stage.control.azimuth = Math.PI / 2; v.stage.control.elevation = 0.02;
        for (const name in v.show) v.show[name] = false; }"""
    )
    seek(page, 0.0)
    picture = pixels(page)

    def brightness(angle):  # of the ground on the equator, at an angle from the direction of the Sun, seen from the side
        x, y = (round(value) for value in projected(page, RADIUS * np.array([math.cos(angle), math.sin(angle), 0.0])))
        return picture[y - 2 : y + 3, x - 2 : x + 3].mean()

    assert SUN_N.tolist() == [1.0, 0.0, 0.0]
    degrees = np.arange(76, 107, 2)
    shades = np.array([brightness(math.radians(float(degree))) for degree in degrees])
    day, night = shades[:3].mean(), shades[-3:].mean()
    assert day > 2.0 * night
    assert abs(degrees[np.argmin(np.abs(shades - (day + night) / 2.0))] - 90) <= 3


def test_targets_take_the_color_of_what_has_happened(browser, flight):
    _, page = opened(browser, flight)
    times = page.evaluate(
        "Array.from(bskViewer.viewer.stage.layer(bskViewer.viewer.track).targets.points.geometry.attributes.times.array)"
    )
    first = np.array(times).reshape(-1, 3)
    paid = int(np.argmin(first[:, 0]))
    center = page.evaluate(
        """j => { const v = bskViewer.viewer; const p = v.stage.layer(v.track).targets.place(j); v.setFrame("earth");
        v.stage.control.azimuth = Math.atan2(p.y, p.x); v.stage.control.elevation = Math.asin(p.z / p.length());
        for (const name of ["orbits", "instruments", "links", "stations", "labels", "axes"]) v.show[name] = false; }""",
        paid,
    )
    assert center is None

    def color(time):
        seek(page, time)
        spot = page.evaluate("j => bskViewer.state().targets([j])[0]", paid)
        x, y = round(spot["x"]), round(spot["y"])
        return pixels(page)[y - 1 : y + 2, x - 1 : x + 2].mean((0, 1))

    before, after = color(first[paid, 0] - 5.0), color(first[paid, 0] + 5.0)
    assert before[0] > before[2]  # pale yellow
    assert after[1] > 1.3 * after[0]  # green


def test_it_plays_and_pauses(browser, flight):
    visitor, page = opened(browser, flight)
    page.click("#play")
    page.wait_for_timeout(1500)
    assert page.evaluate(STATE)["playing"]
    page.keyboard.press("Escape")
    page.locator("#scrubber").focus()
    page.keyboard.press(" ")
    state = page.evaluate(STATE)
    assert not state["playing"]
    assert state["time"] > 5.0
    page.wait_for_timeout(300)
    assert page.evaluate(STATE)["time"] == state["time"]
    assert not visitor.troubles


def test_slow_frames_are_drawn_with_fewer_pixels_until_it_pauses(browser, flight):
    _, page = opened(browser, flight)
    detail = "bskViewer.viewer.stage.detail"
    assert page.evaluate(detail) == 1
    page.evaluate(
        """() => { const { stage } = bskViewer.viewer; const draw = stage.draw.bind(stage);
        stage.draw = (state) => { draw(state); for (const end = performance.now() + 60; performance.now() < end;); }; }"""
    )
    page.click("#play")
    page.wait_for_function(f"() => {detail} < 0.4", polling=100)
    page.wait_for_timeout(500)
    assert page.evaluate(detail) == pytest.approx(0.36)  # and no less
    page.click("#play")
    assert page.evaluate(detail) == 1


def test_the_earth_hides_satellites_behind_it_and_no_others(browser, flight):
    _, page = opened(browser, flight)
    page.evaluate("for (const name in bskViewer.viewer.show) bskViewer.viewer.show[name] = false")
    layer = "bskViewer.viewer.stage.layer(bskViewer.viewer.track)"
    shown = f"on => {{ for (const mesh of {layer}.crafts.meshes.values()) mesh.visible = on; }}"
    spots = {}  # by whether the second satellite can be seen: time and place of the last such moment on the screen
    for time in range(0, 3000, 100):
        spot = seek(page, float(time))["satellites"][1]
        if 10 < spot["x"] < 900 and 10 < spot["y"] < 500:
            spots[spot["visible"]] = (float(time), round(spot["x"]), round(spot["y"]))

    def changes(time, x, y):  # what the symbol changes around its place, in pixels
        pictures = []
        for on in (True, False):
            page.evaluate(shown, on)
            seek(page, time)
            pictures.append(pixels(page)[y - 4 : y + 5, x - 4 : x + 5])
        return np.abs(pictures[0] - pictures[1]).max()

    assert changes(*spots[True]) > 60.0
    assert changes(*spots[False]) == 0.0


def test_it_stops_at_the_end(browser, flight):
    _, page = opened(browser, flight)
    seek(page, 2995.0)
    page.evaluate("bskViewer.viewer.setSpeed(300)")
    page.click("#play")
    page.wait_for_timeout(1500)
    state = page.evaluate(STATE)
    assert (state["time"], state["playing"]) == (3000.0, False)


def test_the_timeline_is_the_scrubber(browser, flight):
    _, page = opened(browser, flight)
    box = page.locator("#timeline").bounding_box()
    page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + box["height"] - 20)
    page.mouse.down()
    first = page.evaluate(STATE)["time"]
    page.mouse.move(box["x"] + 0.8 * box["width"], box["y"] + box["height"] - 20)
    page.mouse.up()
    second = page.evaluate(STATE)["time"]
    assert 1500.0 < first < 2000.0 < second < 2600.0
    assert page.get_attribute("#scrubber", "aria-valuenow") == str(round(second))


def test_keys(browser, flight):
    _, page = opened(browser, flight)
    page.locator("#scrubber").focus()
    seen = {}
    for key in ("ArrowRight", "ArrowRight", "ArrowLeft", "Shift+ArrowRight", "ArrowDown", "2", "m", "h", "g", "c", "End", "Home"):
        page.keyboard.press(key)
        page.wait_for_timeout(60)
        state = page.evaluate(STATE)
        seen[key] = (state["time"], state["satellite"], state["track"], state["view"], state["comparing"])
    assert seen["ArrowRight"][0] == 600.0
    assert seen["ArrowLeft"][0] == 300.0
    assert seen["Shift+ArrowRight"][0] == 310.0
    assert [seen["ArrowDown"][1], seen["2"][2]] == [1, 1]
    assert [seen[key][3] for key in ("m", "h", "g")] == ["map", "hill", "globe"]
    assert seen["c"][4]
    assert [seen["End"][0], seen["Home"][0]] == [3000.0, 0.0]
    page.keyboard.press("?")
    assert page.locator("#help").is_visible()
    assert "next decision" in page.inner_text("#help")


def test_the_panel_says_what_was_allowed_and_why_a_satellite_died(browser, flight):
    _, page = opened(browser, flight, "#track=1")
    seek(page, 1300.0)
    table = page.locator(".decision table")
    masked = table.locator("tr.masked")
    assert table.locator("tr.chosen").count() == 1
    page.evaluate("bskViewer.viewer.select(1)")
    seek(page, 10.0)
    assert masked.count() == 1
    assert "downlink" in masked.inner_text()
    page.click(".link")
    state = page.evaluate(STATE)
    assert (state["satellite"], state["time"]) == (0, 3000.0)
    assert state["satellites"][0]["visible"]  # the camera has turned to it
    page.wait_for_selector(".dead")
    assert "battery" in page.inner_text(".dead")


def test_compared_flights_are_drawn_together(browser, flight):
    visitor, page = opened(browser, flight)
    page.add_style_tag(content="#scrubber { height: 130px; }")  # with more lanes too, so that the scene keeps its size
    seek(page, 1500.0)
    alone = pixels(page)
    page.click("#compare")
    seek(page, 1500.0)
    together = pixels(page)
    assert np.abs(alone - together).max() > 60.0
    lanes = page.evaluate("bskViewer.viewer.timeline.lanes.map(lane => lane.name ?? '')")
    assert lanes[:3] == ["Sat0", "Sat1", "2: branch 0"]  # decisions of the other flight are below those of the shown one
    page.select_option("#tracks select", "1")
    assert page.evaluate(STATE)["track"] == 1
    assert not visitor.troubles


def test_episodes_of_other_seeds_are_drawn_side_by_side(browser, tmp_path):
    recording = synthetic_recording(tracks=3)
    recording.scenes.extend([recording.scenes[0]] * 2)
    for k, track in enumerate(recording.tracks):
        object.__setattr__(track, "scene", k)
    path = tmp_path / "episodes.html"
    path.write_text(build_page(recording.encode()))
    visitor, page = opened(browser, path, "#t=700&compare=1")
    assert page.evaluate("bskViewer.viewer.stage.views.map(view => [view.x > 0, view.y > 0])") == [
        [False, False],
        [True, False],
        [False, True],
    ]
    picture = pixels(page)
    height, width, _ = picture.shape
    assert picture[: height // 2, : width // 2].std() > 5.0
    assert picture[: height // 2, width // 2 :].std() > 5.0
    assert not visitor.troubles


@pytest.mark.parametrize("view", ["map", "hill"])
def test_other_views_draw(browser, flight, view):
    visitor, page = opened(browser, flight, f"#view={view}&t=700")
    page.wait_for_timeout(200)
    assert pixels(page).std() > 5.0
    assert not visitor.troubles


def test_the_map_has_satellites_over_their_sub_points(browser, flight):
    _, page = opened(browser, flight, "#view=map")
    seek(page, 700.0)
    r_N, _ = states(0, np.array([700.0]))
    angle = 0.5 + 7.2921159e-5 * 700.0
    longitude = math.remainder(math.atan2(r_N[0, 1], r_N[0, 0]) - angle, 2.0 * math.pi)
    latitude = math.asin(r_N[0, 2] / np.linalg.norm(r_N))
    left, top, width, height = page.evaluate(
        "(({ left, top, width, height }) => [left, top, width, height])(bskViewer.viewer.map)"
    )
    x, y = left + (longitude / (2.0 * math.pi) + 0.5) * width, top + (0.5 - latitude / math.pi) * height
    spot = pixels(page)[round(y) - 1 : round(y) + 2, round(x) - 1 : round(x) + 2].mean((0, 1))
    assert spot[1] > 130.0  # the selected satellite images, green
    assert spot[1] > spot[0] + 40.0


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("screen", [NARROW, WIDE], ids=["narrow", "wide"])
def test_it_fits_the_screen_and_can_be_read(browser, flight, screen, scheme):
    visitor, page = opened(browser, flight, "#t=700", viewport=screen, color_scheme=scheme)
    page.click("details.panel summary")
    assert page.evaluate(WIDER_THAN_SCREEN) <= 0
    ratio, text = page.evaluate(CONTRAST)
    assert ratio >= 4.5, text
    boxes = [page.locator(name).bounding_box() for name in ("#top", "#stage", "footer", "#panels")]
    assert all(box["x"] >= 0 and box["x"] + box["width"] <= screen["width"] + 1 for box in boxes)
    assert not visitor.troubles


def test_reduced_motion_stops_flashes_and_animations(browser, flight):
    _, page = opened(browser, flight, reduced_motion="reduce")
    page.click("#play")
    page.wait_for_timeout(400)
    assert page.evaluate("bskViewer.viewer.flash") == 0
    assert page.evaluate("getComputedStyle(document.querySelector('.gauge .bar i')).transitionDuration") == "0s"


def test_controls_have_names_and_the_focus_is_seen(browser, flight):
    visitor, page = opened(browser, flight)
    controls = "[...document.querySelectorAll('button, select, input')]"
    nameless = f"{controls}.filter(e => !(e.ariaLabel || e.textContent.trim() || e.closest('label')))"
    assert page.evaluate(f"{nameless}.length") == 0
    seen = []
    for _ in range(12):
        page.keyboard.press("Tab")
        seen.append(visitor.focus_is_visible())
    assert all(seen)


def test_names_stay_text(browser, tmp_path):
    recording = synthetic_recording(name=SCRIPT)
    for track in recording.tracks:
        object.__setattr__(track, "label", f"{SCRIPT}<img src=x onerror=hacked=1>")
    for name in ("title", "preset", "policy"):
        object.__setattr__(recording, name, SCRIPT)
    path = tmp_path / "named.html"
    path.write_text(build_page(recording.encode()))
    visitor, page = opened(browser, path, "#t=700&compare=1")
    for view in ("map", "hill", "globe"):
        page.click(f"[data-view={view}]")
    page.wait_for_timeout(300)
    assert page.evaluate("[typeof hacked, document.querySelectorAll('main script, header img, aside script').length]") == [
        "undefined",
        0,
    ]
    assert SCRIPT in page.inner_text("#title")
    assert SCRIPT in page.locator(".pick select").inner_text()
    assert not visitor.troubles


def broken(browser, tmp_path, content):
    """What the page says about the bytes of a recording that it cannot show."""
    path = tmp_path / "broken.html"
    path.write_text(build_page(content))
    visitor = Visitor(browser, viewport=WIDE)
    visitor.page.goto(path.as_uri())
    visitor.page.wait_for_function("() => !document.getElementById('message').textContent.startsWith('Loading')", polling=100)
    assert not visitor.troubles
    return visitor.page.inner_text("#message")


def test_a_recording_that_is_cut_off_is_named(browser, tmp_path):
    content = synthetic_recording().encode()
    assert "cut off" in broken(browser, tmp_path, content[: len(content) // 2])
    assert "cut off" in broken(browser, tmp_path, gzip.compress(gzip.decompress(content)[:-64]))


def test_another_version_and_other_files_are_named(browser, tmp_path):
    raw = gzip.decompress(synthetic_recording().encode())
    said = broken(browser, tmp_path, gzip.compress(raw[:8] + struct.pack("<I", 7) + raw[12:]))
    assert "version 7" in said
    assert "version 1" in said
    assert "no recording" in broken(browser, tmp_path, b"PK\x03\x04 something else")
    assert "no recording" in broken(browser, tmp_path, gzip.compress(b"something else that is long enough"))
