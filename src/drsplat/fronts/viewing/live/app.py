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

from pydantic import ValidationError
from starlette.applications import Starlette
from starlette.datastructures import QueryParams
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from ....base.contents import Document
from ....errors import DrSplatError, InputError
from ...serving.query_fields import Strict
from ...serving.replies import BUG, JPEG, PNG, Reply, decoded, faults_of, jpeg, problem, refusal
from ..client import client_file, live_html, printable
from ..saving import Saves
from ..stage import Stage
from . import files
from .acts import AnyAct, Open, SlowAct, begun, done, read_act
from .arrays import ARRAYS_HEADER, ROWS_HEADER, Packed, tile_paint, tile_splats
from .cameras import MAX_SIDE_PIXELS, Camera, Path, Text, flight_document
from .shared import Shared
from .turns import Lanes, Visit

MAX_STREAMS = 16
BEAT_S = 15.0
MAX_PICTURE_PIXELS = 40_000_000
T = TypeVar("T")
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
            if concerned in (None, visit):
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


class CameraOnly(Strict):
    camera: Camera


class CatalogueText(Strict):
    text: Text


_json, _png, _jpeg = JSONResponse, partial(Response, media_type=PNG), partial(Response, media_type=JPEG)


def _binary(packed: Packed) -> Response:
    headers = {ARRAYS_HEADER: packed.layout, ROWS_HEADER: str(packed.rows)}
    return Response(packed.data, headers=headers, media_type="application/octet-stream")


def _photo(shared: Shared, asked: QueryParams) -> bytes:
    """Return a photo, or a rendering where it is not at hand. Raises: InputError: no such view."""
    side = _number(asked, "side", "960")
    if not 16 <= side <= MAX_SIDE_PIXELS:
        raise InputError(f"side: expected 16 to {MAX_SIDE_PIXELS} pixels, got {side}")
    return jpeg(shared.session.scene.picture(asked.get("name", ""), photo=True, max_side=side))


def _ask_picture(shared: Shared, asked: tuple[QueryParams, bytes]) -> Document:
    params, body = asked
    shared.session.ask_picture(decoded(body, MAX_PICTURE_PIXELS), printable(params.get("name", "picture"), 60))
    shared.note()
    return shared.state()


LOOKS: dict[str, tuple[Any, Callable[[Shared, Any], Any], Callable[[Any], Response]]] = {
    "header": (None, lambda shared, _: shared.header(), _json),
    "state": (None, lambda shared, _: shared.state(), _json),
    "splats": (None, lambda shared, asked: shared.splats(_number(asked, "from", "0")), _binary),
    "paint": (None, lambda shared, asked: shared.paint(_number(asked, "from", "0")), _binary),
    "colors": (
        None, lambda shared, asked: shared.colors(asked.get("mode", ""), _number(asked, "from", "0")), _binary,
    ),
    "tiles": (None, lambda shared, asked: tile_splats(shared.stage, _numbers(asked, "parts")), _binary),
    "tiles-paint": (None, lambda shared, asked: tile_paint(shared.stage, _numbers(asked, "parts")), _binary),
    "photo": (None, _photo, _jpeg),
    "clicked-photo": (None, lambda shared, _: files.clicked_photo(shared.stage), _jpeg),
    "catalogue-picture": (None, lambda shared, asked: shared.entry_picture(_number(asked, "number")), _jpeg),
    "picture": (CameraOnly, lambda shared, asked: files.shown_picture(shared.stage, asked.camera), _png),
    "before-after": (CameraOnly, lambda shared, asked: files.before_after(shared.stage, asked.camera), _png),
    "flight": (Path, lambda shared, asked: flight_document(shared.stage, asked), _json),
    "catalogue": (CatalogueText, lambda shared, asked: shared.search(asked.text), _json),
    "ask-picture": (bytes, _ask_picture, _json),
    "load-path": (bytes, lambda shared, asked: files.loaded_path(shared.stage, asked[1]), _json),
}  # fmt: skip
"""Kind of a question, function that answers it in the turn of a browser, and how the answer is sent.

Asked is a JSON body of some kind, or (bytes) the query with any body; without either (None) it is the query of a GET.
"""

