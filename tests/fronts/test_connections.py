"""Connections that are slow on purpose: each is closed in time, and many of them lock nobody out."""

import asyncio
import socket
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from typing import Any

import pytest

pytest.importorskip("uvicorn", reason="the extra drsplat[serve] is not installed")

import uvicorn

from drsplat.fronts.serving.connections import TIMEOUTS_S, Stage, connection_class

QUICK = {Stage.IDLE: 1.0, Stage.HEAD: 0.5, Stage.BODY: 1.0}
REQUEST = b"GET / HTTP/1.1\r\nHost: here\r\n\r\n"
SLOW = {
    Stage.IDLE: b"",
    Stage.HEAD: b"GET / HTTP/1.1\r\nHost: here\r\nX: ",
    Stage.BODY: b"POST / HTTP/1.1\r\nHost: here\r\nContent-Length: 1000\r\n\r\n{",
}
LARGE = 8 << 20


async def echo(scope: Any, receive: Any, send: Any) -> None:
    """Waits for the whole body, then answers."""
    while (await receive()).get("more_body"):
        pass
    body = bytes(LARGE) if scope["path"] == "/large" else b"here"
    headers = [(b"content-length", str(len(body)).encode())]
    await send({"type": "http.response.start", "status": 200, "headers": headers})
    await send({"type": "http.response.body", "body": body})


@contextmanager
def serving(most: int = 100, seconds: Mapping[Stage, float] = QUICK) -> Iterator[int]:
    kind = connection_class(most, seconds)
    config = uvicorn.Config(echo, port=0, http=kind, ws="none", log_level="critical", lifespan="off")  # fmt: skip
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        listening.listen(512)
        server = uvicorn.Server(config)
        run = lambda: asyncio.run(server.serve([listening]))  # noqa: E731
        thread = threading.Thread(target=run)
        thread.start()
        yield listening.getsockname()[1]
        server.should_exit = server.force_exit = True
        thread.join(30)
        assert not thread.is_alive()


def connected(port: int, sent: bytes) -> socket.socket:
    one = socket.create_connection(("127.0.0.1", port), 30)
    one.sendall(sent)
    return one


def received(one: socket.socket) -> bytes:
    """All until the other side closes."""
    parts = []
    try:
        while part := one.recv(1 << 16):
            parts.append(part)
    except ConnectionResetError:
        pass
    return b"".join(parts)


def answered(port: int) -> bool:
    with closing(connected(port, REQUEST)) as one:
        return one.recv(15) == b"HTTP/1.1 200 OK"


@pytest.mark.slow
@pytest.mark.parametrize("stage", SLOW)
def test_who_never_ends_a_request_is_closed(stage):
    assert TIMEOUTS_S.keys() == QUICK.keys()
    with serving() as port, closing(connected(port, SLOW[stage])) as one:
        said = received(one)
        assert said.startswith(b"HTTP/1.1 408") == (stage is Stage.HEAD)
        assert answered(port)


def test_a_byte_now_and_then_does_not_help():
    with serving() as port, closing(connected(port, SLOW[Stage.HEAD])) as one:
        with pytest.raises(OSError, match=r"[pP]ipe|reset"):  # noqa: PT012
            for _ in range(300):
                time.sleep(0.1)
                one.sendall(b"a")
        assert answered(port)


@pytest.mark.slow
def test_an_answer_that_nobody_reads_is_dropped_and_a_kept_connection_goes_on():
    with serving() as port:
        with closing(connected(port, REQUEST.replace(b"/ ", b"/large ", 1))) as one:
            time.sleep(4)
            assert len(received(one)) < LARGE
        with closing(connected(port, REQUEST)) as one:
            for _ in range(3):
                head = one.recv(1 << 16)
                assert head.startswith(b"HTTP/1.1 200")
                while not head.endswith(b"here"):
                    head += one.recv(1 << 16)
                one.sendall(REQUEST)


def test_many_unfinished_requests_lock_nobody_out():
    patient = dict.fromkeys(QUICK, 600.0)
    with serving(most=20, seconds=patient) as port, ExitStack() as opened:
        slow = [opened.enter_context(closing(connected(port, SLOW[kind]))) for kind in SLOW for _ in range(30)]
        assert answered(port)
        gone = 0
        for one in slow[:60]:
            one.settimeout(30)
            gone += received(one) == b""
        assert gone == 60  # the oldest; the others wait on


def test_whoever_has_most_connections_loses_one():
    """Peers are told apart, so that one of them cannot close the connections of others."""
    kind = connection_class(most=3)

    class Transport:
        aborted = False

        def abort(self) -> None:
            self.aborted = True

    def entered(peer: str) -> Any:
        one = object.__new__(kind)
        one.client, one.transport = (peer, 1), Transport()
        kind.lobby.enter(one)
        return one

    other, first, second, third = (entered(peer) for peer in ("b", "a", "a", "a"))
    assert [one.transport.aborted for one in (other, first, second, third)] == [
        False, True, False, False,
    ]  # fmt: skip
    kind.lobby.leave(second)
    kind.lobby.leave(second)
    entered("c")
    assert not any(one.transport.aborted for one in (other, second, third))
