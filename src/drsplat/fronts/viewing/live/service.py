"""Starting the viewer: a socket, the gate, and a server until it is stopped."""

import secrets
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from typing import Any

import uvicorn

from ...serving.access import ALL_INTERFACES, is_loopback
from ...serving.connections import TIMEOUTS_S, Stage, bounded, run_server
from ...serving.listening import address_of
from ...serving.replies import BusyError
from ..session import Session
from .app import create_app
from .gate import Gate
from .shared import Shared
from .stage import Vector
from .turns import Lanes

GRACE_S = 5  # for what is being answered when the viewer stops
VIEWER_TIMEOUTS_S = {**TIMEOUTS_S, Stage.BODY: 1800.0}  # a scene of gigabytes may come over a slow network


class _Server(uvicorn.Server):
    """A server that ends the streams of events first: they would never end by themselves."""

    def __init__(self, config: uvicorn.Config, app: Any) -> None:
        super().__init__(config)
        self.app = app

    async def shutdown(self, sockets: Any = None) -> None:
        self.app.state.viewer.events.close()
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
        self._server = _Server(bounded(gate, VIEWER_TIMEOUTS_S, **options), app)

    def show(self, session: Session, up: Vector | None = None, text: str = "") -> None:
        """Show a session, and ask it something; before anybody has come."""
        self.shared.show(session, up)
        self.shared.note()
        if text:
            self.submit(lambda: self._ask(session, text))
        with suppress(BusyError):
            self.lanes.change(self.shared.prepare)

    def search(self, text: str) -> None:
        """Search the catalogue, if there is a text; before anybody has come."""
        if text:
            self.submit(lambda: self.shared.search(text))

    def _ask(self, session: Session, text: str) -> None:
        try:
            self.shared.say(session.ask(text))
        except Exception as error:  # is said in the page
            self.shared.say(self.shared.without_folders(str(error)))
        self.shared.note()

    def submit(self, act: Any) -> None:
        with suppress(BusyError):
            self.lanes.quick.submit(act)

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
