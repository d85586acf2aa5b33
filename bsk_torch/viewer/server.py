"""Local server of the viewer: the page, its recording, and futures that are flown on request.

It answers the own machine only, unless another host is asked for; then every request needs a random token, which is part of the
printed address. Requests of other pages are rejected by their ``Host`` and ``Origin``.
"""

from __future__ import annotations

import errno
import hmac
import json
import secrets
import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, urlsplit

from bsk_torch._checks import whole
from bsk_torch.untrusted import Json, parse_json
from bsk_torch.viewer.futures import Futures, finite
from bsk_torch.viewer.page import build_page
from bsk_torch.viewer.recording import Recording

__all__ = ["PORT", "serve"]

PORT = 8765
"""Port of the server, or the first free one of the next :data:`TRIED`."""

TRIED = 50
"""How many ports are tried."""

LOOPBACK = ("127.0.0.1", "localhost", "::1")
"""Hosts that only the own machine reaches."""

MOST = 10_000
"""Longest body of a request, bytes."""

API = "/api"
"""Where the page asks."""


class _RejectedError(Exception):
    """A request that is not answered, with its status."""

    def __init__(self, status: HTTPStatus, message: str) -> None:
        super().__init__(message)
        self.status = status


class Server(ThreadingHTTPServer):
    """The server; see :func:`serve`."""

    daemon_threads = True

    def __init__(self, address: tuple[str, int], source: Futures | Recording) -> None:
        """Listen at an address."""
        super().__init__(address, _Handler)
        self.source, self.lock = source, threading.Lock()
        self.local = address[0] in LOOPBACK
        self.token = "" if self.local else secrets.token_urlsafe(24)

    @property
    def port(self) -> int:
        """Port on which it listens."""
        return int(self.server_address[1])

    @property
    def url(self) -> str:
        """Address for the browser."""
        host = str(self.server_address[0])
        return f"http://{host}:{self.port}/{f'?token={self.token}' if self.token else ''}"

    def recording(self) -> bytes:
        """Return all flights so far; called with the lock."""
        found = self.source if isinstance(self.source, Recording) else self.source.recording()
        return found.encode()


class _Handler(BaseHTTPRequestHandler):
    server: Server
    timeout = 30  # of a silent client

    def do_GET(self) -> None:
        """Answer with the page or the recording."""
        self._answer({"/": self._page, f"{API}/recording": self._recording})

    def do_POST(self) -> None:
        """Answer with a future."""
        self._answer({f"{API}/{name}": getattr(self, f"_{name}") for name in ("values", "branch", "episode")})

    def _page(self) -> tuple[str, bytes]:
        live = isinstance(self.server.source, Futures)
        with self.server.lock:
            page = build_page(None, API) if live else build_page(self.server.recording())
        return "text/html; charset=utf-8", page.encode()

    def _recording(self) -> tuple[str, bytes]:
        with self.server.lock:
            return "application/octet-stream", self.server.recording()

    def _values(self) -> tuple[str, bytes]:
        track, decision = self._numbers("track", "decision")
        with self.server.lock:
            values = self._futures().values(track, decision)
        return "application/json", json.dumps({"action_value": finite(values), "how": self._futures().meaning}).encode()

    def _branch(self) -> tuple[str, bytes]:
        track, decision, action = self._numbers("track", "decision", "action")
        with self.server.lock:
            self._futures().branch(track, decision, action)
            return "application/octet-stream", self.server.recording()

    def _episode(self) -> tuple[str, bytes]:
        body = self._body()
        with self.server.lock:
            futures = self._futures()
            following = max((scene.seed for scene in futures.scenes), default=-1) + 1
            seed = body.get("seed")
            futures.episode(following if seed is None else whole("seed", seed, 0, 2**62))
            return "application/octet-stream", self.server.recording()

    def _futures(self) -> Futures:
        if isinstance(self.server.source, Recording):
            raise ValueError("a recording has no other futures; start bsk-torch view with a preset or a run")
        return self.server.source

    def _numbers(self, *names: str) -> list[int]:
        body = self._body()
        return [whole(name, body.get(name), 0) for name in names]

    def _body(self) -> dict[str, Any]:
        """The JSON object of a request."""
        if self.headers.get_content_type() != "application/json":
            raise _RejectedError(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "the request must be application/json")
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal():
            raise _RejectedError(HTTPStatus.LENGTH_REQUIRED, "the request needs a Content-Length")
        if int(length) > MOST:
            self.close_connection = True
            raise _RejectedError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"the request has {length} bytes; the most are {MOST}")
        try:
            return parse_json(self.rfile.read(int(length)), dict[str, Json])
        except ValueError as error:
            raise ValueError(f"the request must be a JSON object: {error}") from None

    def _check(self) -> None:
        """Reject requests that do not come from the page."""
        host = self.headers.get("Host", "")
        if self.server.local and urlsplit(f"//{host}").hostname not in LOOPBACK:
            raise _RejectedError(HTTPStatus.FORBIDDEN, f"Host {host!r} is not this machine")
        origin = self.headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc != host:
            raise _RejectedError(HTTPStatus.FORBIDDEN, f"Origin {origin!r} is another page")
        if self.server.token:
            given = parse_qs(urlsplit(self.path).query).get("token", [""])[0]
            if not hmac.compare_digest(given.encode(), self.server.token.encode()):
                raise _RejectedError(HTTPStatus.FORBIDDEN, "the address needs the token that bsk-torch view printed")

    def _answer(self, known: dict[str, Any]) -> None:
        try:
            self._check()
            path = urlsplit(self.path).path
            if path not in known:
                raise _RejectedError(HTTPStatus.NOT_FOUND, f"there is nothing at {path!r}")
            kind, content = known[path]()
            self._send(HTTPStatus.OK, kind, content)
        except _RejectedError as error:
            self._fail(error.status, error)
        except (IndexError, ValueError) as error:
            self._fail(HTTPStatus.BAD_REQUEST, error)

    def _fail(self, status: HTTPStatus, error: Exception) -> None:
        self._send(status, "application/json", json.dumps({"error": str(error)}).encode())

    def _send(self, status: HTTPStatus, kind: str, content: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Referrer-Policy", "no-referrer")
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing for requests."""


def serve(source: Futures | Recording, host: str = "127.0.0.1", port: int = PORT) -> Server:
    """Return a server that listens; ``serve_forever()`` answers requests.

    Args:
        source: The flights, to which requests add futures, or a recording, to which nothing is added.
        host: Address to listen at. Others than those of the own machine need a token, which :attr:`Server.url` has.
        port: Port; if it is in use, the next free one.

    Raises:
        OSError: If none of the ports is free, or the host is not one of this machine.
    """
    for number in range(port, min(port + TRIED, 65535)):
        try:
            return Server((host, number), source)
        except OSError as error:
            if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                raise
    raise OSError(f"the ports from {port} to {port + TRIED - 1} are in use; choose another one with --port")
