"""The live viewer without a network, and clients that talk to it: its own page, and strangers.

Tests import it before the services, by its name: it skips them where the extra drsplat[viewer] is not installed.
"""

import asyncio
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("fastapi", reason="the extra drsplat[viewer] is not installed")
pytest.importorskip("uvicorn", reason="the extra drsplat[viewer] is not installed")
pytest.importorskip("httpx", reason="httpx, which the tests ask with, is not installed")

import httpx

from drsplat.fronts.viewing.bare import is_bare, open_bare
from drsplat.fronts.viewing.live.app import create_app
from drsplat.fronts.viewing.live.service import Gate, listening_socket
from drsplat.fronts.viewing.live.shared import Shared
from drsplat.fronts.viewing.live.turns import Lanes
from drsplat.fronts.viewing.live.uploads import UploadLimits, Uploads
from drsplat.fronts.viewing.saving import Saves
from drsplat.fronts.viewing.session import Session
from drsplat.query import Scene, open_scene
from page_files import arrays_in
from viewing_scenes import THINGS, boxes_scene

HOST = "127.0.0.1:8080"
OWN = {"host": HOST, "origin": f"http://{HOST}"}
PNG = b"\x89PNG\r\n\x1a\n"


def opened(path: Path) -> Scene:
    return open_bare(path, threads=1) if is_bare(path) else open_scene(path, threads=1)


class Viewer:
    """A viewer of a session, and its own page. Faults of the service are raised here."""

    def __init__(
        self, session: Session | None = None, *, folder: Path | None = None, host: str = "127.0.0.1",
        token: str | None = None, limits: UploadLimits | None = None, catalogue: Any = None,
    ) -> None:  # fmt: skip
        self.shared = Shared(Saves(folder), opened, catalogue=catalogue, uploads=Uploads(limits or UploadLimits()))
        if session is not None:
            self.shared.show(session)
            self.shared.note()
        self.lanes = Lanes()
        self.app = create_app(self.shared, self.lanes)
        self.gate, self.peer = Gate(self.app, host, 8080, token), ("127.0.0.1", 123)
        self.gate._is_paced = lambda scope: True  # type: ignore[method-assign]  # but in the tests of pace

    @property
    def session(self) -> Session:
        return self.shared.session

    def close(self) -> None:
        self.lanes.stop()
        self.shared.uploads.close()

    def send(self, method: str, path: str, headers: Any = None, **given: Any) -> httpx.Response:
        """One request with these headers and no others but those of its body."""

        async def sent() -> httpx.Response:
            transport = httpx.ASGITransport(self.gate, client=self.peer)
            async with httpx.AsyncClient(transport=transport, base_url=f"http://{HOST}") as client:
                own = OWN if headers is None else headers
                return await client.request(method, path, headers=own, **given)

        return asyncio.run(sent())

    def get(self, path: str, **params: Any) -> httpx.Response:
        return self.send("GET", path, params=params or None)

    def post(self, path: str, body: Any) -> httpx.Response:
        if isinstance(body, bytes):
            return self.send("POST", path, OWN | {"content-type": "application/octet-stream"}, content=body)
        return self.send("POST", path, json=body)

    def do(self, act: str, **given: Any) -> dict[str, Any]:
        """The state after an act that is done."""
        answer = self.post("/view/do", {"act": act, **given})
        assert answer.status_code == 200, answer.text
        state: dict[str, Any] = answer.json()
        return state

    def ask(self, text: str, **more: Any) -> dict[str, Any]:
        return self.do("ask", text=text, **more)

    def header(self) -> dict[str, Any]:
        return dict(self.get("/view/header").json())

    def refused(self, act: str, status: int = 422, **given: Any) -> str:
        """Why an act is refused."""
        return error_of(self.post("/view/do", {"act": act, **given}), status)

    def arrays(self, path: str, **params: Any) -> dict[str, np.ndarray]:
        answer = self.get(path, **params)
        assert answer.status_code == 200, answer.text
        return arrays_in(answer.content, json.loads(answer.headers["x-drsplat-arrays"]))

    def state(self) -> dict[str, Any]:
        return dict(self.get("/view/state").json())


