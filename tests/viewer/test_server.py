"""The local server: what it answers, and whom it refuses."""

import http.client
import json
import shutil
import socket
import subprocess
import threading
import time
from contextlib import suppress
from pathlib import Path
from urllib.parse import quote

import pytest

import bsk_torch
from bsk_torch.recording.recording import decode
from bsk_torch.rl.policies.shared_policy import rule
from bsk_torch.viewer import server as module
from bsk_torch.viewer.futures import Futures
from bsk_torch.viewer.server import CONNECTIONS, MOST, serve
from tests.support.recordings import synthetic_recording


def running(source, **options):
    server = serve(source, port=18765, **options)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return server


@pytest.fixture(scope="module")
def live():
    env = bsk_torch.make("NadirScan-v1", num_envs=1, env_ids=[0], time_limit=1200.0)
    futures = Futures(env, rule("rule", env), preset="NadirScan-v1", label="rule")
    futures.episode(0)
    server = running(futures)
    yield server
    server.shutdown()
    server.server_close()


def ask(server, method, path, body=None, token=None, **headers):
    """Status and content of an answer; ``ask.headers`` are its headers."""
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=60)
    content = body if body is None or isinstance(body, bytes) else json.dumps(body).encode()
    kinds = {"Content-Type": "application/json"} if body is not None else {}
    authorization = f"Bearer {server.token if token is None else token}"
    connection.request(method, path, content, {"Authorization": authorization, **kinds, **headers})
    answer = connection.getresponse()
    ask.headers = answer.headers
    return answer.status, answer.read()


def test_page_and_recording(live):
    status, page = ask(live, "GET", "/")
    assert status == 200
    assert page.startswith(b"<!")
    status, content = ask(live, "GET", "/api/recording")
    assert status == 200
    assert decode(content).preset == "NadirScan-v1"


def test_values_branch_and_episode(live):
    status, content = ask(live, "POST", "/api/values", {"track": 0, "decision": 1})
    assert status == 200
    assert len(json.loads(content)["action_value"]) == 4
    assert "the policy decides afterwards" in json.loads(content)["how"]
    before = len(decode(ask(live, "GET", "/api/recording")[1]).tracks)
    status, content = ask(live, "POST", "/api/branch", {"track": 0, "decision": 1, "action": 1})
    assert status == 200
    assert decode(content).tracks[before].branch.action == 1
    status, content = ask(live, "POST", "/api/episode", {"seed": 7})
    assert status == 200
    assert decode(content).scenes[-1].seed == 7


@pytest.mark.parametrize(
    ("headers", "part"),
    [
        ({"Host": "evil.example"}, "is not this machine"),
        ({"Host": "evil\\@127.0.0.1"}, "is not this machine"),
        ({"Host": "[::1"}, "is not this machine"),
        ({"Origin": "http://evil.example"}, "is another page"),
    ],
)
def test_other_pages_are_refused(live, headers, part):
    status, content = ask(live, "GET", "/api/recording", **headers)
    assert status == 403
    assert part in json.loads(content)["error"]


@pytest.mark.parametrize(
    ("body", "status", "part"),
    [
        (b"{", 400, "Invalid JSON"),
        (b"[" * 9000, 400, "must be a JSON object"),
        (b"[]", 400, "must be a JSON object"),
        ({"track": 0}, 400, "decision=None must be a whole number"),
        ({"track": 0, "decision": "<script>"}, 400, "must be a whole number"),
        ({"track": 0, "decision": 10**9}, 400, "must lie from 0"),
        (b" " * (MOST + 1), 413, "the most are"),
    ],
)
def test_bad_requests_are_refused(live, body, status, part):
    found, content = ask(live, "POST", "/api/values", body)
    assert found == status
    assert part in json.loads(content)["error"]


def test_other_paths_and_types_are_refused(live):
    assert ask(live, "GET", "/../pyproject.toml")[0] == 404
    assert ask(live, "POST", "/api/values", {"track": 0}, **{"Content-Type": "text/plain"})[0] == 415


@pytest.fixture(params=["127.0.0.1", "0.0.0.0"])
def quiet(request):
    """A server of a recording, for the own machine or for all."""
    server = running(synthetic_recording(), host=request.param)
    yield server
    server.shutdown()
    server.server_close()


def test_every_request_needs_the_token(quiet):
    assert quiet.url.endswith(f"/?token={quiet.token}")
    for path in ("/", "/api/recording"):
        for token, status in (("", 403), ("wrong", 403), ("wr\xf6ng", 403), (quiet.token, 200)):
            assert ask(quiet, "GET", path, token=token)[0] == status
            assert ask(quiet, "GET", f"{path}?token={quote(token)}", token="")[0] == status
    assert ask(quiet, "POST", "/api/values", {"track": 0, "decision": 0}, token="")[0] == 403


def test_no_answer_may_be_framed(quiet):
    for token in ("", quiet.token):
        ask(quiet, "GET", "/", token=token)
        assert ask.headers["Content-Security-Policy"] == "frame-ancestors 'none'"
        assert ask.headers["X-Frame-Options"] == "DENY"


def sent(server, content):
    """A connection that has sent something."""
    connection = socket.create_connection(("127.0.0.1", server.port), timeout=20)
    connection.sendall(content)
    return connection