FILES: dict[str, tuple[type[Strict] | None, Callable[[Saves, Stage, Any, Event], files.Saved]]] = {
    "save": (files.Save, files.saved), "film": (files.Film, files.film), "path": (Path, files.path_file),
    "page": (None, files.page_file),
}  # fmt: skip
"""Kind of a question for a file, and function that writes it."""


class Viewer:
    """The handlers of one service.

    Whatever touches a session has a turn of their thread; what is slow works on a copy beside it.
    """

    def __init__(self, shared: Shared, lanes: Lanes) -> None:
        self.shared, self.lanes, self.turns = shared, lanes, lanes.quick
        self.events = Events(lambda: vars(shared.counters))
        shared.tell = self.events.tell

    def prepare(self) -> None:
        """Find names, words and pictures of the objects of the scene that is open. Raises: BusyError."""
        self.lanes.change(self.shared.prepare)
        self.lanes.files.submit(lambda: files.draw_pictures(self.shared.stage, lambda: self.lanes.files.is_ending))

    def routes(self) -> list[Route]:
        looks: dict[str, Handler] = {
            "/": self.page, "/client.js": _client_file, "/client.css": _client_file, "/favicon.ico": _no_icon,
            "/view/events": self.listen, "/view/object-picture": self.object_picture,
            "/view/film-progress": self.film_progress,
        }  # fmt: skip
        acts: dict[str, Handler] = {"/view/do": self.do, "/view/open": self.open, "/view/upload": self.upload}
        for name, (kind, answer, sent) in LOOKS.items():
            (looks if kind is None else acts)[f"/view/{name}"] = self._looking(kind, answer, sent)
        acts |= {f"/view/{name}": self._writing(*way) for name, way in FILES.items()}
        gets = [Route(path, handler, methods=["GET"]) for path, handler in looks.items()]
        return [*gets, *(Route(path, handler, methods=["POST"]) for path, handler in acts.items())]

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

    # --- looking ---

    def _looking(self, kind: Any, look: Callable[[Shared, Any], T], sent: Callable[[T], Response]) -> Handler:
        async def handler(request: Request) -> Response:
            asked = await _asked(request, kind)
            return sent(await self.turns.take(self._entered(request, lambda: look(self.shared, asked))))

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
        drawn = stage.pictures.get(number)
        return _jpeg(drawn or await self.lanes.files.take(lambda: files.object_picture(stage, number)))

    # --- acting ---

    async def do(self, request: Request) -> Response:
        return JSONResponse(await self._done(request, read_act(await request.body())))

    async def _done(self, request: Request, act: AnyAct) -> Document:
        shared = self.shared
        opened = shared.counters.scene
        if isinstance(act, SlowAct):
            state = await self.lanes.take_change(self._entered(request, lambda: begun(shared, act)))
        elif act.key is None:
            state = await self.turns.take(self._entered(request, lambda: done(shared, act)))
        else:
            ways = (self._entered(request, way) for way in (lambda: done(shared, act), shared.state))
            state = await self.turns.take_latest((self._visit(request), act.key), *ways)
        if shared.counters.scene != opened:
            self.prepare()
        return state

    async def upload(self, request: Request) -> Response:
        batch, name = request.query_params.get("batch", ""), request.query_params.get("name", "")
        return JSONResponse({"bytes": await self.shared.uploads.take(batch, name, request.stream())})

    async def open(self, request: Request) -> Response:
        """Take one file, and open it."""
        batch, uploads = secrets.token_hex(8), self.shared.uploads
        try:
            await uploads.take(batch, request.query_params.get("name", ""), request.stream())
            return JSONResponse(await self._done(request, Open(act="open", batch=batch)))
        finally:
            uploads.drop(batch)

    # --- files ---

    async def film_progress(self, request: Request) -> Response:
        """Tell how many pictures are done; 0 of 0 where the film waits for its turn or is whole."""
        drawn, count = self.shared.saves.films.get(request.query_params.get("job", ""), (0, 0))
        return JSONResponse({"done": drawn, "count": count})

    def _writing(self, kind: type[Strict] | None, write: Callable[[Saves, Stage, Any, Event], files.Saved]) -> Handler:
        """Answer with a file of the session as it is now, whatever is done to it while the file is written."""
        shared = self.shared

        async def handler(request: Request) -> Response:
            asked, is_gone = await _asked(request, kind), Event()

            def begin() -> Callable[[], files.Saved]:
                stage = shared.stage.copied()
                return lambda: write(shared.saves, stage, asked, is_gone)

            watching = asyncio.ensure_future(_watch(request, is_gone))
            try:
                path, data = await self.lanes.take_file(self._entered(request, begin))
            finally:
                is_gone.set()
                watching.cancel()
            headers = {"content-disposition": f'attachment; filename="{path.name}"'}
            if shared.saves.folder is not None:
                headers["x-drsplat-saved"] = quote(str(path), errors="replace")
            return Response(data, headers=headers, media_type="application/octet-stream")

        return handler


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

    def reply_to(request: Request, error: Exception) -> Reply:
        match error:
            case DrSplatError():
                return refusal(error, shared.without_folders(str(error)))
            case ValidationError():
                return problem(422, faults_of(error.errors()), "invalid")
            case HTTPException(status_code=404):
                return problem(404, f"there is nothing at {request.url.path!a:.80}", "http")
            case HTTPException():
                return problem(error.status_code, str(error.detail), "http")
            case OSError():
                said = error.strerror or type(error).__name__
                return problem(503, f"the viewer's machine says: {said}", "system")
            case MemoryError():
                return problem(503, "the viewer's machine has too little memory for this", "memory")
        return problem(500, BUG, "bug")  # uvicorn logs the traceback

    async def refused(request: Request, error: Exception) -> Response:
        reply = reply_to(request, error)
        headers = {"retry-after": "1"} if reply.status == 503 else {}
        return Response(reply.body, reply.status, headers, reply.media_type)

    return dict.fromkeys((DrSplatError, ValidationError, HTTPException, OSError, MemoryError, Exception), refused)


