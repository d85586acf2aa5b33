"""bsk-torch view and bsk-torch export."""

import json
import re
import stat
import webbrowser
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import url2pathname

import pytest
from typer.testing import CliRunner

from bsk_torch.cli import app
from bsk_torch.viewer.recording import load
from bsk_torch.viewer.server import Server
from tests.support.recordings import synthetic_recording


def run(*arguments):
    return CliRunner().invoke(app, [*map(str, arguments)])


def test_preset_becomes_page_recording_and_czml(tmp_path):
    flight = tmp_path / "flight.bskview"
    made = run("view", "NadirScan-v1", "--policy", "rule", "--time-limit", 1200, "--branch", "1:1", "--out", flight)
    assert made.exit_code == 0, made.output
    assert len(load(flight).tracks) == 2
    for name in ("flight.html", "flight.czml"):
        made = run("export", flight, "--out", tmp_path / name)
        assert made.exit_code == 0, made.output
    assert "NadirScan-v1, rule, seed 0" in (tmp_path / "flight.html").read_text()
    assert json.loads((tmp_path / "flight.czml").read_text())[0]["id"] == "document"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("NadirScan-v2", "--out", "x.html"), "'NadirScan-v2' is neither a preset"),
        (("NadirScan-v1", "--out", "x.htm"), "must end with .html, .bskview"),
        (("NadirScan-v1", "--branch", "one", "--out", "x.html"), "must be DECISION:ACTION"),
        (("HeteroCluster-v1", "--out", "x.html"), "HeteroCluster-v1"),
        (("cut.bskview", "--out", "x.html"), "cut off"),
        (("nowhere.bskview", "--out", "x.html"), "'nowhere.bskview': No such file or directory"),
        (("flight.bskview", "--policy", "rule", "--out", "x.html"), "is a recording"),
    ],
)
def test_bad_input(arguments, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    content = synthetic_recording().encode()
    (tmp_path / "flight.bskview").write_bytes(content)
    (tmp_path / "cut.bskview").write_bytes(content[: len(content) // 2])
    result = run("export", *arguments)
    assert result.exit_code == 1
    assert message in " ".join(result.output.split())
    assert not (tmp_path / "x.html").exists()


def test_the_browser_is_opened_by_a_private_page(tmp_path, monkeypatch):
    """The address has the token, and all users of a machine see the arguments of its programs."""
    opened = []

    def browse(address):
        page = Path(url2pathname(urlsplit(address).path))
        opened.append((address, page.read_text(), stat.S_IMODE(page.parent.stat().st_mode)))

    monkeypatch.setattr(webbrowser, "open", browse)
    monkeypatch.setattr(Server, "serve_forever", lambda server: None)
    (tmp_path / "flight.bskview").write_bytes(synthetic_recording().encode())
    output = run("view", tmp_path / "flight.bskview", "--port", 18965).output
    ((address, page, mode),) = opened
    (url,) = re.findall(r"http://127\.0\.0\.1:\d+/\?token=\S{32}", output)
    assert url in page
    assert "token" not in address
    assert mode == 0o700
    assert "no browser was found" in output
