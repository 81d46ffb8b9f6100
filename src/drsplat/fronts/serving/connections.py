"""Connections that owe the service something: bounded in number and in time, so that they lock nobody out."""

import asyncio
import json
import socket
from collections import OrderedDict
from collections.abc import Mapping
from contextlib import suppress
from enum import Enum
from typing import Any

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from ...base.system import allow_open_files


class Stage(Enum):
    """Stage of a connection: what it waits for."""

    IDLE = "a request"
    HEAD = "the rest of its head"
    BODY = "the rest of its body"
    SERVED = "the answer"


MAX_CONNECTIONS = 2048
OTHER_OPEN_FILES = 512  # and connections that are being answered
TIMEOUTS_S: Mapping[Stage, float] = {Stage.IDLE: 30.0, Stage.HEAD: 10.0, Stage.BODY: 40.0}


class Lobby:
    """Connections whose next request is not complete. Beyond `most` the oldest of whoever has most of them is closed.

    Those who send what they have to say at once are here for a moment only, and so are never the oldest.
    """

    def __init__(self, most: int) -> None:
        self.most, self._size = most, 0
        self._peers: dict[str, OrderedDict[Connection, None]] = {}

    def enter(self, connection: "Connection") -> None:
        own = self._peers.setdefault(connection.peer, OrderedDict())
        if connection not in own:
            own[connection] = None
            self._size += 1
        if self._size > self.most:
            fullest = max(self._peers, key=lambda peer: len(self._peers[peer]))
            oldest = next(iter(self._peers[fullest]))
            self.leave(oldest)
            oldest.transport.abort()

    def leave(self, connection: "Connection") -> None:
        own = self._peers.get(connection.peer, OrderedDict())
        if connection in own:
            del own[connection]
            self._size -= 1
        if not own:
            self._peers.pop(connection.peer, None)


class Connection(H11Protocol):
    """HTTP/1.1 as uvicorn speaks it, which alone would wait for a head or a body for ever."""

    lobby: Lobby
    seconds: Mapping[Stage, float]
    stage: Stage | None = None
    _timer: asyncio.TimerHandle | None = None
    _unsent = 0

    @property
    def peer(self) -> str:
        return self.client[0] if self.client else ""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._watch()

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        self._watch()

    def on_response_complete(self) -> None:
        super().on_response_complete()
        self._watch()

    def connection_lost(self, exc: Exception | None) -> None:
        self._stop_timer()
        self.lobby.leave(self)
        super().connection_lost(exc)

    def _watch(self) -> None:
        """Start the clock at each new stage, not at each byte."""
        stage = self._now()
        if stage is self.stage or (self.stage is None and self.transport.is_closing()):
            return
        self.stage = stage
        self._stop_timer()
        if stage is Stage.SERVED:
            self.lobby.leave(self)
        else:
            self._start_timer()
            self.lobby.enter(self)

    def _now(self) -> Stage:
        if self.cycle is not None and not self.cycle.response_complete:
            return Stage.BODY if self.cycle.more_body else Stage.SERVED
        return Stage.HEAD if self.conn.trailing_data[0] else Stage.IDLE

    def _start_timer(self) -> None:
        assert self.stage is not None
        self._unsent = self.transport.get_write_buffer_size()
        self._timer = self.loop.call_later(self.seconds[self.stage], self._overdue)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _overdue(self) -> None:
        """Close; but who still reads an answer, however slowly, may go on."""
        if 0 < self.transport.get_write_buffer_size() < self._unsent:
            self._start_timer()
        elif self.stage is Stage.HEAD and not self.transport.is_closing():
            seconds = self.seconds[Stage.HEAD]
            reason = {"error": f"no request within {seconds:g} s: send it at once", "kind": "timeout"}
            body = json.dumps(reason).encode()
            head = (
                "HTTP/1.1 408 Request Timeout\r\nconnection: close\r\ncontent-type: application/json\r\n"
                f"content-length: {len(body)}\r\n\r\n"
            )
            self.transport.write(head.encode() + body)
            self.transport.close()
        else:
            self.transport.abort()


def room() -> int:
    """Return how many connections may be open, once this process may open as many files as it is allowed to."""
    return max(allow_open_files(MAX_CONNECTIONS + OTHER_OPEN_FILES) - OTHER_OPEN_FILES, 16)


def connection_class(most: int, seconds: Mapping[Stage, float] = TIMEOUTS_S) -> type[Connection]:
    """Return the class of a service's connections, for uvicorn. most: as in `Lobby`. seconds: longest wait by stage."""
    return type("Connection", (Connection,), {"lobby": Lobby(most), "seconds": seconds})


def run(app: Any, listening: socket.socket, **options: Any) -> None:
    """Run an ASGI application on a socket until SIGINT or SIGTERM, with bounded connections. options: uvicorn's."""
    run_server(uvicorn.Server(bounded(app, **options)), listening)


def bounded(app: Any, seconds: Mapping[Stage, float] = TIMEOUTS_S, **options: Any) -> uvicorn.Config:
    """Return settings for a server with bounded connections. seconds: as of `connection_class`. options: uvicorn's."""
    protocol = connection_class(room(), seconds)
    return uvicorn.Config(app, http=protocol, ws="none", server_header=False, **options)


def run_server(server: uvicorn.Server, listening: socket.socket) -> None:
    """Run a server on a socket until SIGINT or SIGTERM."""
    with suppress(KeyboardInterrupt):
        server.run(sockets=[listening])
    if not server.started:
        raise SystemExit(3)  # the log says why
