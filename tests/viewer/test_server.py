"""The local server: what it answers, and whom it refuses."""

import http.client
import json
import threading

import pytest

import bsk_torch
from bsk_torch.rl.policies.shared_policy import rule
from bsk_torch.viewer.futures import Futures
from bsk_torch.viewer.recording import decode
from bsk_torch.viewer.server import MOST, serve
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


def ask(server, method, path, body=None, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=60)
    content = body if body is None or isinstance(body, bytes) else json.dumps(body).encode()
    kinds = {"Content-Type": "application/json"} if body is not None else {}
    connection.request(method, path, content, {**kinds, **headers})
    answer = connection.getresponse()
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
    [({"Host": "evil.example"}, "is not this machine"), ({"Origin": "http://evil.example"}, "is another page")],
)
def test_other_pages_are_refused(live, headers, part):
    status, content = ask(live, "GET", "/api/recording", **headers)
    assert status == 403
    assert part in json.loads(content)["error"]


@pytest.mark.parametrize(
    ("body", "status", "part"),
    [
        (b"{", 400, "Invalid JSON"),
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


def test_other_hosts_need_the_token():
    server = running(synthetic_recording(), host="0.0.0.0")
    try:
        assert "?token=" in server.url
        assert ask(server, "GET", "/api/recording")[0] == 403
        assert ask(server, "GET", "/api/recording?token=wrong")[0] == 403
        assert ask(server, "GET", f"/api/recording?token={server.token}")[0] == 200
    finally:
        server.shutdown()
        server.server_close()


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
