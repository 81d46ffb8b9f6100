"""What stands before viser's server: who comes in, how many, and what they may say.

viser lets in every page of every browser, and binds its checks to nothing that can be passed to it. It serves by
`websockets.asyncio.server.serve`, which takes all that is needed; so that is called with more while viser starts.
"""

import asyncio
import logging
import socket
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from http import HTTPStatus
from typing import Any
from urllib.parse import parse_qs

from websockets.asyncio import server as websockets_server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from ..serving.access import is_addressed, is_own_page, is_secret, names_of
from . import messages
from .control_values import fits
from .uploads import Uploads

MOST_INSIDE = 16  # pages that are open at once
MOST_WAITING = 64  # connections that have not said who they are
MOST_FRAMES = 4  # of one page, read but not yet acted on
A_SECOND, AT_ONCE = 120.0, 240.0  # messages of one page; a hand that drags makes 70 a second
POLICY = (
    "default-src 'self' data: blob: 'unsafe-inline' 'unsafe-eval'; connect-src 'self' data: blob: "
    "ws://{host} wss://{host}; frame-ancestors 'none'; base-uri 'none'; object-src 'none'"
)
serve = websockets_server.serve
_quiet = logging.getLogger("drsplat.viewer")
_quiet.setLevel(logging.CRITICAL)  # else what strangers send reaches the terminal


class Gate:
    """token: what a browser has to show, by its address or a cookie; None for nothing."""

    def __init__(self, host: str, token: str | None) -> None:
        self.names, self.token = names_of(host), token
        self.cookie = "drsplat"
        self.stands = False
        self.controls: Mapping[str, Any] = {}  # by viser's names
        self._waiting: dict[Visitor, None] = {}
        self._inside: set[Visitor] = set()

    def check(self, visitor: "Visitor", request: Request) -> Response | None:
        """An answer that turns the visitor away or elsewhere; None lets it in."""
        host = _host_of(request)
        if host is None or not is_addressed(host, self.names):
            called = ", ".join(self.names or ("its name or address",))
            return visitor.respond(HTTPStatus.FORBIDDEN, f"This viewer is called: {called}.\n")
        origins = request.headers.get_all("Origin")
        if not all(is_own_page(origin, host) for origin in origins):
            return visitor.respond(HTTPStatus.FORBIDDEN, "Other pages may not use this viewer.\n")
        asked = parse_qs(request.path.partition("?")[2])
        if not self._knows(request, asked):
            text = "Open the address that drsplat view printed, with its token.\n"
            return visitor.respond(HTTPStatus.UNAUTHORIZED, text)
        if "websocket" in request.headers.get_all("Upgrade"):
            return self._enter(visitor)
        # viser's page takes the server to talk to from its address: it never gets an address with one
        return self._elsewhere(visitor) if "?" in request.path else None

    def _knows(self, request: Request, asked: dict[str, list[str]]) -> bool:
        if self.token is None:
            return True
        pairs = "; ".join(request.headers.get_all("Cookie")).split(";")
        kept = [value for name, _, value in (pair.strip().partition("=") for pair in pairs) if name == self.cookie]
        return any(is_secret(one, self.token) for one in (*asked.get("token", ()), *kept))

    def _enter(self, visitor: "Visitor") -> Response | None:
        if len(self._inside) >= MOST_INSIDE:
            text = f"{MOST_INSIDE} pages of this viewer are open: close one.\n"
            return visitor.respond(HTTPStatus.SERVICE_UNAVAILABLE, text)
        self._waiting.pop(visitor, None)
        self._inside.add(visitor)
        return None

    def _elsewhere(self, visitor: "Visitor") -> Response:
        """To the page without a query; who had the token there keeps it as a cookie."""
        response = visitor.respond(HTTPStatus.SEE_OTHER, "")
        response.headers["Location"] = "/"
        if self.token is not None:
            response.headers["Set-Cookie"] = f"{self.cookie}={self.token}; Path=/; HttpOnly; SameSite=Lax"
        return response

    def came(self, visitor: "Visitor") -> None:
        """Beyond `MOST_WAITING` the one that has waited longest goes: a real page waits for milliseconds."""
        self._waiting[visitor] = None
        if len(self._waiting) > MOST_WAITING:
            oldest = next(iter(self._waiting))
            del self._waiting[oldest]
            oldest.transport.abort()

    def left(self, visitor: "Visitor") -> None:
        self._waiting.pop(visitor, None)
        self._inside.discard(visitor)

    def serve(self, listening: socket.socket, handler: Any, *_: Any, **options: Any) -> Any:
        """In place of websockets' own: on a socket that is bound already, with this gate before it."""
        behind = options.pop("process_request")
        self.cookie = f"drsplat-{listening.getsockname()[1]}"
        self.stands = True
        return serve(
            handler,
            sock=listening,
            **options
            | {
                "process_request": lambda visitor, request: self.check(visitor, request) or behind(visitor, request),
                "process_response": _marked,
                "create_connection": partial(Visitor, gate=self),
                "max_size": messages.MOST_MESSAGE,
                "max_queue": MOST_FRAMES,
                "server_header": None,
                "logger": _quiet,
            },
        )

    @contextmanager
    def before(self, listening: socket.socket) -> Iterator[None]:
        """While this lasts, what starts to serve WebSockets does so behind this gate."""
        websockets_server.serve = partial(self.serve, listening)  # type: ignore[assignment, misc]
        try:
            yield
        finally:
            websockets_server.serve = serve  # type: ignore[misc]


