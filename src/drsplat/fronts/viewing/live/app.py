"""The routes of the viewer: each is one call in the thread of its session, but what is slow; and what pages hear."""

import asyncio
import json
import secrets
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from functools import partial
from threading import Event
from typing import Any, TypeVar
from urllib.parse import quote

from pydantic import BaseModel, ValidationError
from starlette.applications import Starlette
from starlette.datastructures import QueryParams
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from ....base.contents import Document
from ....errors import DrSplatError, InputError
from ...serving.replies import BUG, JPEG, PNG, Reply, decoded, faults_of, problem, refusal
from ..client import client_file, live_html, printable
from ..saving import Saves
from . import files
from .acts import AnyAct, Open, SlowAct, begun, done, read_act
from .arrays import ARRAYS_HEADER, ROWS_HEADER, Packed, tile_paint, tile_splats
from .shared import Shared
from .stage import MAX_SIDE_PIXELS, Body, Camera, Path, Stage, Text, flight_document
from .turns import Lanes, Visit

MAX_STREAMS = 16
BEAT_S = 15.0
MAX_PICTURE_PIXELS = 40_000_000
T = TypeVar("T")
B = TypeVar("B", bound=BaseModel)
Handler = Callable[[Request], Coroutine[Any, Any, Response]]


class Events:
    """Streams of a service, each of a visit. summary: what a line says. A page that reads slowly gets the latest."""

    def __init__(self, summary: Callable[[], Document], most: int = MAX_STREAMS, beat_s: float = BEAT_S) -> None:
        self.summary, self.most, self.beat_s, self.is_closed = summary, most, beat_s, False
        self._streams: dict[asyncio.Event, tuple[asyncio.AbstractEventLoop, Visit | None]] = {}

    def __len__(self) -> int:
        return len(self._streams)

    def tell(self, concerned: Visit | None = None) -> None:
        """Wake the streams of a visit, of all for None; from any thread."""
        for changed, (loop, visit) in list(self._streams.items()):
            if concerned is not None and concerned is not visit:
                continue
            try:
                loop.call_soon_threadsafe(changed.set)
            except RuntimeError:  # its loop has ended
                self._streams.pop(changed, None)

    def close(self) -> None:
        """End all streams."""
        self.is_closed = True
        self.tell()

    def open(self, visit: Visit | None = None) -> AsyncIterator[bytes]:
        """Return the lines for one page. Raises: HTTPException: there are enough."""
        if len(self._streams) >= self.most:
            raise HTTPException(503, f"{self.most} pages of this viewer are open: close one")
        changed = asyncio.Event()
        self._streams[changed] = asyncio.get_running_loop(), visit
        return self._lines(changed)

    async def _lines(self, changed: asyncio.Event) -> AsyncIterator[bytes]:
        try:
            while not self.is_closed:
                changed.clear()
                yield f"data: {json.dumps(self.summary())}\n\n".encode()
                while not changed.is_set():
                    try:
                        await asyncio.wait_for(changed.wait(), self.beat_s)
                    except TimeoutError:
                        yield b": here\n\n"
        finally:
            self._streams.pop(changed, None)


class CameraOnly(Body):
    camera: Camera


class CatalogueText(Body):
    text: Text


_json, _png, _jpeg = JSONResponse, partial(Response, media_type=PNG), partial(Response, media_type=JPEG)


def _binary(packed: Packed) -> Response:
    headers = {ARRAYS_HEADER: packed.layout, ROWS_HEADER: str(packed.rows)}
    return Response(packed.data, headers=headers, media_type="application/octet-stream")


def _photo(shared: Shared, asked: QueryParams) -> bytes:
    side = _number(asked, "side", "960")
    if not 16 <= side <= MAX_SIDE_PIXELS:
        raise InputError(f"side: expected 16 to {MAX_SIDE_PIXELS} pixels, got {side}")
    return files.photo(shared.stage, asked.get("name", ""), side)


