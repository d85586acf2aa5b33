"""Local server of the viewer: the page, its recording, and futures that are flown on request.

It answers the own machine only, unless another host is asked for. Others may use either, so every request needs a random token:
the printed address has it, and the page sends it along (``Authorization: Bearer``). Requests of other pages are rejected by their
``Host`` and ``Origin``, and no page may show this one in a frame. A connection has :data:`TIME` to send its request.
"""

from __future__ import annotations

import errno
import hmac
import json
import logging
import re
import secrets
import socket
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, NamedTuple
from urllib.parse import parse_qs, urlsplit

from bsk_torch._checks import whole
from bsk_torch.files import finite
from bsk_torch.recording.recording import Recording
from bsk_torch.untrusted import Json, parse_json
from bsk_torch.viewer.futures import Futures
from bsk_torch.viewer.page import build_page

__all__ = ["PORT", "serve"]

logger = logging.getLogger(__name__)

PORT = 8765
"""Port of the server, or the first free one of the next :data:`TRIED`."""

TRIED = 50
"""How many ports are tried."""

LOOPBACK = ("127.0.0.1", "localhost", "::1")
"""Hosts that only the own machine reaches."""

LOCAL = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:\d+)?")
"""How browsers name them, with the port."""

MOST = 10_000
"""Longest body of a request, bytes."""

TIME = 30.0
"""Longest time from connecting to the end of a request, and longest time in which a client takes an answer, s."""

CONNECTIONS = 64
"""Most connections whose requests are not complete; a further one ends the oldest."""

FLIGHTS = 24
"""Most flights kept; older ones are dropped, but for the first."""

API = "/api"
"""Where the page asks."""

HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}
"""What every answer says to browsers; the page has the rest of its content security policy itself."""


class _RejectedError(Exception):
    """A request that is not answered, with its status."""

    def __init__(self, status: HTTPStatus, message: str) -> None:
        super().__init__(message)
        self.status = status


class _Answer(NamedTuple):
    """Type and content of an answer, and of a recording the numbers of its flights."""

    kind: str
    content: bytes
    flights: str | None = None


class Server(ThreadingHTTPServer):
    """The server; see :func:`serve`."""

    daemon_threads = True
    request_queue_size = CONNECTIONS

    def __init__(self, address: tuple[str, int], source: Futures | Recording) -> None:
        """Listen at an address."""
        super().__init__(address, _Handler)
        self.source, self.lock = source, threading.Lock()
        self.local = address[0] in LOOPBACK
        self.token = secrets.token_urlsafe(24)
        self.reading: dict[object, float] = {}
        """When connections whose requests are not complete end, the oldest first."""

    @property
    def port(self) -> int:
        """Port on which it listens."""
        return int(self.server_address[1])

    @property
    def url(self) -> str:
        """Address for the browser."""
        host = str(self.server_address[0])
        return f"http://{host}:{self.port}/?token={self.token}"

    def recording(self) -> bytes:
        """Return all flights that are kept; called with the lock."""
        return (self.source if isinstance(self.source, Recording) else self.source.recording()).encode()

    def process_request(self, request: Any, client_address: object) -> None:
        """Read and answer a request in its own thread."""
        if len(self.reading) >= CONNECTIONS:
            self._end(next(iter(self.reading)))
        self.reading[request] = time.monotonic() + TIME
        super().process_request(request, client_address)

    def service_actions(self) -> None:
        """End connections whose time is over; called twice a second."""
        now = time.monotonic()
        for request, end in list(self.reading.items()):
            if end < now:
                self._end(request)

    def shutdown_request(self, request: Any) -> None:
        """Close a connection."""
        self.reading.pop(request, None)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: object) -> None:
        """Print nothing about clients that vanish."""
        if not isinstance(sys.exc_info()[1], OSError):
            super().handle_error(request, client_address)

    def _end(self, request: Any) -> None:
        self.reading.pop(request, None)
        with suppress(OSError):
            request.shutdown(socket.SHUT_RDWR)  # its thread finds that nothing more comes


