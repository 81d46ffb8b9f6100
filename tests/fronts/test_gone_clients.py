"""Requests whose client has gone: what waits is not computed, what is computed is ended."""

import asyncio
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("fastapi", reason="the extra drsplat[serve] is not installed")
pytest.importorskip("prometheus_client", reason="the extra drsplat[serve] is not installed")

from drsplat.fronts.serving import workbench
from drsplat.fronts.serving.app import Settings, create_app
from drsplat.fronts.serving.guards import Limits

GATED = """
import sys, time
from pathlib import Path
from drsplat.fronts.serving import worker
from drsplat.fronts.serving.replies import Reply

def computed(_, __, act, **___):
    if act != "open":
        with open(folder / "computed", "a") as file:
            file.write(act + "\\n")
    while act != "open" and not (folder / "gate").exists():
        time.sleep(0.01)
    return Reply(b'{"scenes": []}')

folder = Path({!r})
worker.reply_to = computed
worker.main(int(sys.argv[1]), int(sys.argv[2]))
"""
QUERY = ("POST", "/scenes/room/select", b'{"text": "lamp"}')
LIST = ("GET", "/scenes", b"")


class Client:
    """A request to an ASGI application, whose client can go."""

    def __init__(self, app: Any, method: str, path: str, body: bytes) -> None:
        self.status, self._gone = 0, asyncio.Event()
        headers = [(b"host", b"here"), (b"content-type", b"application/json")]
        scope = {
            "type": "http", "method": method, "path": path, "raw_path": path.encode(), "query_string": b"",
            "headers": headers, "scheme": "http", "http_version": "1.1", "root_path": "", "server": ("here", 80),
        }  # fmt: skip
        self._messages = [
            {"type": "http.request", "body": part, "more_body": part == body[:5]} for part in (body[:5], body[5:])
        ]
        self.task = asyncio.create_task(app(scope, self._receive, self._send))

    async def _receive(self) -> dict[str, Any]:
        if self._messages:
            return self._messages.pop(0)
        await self._gone.wait()
        return {"type": "http.disconnect"}

    async def _send(self, message: dict[str, Any]) -> None:
        self.status = message.get("status", self.status)

    async def go(self) -> None:
        self._gone.set()
        await asyncio.wait_for(self.task, 30)


@pytest.fixture
def app(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A service of one process, which notes what it computes and waits for a gate to be opened."""
    monkeypatch.setattr(workbench, "WORKER_COMMAND", [sys.executable, "-c", GATED.replace("{!r}", repr(str(tmp_path)))])
    made = create_app(Settings(str(tmp_path), limits=Limits(workers=1)))
    with closing(made.state.bench):
        yield made
        made.state.adding.close()


def computed(folder: Path) -> list[str]:
    path = folder / "computed"
    return path.read_text().split() if path.exists() else []


async def until(true: Callable[[], bool]) -> None:
    for _ in range(3000):
        if true():
            return
        await asyncio.sleep(0.01)
    raise AssertionError("it did not happen within half a minute")


@pytest.mark.parametrize("asked", [QUERY, LIST])
def test_what_waits_for_a_client_that_has_gone_is_not_computed(asked, app, tmp_path, monkeypatch):
    monkeypatch.setattr(workbench, "GONE_PATIENCE_S", 600.0)

    async def talk() -> None:
        clients = [Client(app, *asked) for _ in range(6)]
        await until(lambda: len(computed(tmp_path)) == 1)
        for client in clients:
            await client.go()
        assert [client.status for client in clients] == [0] * 6
        (tmp_path / "gate").touch()
        quick = Client(app, *LIST)
        await asyncio.wait_for(quick.task, 60)
        assert quick.status == 200

    asyncio.run(talk())
    assert len(computed(tmp_path)) == 2  # the first one had begun
    text = app.state.bench._metrics.text()
    assert b'status="499"} 6.0' in text
    assert b"drsplat_waiting 0.0" in text


def test_what_is_computed_for_a_client_that_has_gone_is_ended(app, tmp_path, monkeypatch):
    monkeypatch.setattr(workbench, "GONE_PATIENCE_S", 0.0)

    async def talk() -> None:
        client = Client(app, *QUERY)
        await until(lambda: len(computed(tmp_path)) == 1)
        (worker,) = app.state.bench._workers
        process = worker.started()[0]
        await client.go()
        await until(lambda: process.poll() is not None)
        (tmp_path / "gate").touch()
        quick = Client(app, *LIST)
        await asyncio.wait_for(quick.task, 60)
        assert quick.status == 200

    asyncio.run(talk())
    assert computed(tmp_path) == ["select", "list"]


def test_a_client_that_stays_gets_its_answer(app, tmp_path):
    async def talk() -> None:
        client = Client(app, *QUERY)
        await until(lambda: len(computed(tmp_path)) == 1)
        (tmp_path / "gate").touch()
        await asyncio.wait_for(client.task, 60)
        assert client.status == 200

    asyncio.run(talk())