LOOKS: dict[str, tuple[Callable[[Shared, QueryParams], Any], Callable[[Any], Response]]] = {
    "header": (lambda shared, _: shared.header(), _json),
    "state": (lambda shared, _: shared.state(), _json),
    "splats": (lambda shared, asked: shared.splats(_number(asked, "from", "0")), _binary),
    "paint": (lambda shared, asked: shared.paint(_number(asked, "from", "0")), _binary),
    "colors": (lambda shared, asked: shared.colors(asked.get("mode", ""), _number(asked, "from", "0")), _binary),
    "tiles": (lambda shared, asked: tile_splats(shared.stage, _numbers(asked, "parts")), _binary),
    "tiles-paint": (lambda shared, asked: tile_paint(shared.stage, _numbers(asked, "parts")), _binary),
    "photo": (_photo, _jpeg),
    "clicked-photo": (lambda shared, _: files.clicked_photo(shared.stage), _jpeg),
    "catalogue-picture": (lambda shared, asked: shared.entry_picture(_number(asked, "number")), _jpeg),
}
"""Functions that look at something in the turn of a browser, and how the result is sent."""

QUESTIONS: dict[str, tuple[type[BaseModel], Callable[[Shared, Any], Any], Callable[[Any], Response]]] = {
    "picture": (CameraOnly, lambda shared, asked: files.shown_picture(shared.stage, asked.camera), _png),
    "before-after": (CameraOnly, lambda shared, asked: files.before_after(shared.stage, asked.camera), _png),
    "flight": (Path, lambda shared, asked: flight_document(shared.stage, asked), _json),
    "catalogue": (CatalogueText, lambda shared, asked: shared.search(asked.text), _json),
}
"""The same of what is asked in a JSON body."""