class Visitor(ServerConnection):
    """A connection that hands on nothing but what `messages` knows, at the pace of a hand."""

    def __init__(self, *given: Any, gate: Gate, **options: Any) -> None:
        super().__init__(*given, **options)
        self.gate, self.uploads, self.looks = gate, Uploads(), False
        self._free, self._last = AT_ONCE, time.monotonic()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self.gate.came(self)

    def connection_lost(self, exc: Exception | None) -> None:
        super().connection_lost(exc)
        self.gate.left(self)

    async def recv(self, decode: bool | None = None) -> Any:
        while True:
            data = await super().recv(decode)
            await self._paced()
            message = messages.read(data) if isinstance(data, bytes) else None
            passed = None if message is None else self._passed(message)
            if passed is not None:
                return messages.written(passed)

    def _passed(self, message: messages.Message) -> messages.Message | None:
        """viser forgets what a page has uploaded when the page goes, if that has shown a camera before."""
        self.looks = self.looks or message["type"] == messages.CAMERA
        if message["type"] == messages.CONTROL:
            control = self.gate.controls.get(message["uuid"])
            if control is None or not fits(control, message["updates"]["value"]):
                return None
        return self.uploads.passed(message) if self.looks else None

    async def _paced(self) -> None:
        """Who says too much is read more slowly, and waits in its own browser."""
        now = time.monotonic()
        self._free = min(AT_ONCE, self._free + (now - self._last) * A_SECOND) - 1
        self._last = now
        if self._free < 0:
            await asyncio.sleep(-self._free / A_SECOND)


def _host_of(request: Request) -> str | None:
    hosts = request.headers.get_all("Host")
    return hosts[0] if len(hosts) == 1 else None


def _marked(_: ServerConnection, request: Request, response: Response) -> Response:
    """With what keeps other pages from framing this one, and this one from talking to other servers."""
    if response.status_code != HTTPStatus.SWITCHING_PROTOCOLS:
        host = _host_of(request) if response.status_code == HTTPStatus.OK else None
        response.headers["Content-Security-Policy"] = POLICY.format(host=host or "localhost")
        response.headers["X-Content-Type-Options"] = "nosniff"
        response.headers["Referrer-Policy"] = "no-referrer"
    return response
