"""Starting the viewer: a socket, a server until it is stopped, and the gate: who comes in, how often."""

import secrets
import signal
import socket
import sys
import threading
import time
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from typing import Any

import uvicorn
from starlette.requests import Request

from ....base.arrays import Vector3
from ....errors import DrSplatError, InputError
from ...serving.connections import TIMEOUTS_S, Stage, bounded, run_server
from ...serving.guards import Answer, App, DoorKeeper, Limits, Message, Receive, Send
from ...serving.listening import (
    ALL_INTERFACES,
    TakenError,
    address_of,
    bound_socket,
    is_addressed,
    is_loopback,
    is_own_page,
    is_secret,
    names_of,
)
from ..session import Session
from .app import Viewer, create_app
from .shared import Shared
from .turns import Lanes

MAX_PORTS_TRIED = 20
MAX_ACT_BYTES, MAX_PICTURE_BYTES, MAX_SCENE_BYTES = 1 << 20, 20 << 20, 4 << 30
MAX_BODY_BYTES: Mapping[str, int] = {
    "/view/ask-picture": MAX_PICTURE_BYTES, "/view/load-path": MAX_PICTURE_BYTES, "/view/open": MAX_SCENE_BYTES,
    "/view/upload": MAX_SCENE_BYTES,
}  # fmt: skip
CONTENT_TYPES = ("application/json", "application/octet-stream")  # which a page of another site cannot send unasked
REQUESTS_PER_SECOND, BURST_REQUESTS, MAX_PEERS = 120.0, 240.0, 1024  # of one address; addresses noted
CONTENT_POLICY = (
    "default-src 'none'; script-src 'self' blob:; worker-src blob:; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
SAFE_HEADERS = (
    (b"content-security-policy", CONTENT_POLICY.encode()), (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"), (b"cross-origin-resource-policy", b"same-origin"),
    (b"cache-control", b"no-store"),
)  # fmt: skip
GRACE_S = 5  # for what is being answered when the viewer stops
VIEWER_TIMEOUTS_S = {**TIMEOUTS_S, Stage.BODY: 1800.0}  # a scene of gigabytes may come over a slow network


def listening_socket(host: str, port: int) -> socket.socket:
    """Return a socket that listens on `port`, or on one of the next where it is taken; port 0 takes any.

    Raises: InputError: the address is not one of this machine; no port is free.
    """
    for candidate in range(port, max(port + 1, min(port + MAX_PORTS_TRIED, 65536))):
        try:
            return bound_socket(host, candidate)
        except TakenError:
            continue
    raise InputError(f"ports {port} to {candidate} of '{host}' are taken: name another one, port=N")


class Gate(DoorKeeper):
    """ASGI middleware around the viewer.

    host: that it listens on. token: what a browser has to show, by its address or a cookie; None for nothing. port: of
    the cookie's name, so that several viewers of one machine keep theirs apart.
    """

    def __init__(self, app: App, host: str, port: int, token: str | None = None) -> None:
        super().__init__(app, token, names_of(host), Limits(large_bodies=4))
        self.cookie = f"drsplat-{port}"
        self._paces: OrderedDict[str, tuple[float, float]] = OrderedDict()

    async def __call__(self, scope: Message, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return

        async def safe(message: Message) -> None:
            if message["type"] == "http.response.start":
                message = {**message, "headers": [*message.get("headers", ()), *SAFE_HEADERS]}
            await send(message)

        answer = Answer(safe)
        if not (await self.turned_away(scope, answer) or await self._led_home(scope, answer)):
            await self.admit(scope, receive, answer, MAX_BODY_BYTES.get(scope["path"], MAX_ACT_BYTES))

    async def turned_away(self, scope: Message, answer: Answer) -> bool:
        hosts, kind = _headers(scope, b"host"), (*_headers(scope, b"content-type"), "")[0]
        if len(hosts) != 1 or not is_addressed(hosts[0], self.hosts):
            called = ", ".join(self.hosts or ("its name or address",))
            await answer.refuse(403, "wrong host", f"this viewer is called: {called}")
        elif not _is_from_here(scope, hosts[0]):
            await answer.refuse(403, "other page", "other pages may not use this viewer")
        elif not self._is_known(scope):
            await answer.refuse(401, "unauthorised", "open the address that drsplat view printed, with its token")
        elif not self._is_paced(scope):
            await answer.refuse(429, "too fast", f"{REQUESTS_PER_SECOND:g} requests a second are answered: come again")
        elif scope["method"] == "POST" and kind.partition(";")[0].strip().lower() not in CONTENT_TYPES:
            await answer.refuse(415, "media type", f"expected the header Content-Type: {' or '.join(CONTENT_TYPES)}")
        return bool(answer.status)

    def _is_known(self, scope: Message) -> bool:
        if self.key is None:
            return True
        request = Request(scope)
        given = [request.cookies.get(self.cookie, "")]
        if scope["path"] == "/":
            given += request.query_params.getlist("token")
        return any(is_secret(one, self.key) for one in given)

    def _is_paced(self, scope: Message) -> bool:
        """Return whether an address has not asked too often; what it may ask at once comes back with time."""
        peer = scope["client"][0] if scope.get("client") else ""
        now = time.monotonic()
        left, last = self._paces.pop(peer, (BURST_REQUESTS, now))
        left = min(BURST_REQUESTS, left + (now - last) * REQUESTS_PER_SECOND)
        self._paces[peer] = max(left - 1, 0), now
        if len(self._paces) > MAX_PEERS:
            self._paces.popitem(last=False)
        return left >= 1

    async def _led_home(self, scope: Message, answer: Answer) -> bool:
        """Send who comes to the page with a query to the page without one; who had the token keeps it as a cookie."""
        if scope["path"] != "/" or not scope["query_string"]:
            return False
        headers = [(b"location", b"/"), (b"content-length", b"0")]
        if self.key is not None:
            kept = f"{self.cookie}={self.key}; Path=/; HttpOnly; SameSite=Strict"
            headers.append((b"set-cookie", kept.encode()))
        await answer({"type": "http.response.start", "status": 303, "headers": headers})
        await answer({"type": "http.response.body", "body": b""})
        return True


def _headers(scope: Message, name: bytes) -> list[str]:
    """Return all values of a header of a request."""
    return [value.decode("latin-1") for key, value in scope["headers"] if key == name]


def _is_from_here(scope: Message, host: str) -> bool:
    """Return whether a request comes from the viewer's own page, or, to look, from no page.

    Browsers say in `Sec-Fetch-Site` where a request comes from that has no `Origin`, such as that of a picture in a
    page; a link from elsewhere may lead to the page itself. What changes something has to say that it is ours.
    """
    origins, sites = _headers(scope, b"origin"), _headers(scope, b"sec-fetch-site")
    if not all(is_own_page(origin, host) for origin in origins):
        return False
    own_site = all(site in ("same-origin", "none") for site in sites)
    if scope["method"] in ("GET", "HEAD"):
        return own_site or (scope["path"] == "/" and _headers(scope, b"sec-fetch-mode") == ["navigate"])
    return own_site and bool(origins or sites)


class _Server(uvicorn.Server):
    """A server that ends the streams of events first: they would never end by themselves."""

    viewer: Viewer

    async def shutdown(self, sockets: Any = None) -> None:
        self.viewer.events.close()
        await super().shutdown(sockets)


def _end(*_: Any) -> None:
    """Leave as at the end of the program, so that nothing stays behind."""
    raise SystemExit(0)


class Service:
    """A viewer on a socket. `address` is for a browser, with the token that others need to come in."""

    def __init__(self, shared: Shared, listening: socket.socket, host: str) -> None:
        self.shared, self.lanes, self.listening = shared, Lanes(), listening
        self.token = None if is_loopback(host) else secrets.token_urlsafe(24)
        query = "" if self.token is None else f"/?token={self.token}"
        self.address = address_of(listening, socket.gethostname() if host in ALL_INTERFACES else host) + query
        app = create_app(shared, self.lanes)
        gate = Gate(app, host, listening.getsockname()[1], self.token)
        options: dict[str, Any] = {"log_level": "error", "access_log": False, "timeout_graceful_shutdown": GRACE_S}
        self._server = _Server(bounded(gate, VIEWER_TIMEOUTS_S, **options))
        self._server.viewer = app.state.viewer

    def show(self, session: Session, up: Vector3 | None = None, text: str = "") -> None:
        """Show a session, and ask it something; before anybody has come."""
        self.shared.show(session, up)
        self.shared.note()

        def ask() -> None:
            try:
                self.shared.begin(text)
            except DrSplatError as error:  # of who started the viewer, who reads the terminal
                print(f"warning: {error}", file=sys.stderr)

        if text:
            self.lanes.quick.submit(ask)
        self._server.viewer.prepare()

    def run(self) -> None:
        """Answer until SIGINT or SIGTERM."""
        with closing(self):
            signal.signal(signal.SIGTERM, _end)  # which the server raises again, when it has ended
            run_server(self._server, self.listening)

    @contextmanager
    def running(self) -> Iterator[str]:
        """Answer at the address, in a thread of its own, while the block runs."""
        thread = threading.Thread(target=self._server.run, kwargs={"sockets": [self.listening]}, daemon=True)
        thread.start()
        try:
            yield self.address
        finally:
            self._server.should_exit = True
            thread.join(2 * GRACE_S)
            self.close()

    def close(self) -> None:
        """Stop what is being done, and remove files that were sent."""
        self.lanes.stop()
        self.shared.uploads.close()