def _cookie(request: Request) -> str:
    """Return the name of the cookie of a visit, with the viewer's port: cookies do not tell ports apart."""
    return f"drsplat-visit-{request.headers['host'].rpartition(':')[2].strip(']')}"


async def _client_file(request: Request) -> Response:
    name = request.url.path[1:]
    return Response(client_file(name), media_type="text/javascript" if name.endswith("js") else "text/css")


async def _no_icon(_: Request) -> Response:
    return Response(status_code=204)  # which browsers ask for unasked


async def _asked(request: Request, kind: Any) -> Any:
    """Return what a request asks, as of `LOOKS`. Raises: ValidationError: a body of another shape."""
    if kind is None:
        return request.query_params
    body = await request.body()
    return (request.query_params, body) if kind is bytes else kind.model_validate_json(body)


def _number(asked: QueryParams, name: str, default: str = "") -> int:
    """Return a whole number of the query. Raises: InputError: there is none."""
    text = asked.get(name, default)
    if not _is_whole(text):
        raise InputError(f"{name}: expected a whole number, got {text!a:.40}")
    return int(text)


def _numbers(asked: QueryParams, name: str) -> list[int]:
    """Return whole numbers of the query, separated by commas. Raises: InputError: there are none."""
    text = asked.get(name, "")
    if not all(map(_is_whole, text.split(","))):
        raise InputError(f"{name}: expected whole numbers such as 0,2,4; got {text!a:.40}")
    return list(map(int, text.split(",")))


def _is_whole(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) < 10


async def _watch(request: Request, is_gone: Event) -> None:
    """Set an event when whoever asked has gone."""
    while (await request.receive())["type"] != "http.disconnect":
        pass
    is_gone.set()