def test_idle_connections_give_way_and_end_their_threads(quiet):
    before = threading.active_count()
    idle = [sent(quiet, b"GET / HT") for _ in range(5 * CONNECTIONS)]
    assert ask(quiet, "GET", "/api/recording")[0] == 200
    assert idle[0].recv(1) == b""
    assert within_seconds(5.0, lambda: threading.active_count() - before <= CONNECTIONS)
    for connection in idle:
        connection.close()
    assert within_seconds(5.0, lambda: threading.active_count() <= before)


def within_seconds(seconds, holds):
    end = time.monotonic() + seconds
    while not holds() and time.monotonic() < end:
        time.sleep(0.02)
    return holds()


@pytest.mark.parametrize("start", ["GET / HT", "POST /api/values HTTP/1.1\r\nContent-Type: application/json\r\n{}\r\n\r\n{{"])
def test_a_request_has_a_limited_time_however_it_drips(quiet, monkeypatch, start):
    monkeypatch.setattr(module, "TIME", 1.0)
    head = f"Host: 127.0.0.1\r\nAuthorization: Bearer {quiet.token}\r\nContent-Length: 900"
    connection, ended = sent(quiet, start.format(head).encode()), False
    connection.settimeout(0.1)
    for _ in range(100):
        with suppress(TimeoutError, ConnectionError):
            connection.sendall(b" ")
            ended = connection.recv(1) == b""
        if ended:
            break
    assert ended


def test_a_page_closed_during_its_answer_is_said_in_one_line(live, capfd, caplog):
    caplog.set_level("INFO", logger="bsk_torch")
    body = json.dumps({"track": 0, "decision": 1}).encode()
    head = (
        f"Host: 127.0.0.1\r\nAuthorization: Bearer {live.token}\r\nContent-Type: application/json\r\nContent-Length: {len(body)}"
    )
    for lingers in (b"\x01\0\0\0\0\0\0\0", None):  # reset, or closed
        connection = sent(live, f"POST /api/values HTTP/1.1\r\n{head}\r\n\r\n".encode() + body)
        if lingers:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, lingers)
        connection.close()
    assert ask(live, "POST", "/api/values", {"track": 0, "decision": 1})[0] == 200  # after those of the closed pages
    assert within_seconds(5.0, lambda: caplog.messages)
    assert set(caplog.messages) == {"a page was closed before its answer was complete"}
    assert capfd.readouterr() == ("", "")


def test_old_flights_are_dropped_and_keep_their_numbers(live, monkeypatch):
    monkeypatch.setattr(module, "FLIGHTS", 3)
    flown = live.source.flown
    for _ in range(5):
        newest = max(flown)
        status, content = ask(live, "POST", "/api/branch", {"track": newest, "decision": 1, "action": 1})
        assert status == 200
        assert ask.headers["X-Flights"] == ",".join(map(str, flown))
        assert list(flown) == sorted({0, newest, newest + 1})
        tracks = decode(content).tracks
        assert [track.label for track in tracks] == [one.track.label for one in flown.values()]
        assert tracks[-1].parent == list(flown).index(newest)
    status, content = ask(live, "POST", "/api/branch", {"track": newest - 1, "decision": 1, "action": 1})
    assert status == 400
    assert f"track={newest - 1} must be one of the flights 0, " in json.loads(content)["error"]


def test_recording_has_no_other_futures_and_the_next_free_port(live):
    server = running(synthetic_recording())
    try:
        assert server.port > live.port
        status, content = ask(server, "POST", "/api/branch", {"track": 0, "decision": 0, "action": 0})
        assert status == 400
        assert "no other futures" in json.loads(content)["error"]
    finally:
        server.shutdown()
        server.server_close()


ASKS = """
const [address, search, source] = process.argv.slice(2);
globalThis.window = { location: { search } };
const { Live } = await import(`data:text/javascript,${encodeURIComponent(source)}`);
const live = new Live(`${address}/api`);
const found = [];
for (const ask of [() => live.recording(), () => live.branch(live.numbers.length - 1, 1, 1), () => live.values(0, 1)]) {
  const answer = await ask().catch((error) => error.message);
  found.push(answer.how ?? (answer.length < 200 ? answer : [...live.numbers]));
}
console.log(JSON.stringify(found));
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node")
def test_the_page_sends_the_token_and_the_numbers_of_flights(live, tmp_path):
    (tmp_path / "asks.mjs").write_text(ASKS)
    source = Path(module.__file__).with_name("page").joinpath("live.js").read_text()
    before = list(live.source.flown)
    for search in (f"?token={live.token}", "?token=wrong"):
        command = ["node", tmp_path / "asks.mjs", live.url.partition("/?")[0], search, source]
        found = json.loads(subprocess.run(command, check=True, capture_output=True, text=True, timeout=100).stdout)
        if search.endswith("wrong"):
            assert found == ["the address needs the token that bsk-torch view printed"] * 3
        else:
            assert found[0] == before
            assert found[1] == [*before, before[-1] + 1] == list(live.source.flown)
            assert live.source.flown[before[-1] + 1].track.parent == before[-1]
            assert "the policy decides afterwards" in found[2]