class Viewer:
    """The handlers of one service.

    Whatever touches a session has a turn of their thread; what is slow works on a copy beside it.
    """

    def __init__(self, shared: Shared, lanes: Lanes) -> None:
        self.shared, self.lanes, self.turns, self.pictures = shared, lanes, lanes.quick, files.ObjectPictures()
        self.progress = files.Progress()
        self.events = Events(lambda: vars(shared.counters))
        shared.tell = self.events.tell

    def prepare(self) -> None:
        """Find names, words and pictures of the objects of the scene that is open. Raises: BusyError."""
        self.lanes.change(self.shared.prepare)
        self.lanes.files.submit(lambda: self.pictures.draw(self.shared.stage, lambda: self.lanes.files.is_ending))

    def routes(self) -> list[Route]:
        own: dict[str, Handler] = {
            "/": self.page, "/client.js": _client_file, "/client.css": _client_file, "/favicon.ico": _no_icon,
            "/view/events": self.listen, "/view/object-picture": self.object_picture,
            "/view/film-progress": self.film_progress,
        }  # fmt: skip
        acts: dict[str, Handler] = {
            "do": self.do, "ask-picture": self.ask_picture, "open": self.open, "upload": self.upload,
            "save": self.save, "film": self.film, "path": self.path, "load-path": self.load_path, "page": self.export,
        }  # fmt: skip
        looks = {f"/view/{name}": self._looking(*way) for name, way in LOOKS.items()} | own
        acts |= {name: self._asking(*way) for name, way in QUESTIONS.items()}
        return [
            *(Route(path, handler, methods=["GET"]) for path, handler in looks.items()),
            *(Route(f"/view/{name}", handler, methods=["POST"]) for name, handler in acts.items()),
        ]

    # --- who asks ---

    def _visit(self, request: Request) -> Visit:
        return self.shared.visits.of(request.cookies.get(_cookie(request), ""))

    def _entered(self, request: Request, act: Callable[[], T]) -> Callable[[], T]:
        """Return what does something for the browser that asks, in its turn. Raises: HTTPException: as `Visits.of`."""
        visit = self._visit(request)

        def entered() -> T:
            self.shared.enter(visit)
            return act()

        return entered

    async def _turn(self, request: Request, act: Callable[[], T]) -> T:
        return await self.turns.take(self._entered(request, act))

    # --- looking ---

    def _looking(self, look: Callable[[Shared, QueryParams], T], sent: Callable[[T], Response]) -> Handler:
        async def handler(request: Request) -> Response:
            return sent(await self._turn(request, lambda: look(self.shared, request.query_params)))

        return handler

    def _asking(self, kind: type[B], answer: Callable[[Shared, B], T], sent: Callable[[T], Response]) -> Handler:
        async def handler(request: Request) -> Response:
            asked = await _body(request, kind)
            return sent(await self._turn(request, lambda: answer(self.shared, asked)))

        return handler

    async def page(self, request: Request) -> Response:
        name, page = _cookie(request), HTMLResponse(live_html())
        key = self.shared.visits.arrive(request.cookies.get(name, ""))
        page.set_cookie(name, key, httponly=True, samesite="strict")
        return page

    async def listen(self, request: Request) -> Response:
        return StreamingResponse(self.events.open(self._visit(request)), media_type="text/event-stream")

    async def object_picture(self, request: Request) -> Response:
        number, stage = _number(request.query_params, "number"), self.shared.stage
        drawn = self.pictures.known(stage, number)
        if drawn is None:
            drawn = await self.lanes.files.take(lambda: self.pictures.picture(stage, number))
        return _jpeg(drawn)

    # --- acting ---

    async def do(self, request: Request) -> Response:
        return JSONResponse(await self._done(request, read_act(await request.body())))

    async def _done(self, request: Request, act: AnyAct) -> Document:
        shared = self.shared
        opened = shared.counters.scene
        if isinstance(act, SlowAct):
            state = await self.lanes.take_change(self._entered(request, lambda: begun(shared, act)))
        elif act.key is None:
            state = await self._turn(request, lambda: done(shared, act))
        else:
            ways = (self._entered(request, way) for way in (lambda: done(shared, act), shared.state))
            state = await self.turns.take_latest((self._visit(request), act.key), *ways)
        if shared.counters.scene != opened:
            self.prepare()
        return state

    async def ask_picture(self, request: Request) -> Response:
        name, body = request.query_params.get("name", "picture"), await request.body()

        def ask() -> Document:
            self.shared.session.ask_picture(decoded(body, MAX_PICTURE_PIXELS), printable(name, 60))
            self.shared.note()
            return self.shared.state()

        return JSONResponse(await self._turn(request, ask))

    async def upload(self, request: Request) -> Response:
        batch, name = request.query_params.get("batch", ""), request.query_params.get("name", "")
        size = await self.shared.uploads.take(batch, name, request.stream())
        return JSONResponse({"bytes": size})

    async def open(self, request: Request) -> Response:
        """Take one file, and open it."""
        batch, uploads = secrets.token_hex(8), self.shared.uploads
        try:
            await uploads.take(batch, request.query_params.get("name", ""), request.stream())
            return JSONResponse(await self._done(request, Open(act="open", batch=batch)))
        finally:
            uploads.drop(batch)

    # --- files ---

    async def save(self, request: Request) -> Response:
        asked = await _body(request, files.Save)
        return await self._file(request, lambda saves, stage: files.saved(saves, stage, asked))

    async def film(self, request: Request) -> Response:
        asked, is_gone = await _body(request, files.Film), Event()
        watching = asyncio.ensure_future(_watch(request, is_gone))
        try:
            return await self._file(
                request, lambda saves, stage: files.film(saves, stage, asked, is_gone, self.progress)
            )
        finally:
            is_gone.set()
            watching.cancel()

    async def film_progress(self, request: Request) -> Response:
        return JSONResponse(self.progress.document(request.query_params.get("job", "")))

    async def path(self, request: Request) -> Response:
        asked = await _body(request, Path)
        return await self._file(request, lambda saves, stage: files.path_file(saves, stage, asked))

    async def load_path(self, request: Request) -> Response:
        body = await request.body()
        return JSONResponse(await self._turn(request, lambda: files.loaded_path(self.shared.stage, body)))

    async def export(self, request: Request) -> Response:
        return await self._file(request, files.page_file)

    async def _file(self, request: Request, write: Callable[[Saves, Stage], files.Saved]) -> Response:
        """Answer with a file of the session as it is now, whatever is done to it while the file is written."""
        shared = self.shared

        def begin() -> Callable[[], files.Saved]:
            stage = shared.stage.copied()
            return lambda: write(shared.saves, stage)

        saved = await self.lanes.take_file(self._entered(request, begin))
        headers = {"content-disposition": f'attachment; filename="{saved.path.name}"'}
        if self.shared.saves.folder is not None:
            headers["x-drsplat-saved"] = quote(str(saved.path), errors="replace")
        return Response(saved.data, headers=headers, media_type="application/octet-stream")