class Browser(Viewer):
    """A browser before a viewer: it keeps the cookie that the page gives it."""

    def __init__(self, viewer: Viewer, cookie: str = "") -> None:
        self.__dict__, self.cookie = dict(vars(viewer)), cookie
        self.load()

    def load(self) -> str:
        """Load the page; returns what was set."""
        given: str = self.send("GET", "/").headers["set-cookie"]
        self.cookie = given.partition(";")[0]
        return given

    def send(self, method: str, path: str, headers: dict[str, str] | None = None, **given: Any) -> httpx.Response:
        return super().send(method, path, (OWN if headers is None else headers) | {"cookie": self.cookie}, **given)


def error_of(answer: httpx.Response, status: int) -> str:
    assert answer.status_code == status, answer.text
    body = answer.json()
    assert set(body) == {"error", "kind"}
    return str(body["error"])


@contextmanager
def a_viewer(session: Session | None = None, **given: Any) -> Iterator[Viewer]:
    """Of three boxes that answer words, unless another session is given."""
    viewer = Viewer(Session(boxes_scene(), words=THINGS) if session is None else session, **given)
    try:
        yield viewer
    finally:
        viewer.close()


def camera(viewer: Viewer, eye: Any = (3.0, -9.0, 4.0), target: Any = (0.0, 0.0, 0.0)) -> dict[str, Any]:
    """A browser's camera that looks from one place of the world at another."""
    frame = viewer.session.shown.frame
    places = (frame.shown(np.array(place, np.float64)).tolist() for place in (eye, target))
    return dict(zip(("eye", "target"), places, strict=True)) | {"fov": 50.0, "width": 320, "height": 240}


def room_viewer(room: Path) -> Any:
    """A viewer of the room on disk with a red and a blue ball, its photos and its objects."""
    return a_viewer(
        Session(open_scene(room / "room.field", scene=room / "scene.ply", views=room / "capture", threads=1))
    )


def ray_to(viewer: Viewer, point: Any) -> dict[str, list[float]]:
    """A click from the side on a place of the world."""
    frame = viewer.session.shown.frame
    start, end = frame.shown(np.array(point) - [0.0, 4.0, 0.0]), frame.shown(np.array(point, np.float64))
    return {"origin": start.tolist(), "direction": (end - start).tolist()}


class Stream:
    """The events of one page, read from the application itself: httpx would wait for their end."""

    def __init__(self, viewer: Viewer) -> None:
        self.viewer, self.gone = viewer, asyncio.Event()
        self.cookie = getattr(viewer, "cookie", "")
        self.messages: asyncio.Queue[dict[str, Any]] = asyncio.Queue()

    async def __aenter__(self) -> "Stream":
        headers = [(key.encode(), value.encode()) for key, value in (OWN | {"cookie": self.cookie}).items()]
        scope = {
            "type": "http", "method": "GET", "path": "/view/events", "raw_path": b"/view/events", "query_string": b"",
            "headers": headers, "client": ("127.0.0.1", 1), "server": ("127.0.0.1", 8080), "scheme": "http",
            "http_version": "1.1", "asgi": {"version": "3.0", "spec_version": "2.3"},
        }  # fmt: skip
        self.task = asyncio.ensure_future(self.viewer.gate(scope, self._receive, self.messages.put))
        self.status = (await self.messages.get())["status"]
        return self

    async def __aexit__(self, *_: Any) -> None:
        self.gone.set()
        await self.task

    async def _receive(self) -> dict[str, Any]:
        await self.gone.wait()
        return {"type": "http.disconnect"}

    async def line(self) -> str:
        """The next text that is sent."""
        message = await asyncio.wait_for(self.messages.get(), 60)
        return str(message.get("body", b"").decode())

    async def event(self) -> dict[str, int]:
        """The next change."""
        line = await self.line()
        while line.startswith(":"):
            line = await self.line()
        return dict(json.loads(line.removeprefix("data: ")))


@contextmanager
def served(session: Session) -> Iterator[str]:
    """The address of a viewer of a session, for a browser."""
    from drsplat.fronts.viewing.live.service import Service

    with listening_socket("127.0.0.1", 0) as listening:
        service = Service(Shared(Saves(None), opened), listening, "127.0.0.1")
        service.show(session, np.array([0.0, 0, 1]), "")
        with service.running() as address:
            yield address