class _Handler(BaseHTTPRequestHandler):
    server: Server
    timeout = TIME

    def do_GET(self) -> None:
        """Answer with the page or the recording."""
        self._answer({"/": self._page, f"{API}/recording": self._recording})

    def do_POST(self) -> None:
        """Answer with a future."""
        self._answer({f"{API}/{name}": getattr(self, f"_{name}") for name in ("values", "branch", "episode")})

    def _page(self) -> _Answer:
        live = isinstance(self.server.source, Futures)
        with self.server.lock:
            page = build_page(None, API) if live else build_page(self.server.recording())
        return _Answer("text/html; charset=utf-8", page.encode())

    def _recording(self) -> _Answer:
        with self.server.lock:
            return self._flights()

    def _flights(self) -> _Answer:
        """All flights that are kept, and the numbers by which requests name them; called with the lock."""
        source = self.server.source
        numbers = range(len(source.tracks)) if isinstance(source, Recording) else source.flown
        return _Answer("application/octet-stream", self.server.recording(), ",".join(map(str, numbers)))

    def _values(self) -> _Answer:
        track, decision = self._numbers("track", "decision")
        with self.server.lock:
            values = self._futures().values(track, decision)
        return _Answer("application/json", json.dumps({"action_value": finite(values), "how": self._futures().meaning}).encode())

    def _branch(self) -> _Answer:
        track, decision, action = self._numbers("track", "decision", "action")
        with self.server.lock:
            futures = self._futures()
            futures.branch(track, decision, action)
            futures.drop_old(FLIGHTS)
            return self._flights()

    def _episode(self) -> _Answer:
        body = self._body()
        with self.server.lock:
            futures = self._futures()
            following = max((scene.seed for scene in futures.scenes.values()), default=-1) + 1
            seed = body.get("seed")
            futures.episode(following if seed is None else whole("seed", seed, 0, 2**62))
            futures.drop_old(FLIGHTS)
            return self._flights()

    def _futures(self) -> Futures:
        if isinstance(self.server.source, Recording):
            raise ValueError("a recording has no other futures; start bsk-torch view with a preset or a run")
        return self.server.source

    def _numbers(self, *names: str) -> list[int]:
        body = self._body()
        return [whole(name, body.get(name), 0) for name in names]

    def _body(self) -> dict[str, object]:
        if self.headers.get_content_type() != "application/json":
            raise _RejectedError(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "the request must be application/json")
        length = self.headers.get("Content-Length", "")
        if not re.fullmatch("[0-9]{1,18}", length):
            raise _RejectedError(HTTPStatus.LENGTH_REQUIRED, "the request needs a Content-Length")
        if int(length) > MOST:
            self.close_connection = True
            raise _RejectedError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"the request has {length} bytes; the most are {MOST}")
        try:
            body = parse_json(self.rfile.read(int(length)), dict[str, Json])
        except ValueError as error:
            raise ValueError(f"the request must be a JSON object: {error}") from None
        self._has_come()
        return body

    def _check(self) -> None:
        """Reject requests that do not come from the page."""
        host = self.headers.get("Host", "")
        if self.server.local and not LOCAL.fullmatch(host):
            raise _RejectedError(HTTPStatus.FORBIDDEN, f"Host {host!r} is not this machine")
        origin = self.headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc != host:
            raise _RejectedError(HTTPStatus.FORBIDDEN, f"Origin {origin!r} is another page")
        header = self.headers.get("Authorization", "").removeprefix("Bearer ")
        token = header or parse_qs(urlsplit(self.path).query).get("token", [""])[0]
        if not hmac.compare_digest(token.encode(), self.server.token.encode()):
            raise _RejectedError(HTTPStatus.FORBIDDEN, "the address needs the token that bsk-torch view printed")

    def _answer(self, answers: Mapping[str, Callable[[], _Answer]]) -> None:
        try:
            self._check()
            path = urlsplit(self.path).path
            if path not in answers:
                raise _RejectedError(HTTPStatus.NOT_FOUND, f"there is nothing at {path!r}")
            if self.command == "GET":
                self._has_come()
            answer = answers[path]()
            try:
                self._send(HTTPStatus.OK, answer)
            except OSError:
                logger.info("a page was closed before its answer was complete")
        except _RejectedError as error:
            self._fail(error.status, error)
        except (IndexError, ValueError) as error:
            self._fail(HTTPStatus.BAD_REQUEST, error)

    def _fail(self, status: HTTPStatus, error: Exception) -> None:
        self._send(status, _Answer("application/json", json.dumps({"error": str(error)}).encode()))

    def _has_come(self) -> None:
        """Take the connection off the clock: its request is complete and has the token, and answers may take long."""
        self.server.reading.pop(self.connection, None)

    def _send(self, status: HTTPStatus, answer: _Answer) -> None:
        self.send_response(status)
        headers = {"Content-Type": answer.kind, "Content-Length": str(len(answer.content)), **HEADERS}
        for name, value in headers.items():
            self.send_header(name, value)
        if answer.flights is not None:
            self.send_header("X-Flights", answer.flights)
        self.end_headers()
        self.wfile.write(answer.content)

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing for requests."""


def serve(source: Futures | Recording, host: str = "127.0.0.1", port: int = PORT) -> Server:
    """Return a server that listens; ``serve_forever()`` answers requests that have the token of :attr:`Server.url`.

    Args:
        source: The flights, to which requests add futures, or a recording, to which nothing is added.
        host: Address to listen at.
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