def create_app(shared: Shared, lanes: Lanes) -> Starlette:
    """Create the viewer as an ASGI application, without the gate before it."""
    viewer = Viewer(shared, lanes)

    @asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        yield
        viewer.events.close()

    app = Starlette(routes=viewer.routes(), lifespan=lifespan, exception_handlers=_refusals(shared))
    app.state.viewer = viewer
    return app


def _refusals(shared: Shared) -> dict[Any, Any]:
    """Return what answers each kind of error; no answer names a folder of this machine."""

    async def refused(_: Request, error: DrSplatError) -> Response:
        return _sent(refusal(error, shared.without_folders(str(error))))

    async def invalid(_: Request, error: ValidationError) -> Response:
        return _sent(problem(422, faults_of(error.errors()), "invalid"))

    async def http(request: Request, error: HTTPException) -> Response:
        said = f"there is nothing at {request.url.path!a:.80}" if error.status_code == 404 else str(error.detail)
        return _sent(problem(error.status_code, said, "http"))

    async def failed_system(_: Request, error: OSError) -> Response:
        return _sent(problem(503, f"the viewer's machine says: {error.strerror or type(error).__name__}", "system"))

    async def failed_memory(_: Request, __: MemoryError) -> Response:
        return _sent(problem(503, "the viewer's machine has too little memory for this", "memory"))

    async def failed(_: Request, __: Exception) -> Response:
        return _sent(problem(500, BUG, "bug"))  # uvicorn logs the traceback

    return {
        DrSplatError: refused, ValidationError: invalid, HTTPException: http, OSError: failed_system,
        MemoryError: failed_memory, Exception: failed,
    }  # fmt: skip


def _cookie(request: Request) -> str:
    """Return the name of the cookie of a visit, with the viewer's port: cookies do not tell ports apart."""
    return f"drsplat-visit-{request.headers['host'].rpartition(':')[2].strip(']')}"


def _sent(reply: Reply) -> Response:
    headers = {"retry-after": "1"} if reply.status == 503 else {}
    return Response(reply.body, reply.status, headers, reply.media_type)


async def _client_file(request: Request) -> Response:
    name = request.url.path[1:]
    return Response(client_file(name), media_type="text/javascript" if name.endswith("js") else "text/css")


async def _no_icon(_: Request) -> Response:
    return Response(status_code=204)  # which browsers ask for unasked


async def _body(request: Request, kind: type[B]) -> B:
    """Read a JSON body. Raises: ValidationError: it is of another shape."""
    return kind.model_validate_json(await request.body())


def _number(asked: QueryParams, name: str, default: str = "") -> int:
    """Return a whole number of the query. Raises: InputError: there is none."""
    text = asked.get(name, default)
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        raise InputError(f"{name}: expected a whole number, got {text!a:.40}")
    return int(text)


def _numbers(asked: QueryParams, name: str) -> list[int]:
    """Return whole numbers of the query, separated by commas. Raises: InputError: there are none."""
    texts = asked.get(name, "").split(",")
    if not all(text.isascii() and text.isdigit() and len(text) < 10 for text in texts):
        raise InputError(f"{name}: expected whole numbers such as 0,2,4; got {','.join(texts)!a:.40}")
    return [int(text) for text in texts]


async def _watch(request: Request, is_gone: Event) -> None:
    """Set an event when whoever asked has gone."""
    while (await request.receive())["type"] != "http.disconnect":
        pass
    is_gone.set()
