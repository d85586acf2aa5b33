"""``bsk-torch film``."""

import pytest
from PIL import Image

pytestmark = pytest.mark.compiled

SHORT = ("--time-limit", "300", "--height", "120")


@pytest.mark.parametrize("kind", ["gif", "webp"])
def test_films_have_a_frame_for_the_start_and_each_decision(run, tmp_path, kind):
    out = tmp_path / f"film.{kind}"
    result = run("film", "random", "--seed", 3, *SHORT, "--out", out, "--fps", 10)
    assert result.exit_code == 0, result.output
    with Image.open(out) as film:
        assert film.size == (160, 120)
        assert film.info.get("duration", 100) == 100  # which Pillow reads of GIF files
        shown = film.n_frames
    assert f"{out}: {shown} frames, 300 s of NadirScan-v1, return " in result.output
    assert "satellites lost: 0" in result.output
    assert 3 <= shown <= 6  # decisions of 60, 120 and 180 s


def test_films_end_early_where_asked(run, tmp_path):
    out = tmp_path / "film.gif"
    result = run("film", "rule", *SHORT, "--until", 100, "--out", out)
    assert result.exit_code == 0, result.output
    with Image.open(out) as film:
        assert film.n_frames == 2


def test_constellations_are_filmed_between_their_decisions(run, tmp_path):
    pytest.importorskip("moviepy", reason="needs the extra video")
    out = tmp_path / "film.mp4"
    frames = ("--preset", "RelayConstellation-v1", "--every", 10, "--until", 40, "--height", "120")
    result = run("film", "random", *frames, "--out", out)
    assert result.exit_code == 0, result.output
    assert f"{out}: 6 frames, 41 s of RelayConstellation-v1" in result.output  # one after a task of a second
    assert out.read_bytes()[4:8] == b"ftyp"
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]


@pytest.mark.parametrize("kind", ["png", "svg", "pdf"])
def test_an_episode_is_drawn_as_one_picture(run, tmp_path, kind):
    out = tmp_path / f"episode.{kind}"
    result = run("film", "pretrained", "--preset", "NadirScan-v1", "--time-limit", "300", "--out", out)
    assert result.exit_code == 0, result.output
    assert out.read_bytes()[:5] == {"png": b"\x89PNG\r", "svg": b"<?xml", "pdf": b"%PDF-"}[kind]
    assert f"{out}: the whole episode, 300 s of NadirScan-v1" in result.output


def test_planners_are_filmed(run, tmp_path):
    out = tmp_path / "film.gif"
    plan = ("--plan", "horizon=60", "--plan", "base=rule")
    result = run("film", "plan:rollout", "--preset", "NadirScan-v1", *plan, *SHORT, "--until", 60, "--out", out)
    assert result.exit_code == 0, result.output
    assert out.is_file()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--out", "film.avi"), "--out 'film.avi' must end with .gif, .webp, .mp4, .png, .svg or .pdf"),
        (("--every", "20"), "--every 20 is for constellations"),
        (("--height", "121"), "height=121 must be an even number of pixels"),
        (("--out", "nowhere/film.gif"), "there is no folder 'nowhere'"),
    ],
)
def test_mistakes_are_named(run, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    result = run("film", "rule", "--time-limit", "300", *arguments)
    assert result.exit_code == 1, result.output
    assert message in result.output
    assert len(result.output.splitlines()) == 1
    assert not list(tmp_path.iterdir())
