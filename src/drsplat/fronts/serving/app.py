"""The HTTP service: every route is one public call in a process of the workbench."""

import json
import socket
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from html import escape
from inspect import signature
from json import JSONDecodeError
from typing import Annotated, Any

from fastapi import FastAPI, Query, Request, Response
from fastapi import Path as InPath
from fastapi.exceptions import RequestValidationError
from fastapi.responses import HTMLResponse
from fastapi.routing import APIRoute
from starlette.exceptions import HTTPException
from starlette.middleware.cors import CORSMiddleware

from ... import __version__
from ...base.contents import Document
from ...errors import DrSplatError, InputError
from ...formats.json_files import parsed
from .connections import run
from .guards import Guard, Limits
from .listening import is_own_page
from .live import LIST, TAKE, NewView, ViewList, ViewState
from .metrics import Metrics
from .models import Health, ObjectList, Problem, SceneDetails, SceneList
from .query_fields import AskCatalogue, CatalogueAnswer, CatalogueScenes
from .replies import BUG, JPEG, NO_JSON, PLY, PNG, Reply, faults_of, is_json, problem, refusal
from .scene_folder import SceneFolder, without_paths
from .workbench import Adding, Job, Workbench
from .worker import ANSWERS, Answering, Workplace

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>drsplat</title><style>
body {{ font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #222 }}
table {{ border-collapse: collapse }} td {{ padding: .3rem .8rem .3rem 0; vertical-align: top }}
code, pre {{ font: 14px/1.5 ui-monospace, monospace; background: #f4f4f4; border-radius: 4px; padding: .1rem .3rem }}
pre {{ padding: .8rem; overflow-x: auto }}
</style></head><body>
<h1>drsplat {version}</h1>
<p>{about}</p>
<table>{routes}</table>
<h2>For example</h2>
{examples}
<p><a href="openapi.json">openapi.json</a> describes every route with types, bounds and examples; <a href="scenes">
scenes</a> lists what can be asked.</p>
</body></html>
"""


class StrictRequest(Request):
    """Request whose JSON is refused where a reader would have to guess."""

    async def json(self) -> Any:
        """Return the document of the body. Raises: JSONDecodeError: it is no JSON. HTTPException: as `parsed` says."""
        try:
            return parsed(await self.body())
        except JSONDecodeError:  # FastAPI says where
            raise
        except (ValueError, RecursionError) as error:
            raise HTTPException(422, f"body: {error}; expected JSON in UTF-8 that gives each name once") from None


class StrictRoute(APIRoute):
    """Route whose requests are strict."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        handler = super().get_route_handler()

        async def handled(request: Request) -> Response:
            return await handler(StrictRequest(request.scope, request.receive))

        return handled


DESCRIPTION = """\
Scenes that answer words. Positions are world coordinates in scene units. Whatever cannot be answered gets
`{"error": ..., "kind": ...}` with a status of 4xx, 503 where it can be asked again later, or 500 for a fault of the
service."""

FIELD_HEADER = "x-drsplat-field"
RETRY_STATUSES = (429, 503)
GRACE_S = 5  # beyond the longest request
Scene = Annotated[str, InPath(min_length=1, max_length=200, description="a name from /scenes")]
Number = Annotated[int, InPath(ge=0, le=2**31 - 1, description="an id from /scenes/{scene}/objects")]
Compute = Callable[..., Coroutine[Any, Any, Response]]
"""Ask the workbench: the act, the scene, what is called with the reply, and what is asked by name."""
Responses = dict[int | str, dict[str, Any]]
REFUSALS = {
    400: "not HTTP as expected", 401: "no key, or a wrong one", 404: "no such scene or photo",
    413: "the body is too large", 415: "the content type of the body is not JSON",
    422: "the request makes no sense, or not for this scene",
    500: "a fault of the service; its log has the details",
    503: "too busy, too slow, or the scene's files are damaged",
}  # fmt: skip
REFUSALS_OF_VIEWS = {
    403: "the service takes no photos, or not from this page", 409: "another photo has the name",
    429: "many photos wait already", 507: "the disk is full",
}  # fmt: skip


def refusals(texts: Mapping[int, str]) -> Responses:
    """Return the responses of a route that say why there is no answer."""
    return {status: {"model": Problem, "description": text} for status, text in texts.items()}


def binary(*media_types: str) -> Responses:
    """Return the responses of a route that sends bytes."""
    return {200: {"content": {media: {"schema": {"type": "string", "format": "binary"}} for media in media_types}}}


def sent(reply: Reply, headers: Any = None) -> Response:
    """Return a response with the field's fingerprint, and when to come again where that helps."""
    more = {"retry-after": "1"} if reply.status in RETRY_STATUSES else {}
    if reply.field:
        more[FIELD_HEADER] = reply.field
    return Response(reply.body, reply.status, {**(headers or {}), **more}, media_type=reply.media_type)


@dataclass(frozen=True)
class Settings(Workplace):
    """key: of the service, None for none. hosts: as in `Guard`. origins: of pages whose scripts may read answers.

    takes_views: whether photos may be sent to the scenes, with the key.

    Raises: InputError: photos may be sent, and there is no key.
    """

    key: str | None = field(default=None, repr=False)
    hosts: tuple[str, ...] | None = None
    origins: tuple[str, ...] = ()
    takes_views: bool = False

    def __post_init__(self) -> None:
        if self.takes_views and self.key is None:
            raise InputError("photos are taken only from those who have a key: pass api_key_file=FILE")

    def why_not(self, origin: str | None, host: str) -> str:
        """Return why a request may not change a scene, or "". origin, host: what its headers of these names say."""
        if not self.takes_views:
            return "this service takes no photos: whoever runs it has to allow it"
        if not is_own_page(origin, host) and origin not in self.origins:
            return "pages of other sites may not change a scene"
        return ""


def create_app(settings: Settings) -> FastAPI:
    """Create the service over the scenes of a folder, an ASGI application. Raises: InputError: no such folder."""
    metrics, scene_folder = Metrics(), settings.scene_folder()
    bench, adding = Workbench(settings, metrics), Adding(scene_folder, settings, metrics)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        bench.start()
        if settings.takes_views:
            adding.start()
        yield
        adding.close()
        bench.close()

    async def compute(
        act: str, scene: str = "", then: Callable[[Reply], None] = lambda _: None, /, **asked: Any
    ) -> Response:
        return sent(await bench.run(Job(act, scene, asked, then)))

    app = FastAPI(
        title="drsplat", version=__version__, description=DESCRIPTION, lifespan=lifespan, responses=refusals(REFUSALS),
        docs_url=None, redoc_url=None,  # these load scripts from elsewhere
    )  # fmt: skip
    app.router.route_class, app.state.bench, app.state.adding = StrictRoute, bench, adding
    _add_errors(app, scene_folder)
    _add_watching(app, scene_folder, metrics)
    _add_scenes(app, compute)
    _add_live(app, compute, adding, settings)
    _add_queries(app, compute)
    if settings.catalogue is not None:
        _add_catalogue(app, compute)
    _add_pages(app)
    guarding = {"limits": settings.limits, "metrics": metrics, "key": settings.key, "hosts": settings.hosts}
    app.add_middleware(Guard, **guarding)  # type: ignore[arg-type]
    if settings.origins:  # before the guard: a browser asks without the key whether it may ask with it
        app.add_middleware(
            CORSMiddleware, allow_origins=list(settings.origins), allow_methods=["GET", "POST"],
            allow_headers=["authorization", "x-api-key", "content-type"], expose_headers=[FIELD_HEADER, "retry-after"],
        )  # fmt: skip
    return app


def _add_errors(app: FastAPI, scene_folder: SceneFolder) -> None:
    @app.exception_handler(DrSplatError)
    async def refused(_: Any, error: DrSplatError) -> Response:
        return sent(refusal(error, without_paths(str(error), scene_folder.roots)))

    @app.exception_handler(RequestValidationError)
    async def invalid(request: Request, error: RequestValidationError) -> Response:
        given = request.headers.get("content-type", "")
        if request.method == "POST" and not is_json(given):
            return sent(problem(415, f"{NO_JSON}; got {given!a:.80}" if given else NO_JSON, "media type"))
        return sent(problem(422, faults_of(error.errors()), "invalid"))

    @app.exception_handler(HTTPException)
    async def http(request: Request, error: HTTPException) -> Response:
        said = str(error.detail)
        if error.status_code == 404:
            said = f"there is nothing at {request.url.path!a:.80}: GET /openapi.json lists the routes"
        elif error.status_code == 405:
            said = f"expected {(error.headers or {}).get('Allow', 'another method')} here, got {request.method}"
        return sent(problem(error.status_code, said, "http"), error.headers)

    @app.exception_handler(Exception)
    async def failed(_: Any, __: Exception) -> Response:
        return sent(problem(500, BUG, "bug"))  # uvicorn logs the traceback


def _add_watching(app: FastAPI, scene_folder: SceneFolder, metrics: Metrics) -> None:
    @app.get("/health", tags=["watching"])
    async def health() -> Health:
        """Tell that the service lives; needs no key."""
        return Health(status="ok", num_scenes=len(scene_folder.folders()))

    @app.get(
        "/metrics",
        tags=["watching"],
        response_class=Response,
        responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}}},
    )
    async def numbers() -> Response:
        """Return counters and times, in Prometheus' text format."""
        return Response(metrics.text(), media_type=metrics.content_type)


def _add_scenes(app: FastAPI, compute: Compute) -> None:
    @app.get("/scenes", tags=["scenes"], response_model=SceneList)
    async def scenes() -> Response:
        """List all scenes, without opening them."""
        return await compute("list")

    @app.get("/scenes/{scene}", tags=["scenes"], response_model=SceneDetails)
    async def scene_details(scene: Scene) -> Response:
        """Describe one scene: its size, its photos, which way is up."""
        return await compute("details", scene, name=scene)

    @app.get("/scenes/{scene}/photo", tags=["scenes"], response_class=Response, responses=binary(PNG))
    async def photo(
        scene: Scene,
        view: Annotated[str, Query(min_length=1, max_length=500, description="a photo's name")],
        max_side: Annotated[int, Query(ge=16, le=Limits.side)] = 800,
    ) -> Response:
        """Send a photo of the scene, such as a supporting one, as PNG."""
        return await compute("photo", scene, view=view, max_side=max_side)

    @app.get("/scenes/{scene}/objects", tags=["objects"], response_model=ObjectList)
    async def objects(
        scene: Scene, all: Annotated[bool, Query(description="list also the objects that photos agree less on")] = False
    ) -> Response:
        """List the objects of a scene that photos agree on, found across photos, without any word for them."""
        return await compute("objects", scene, all=all)

    @app.get(
        "/scenes/{scene}/objects/{number}/picture", tags=["objects"], response_class=Response, responses=binary(JPEG)
    )
    async def object_picture(scene: Scene, number: Number) -> Response:
        """Send an object, cut out of the photo that shows it best, as JPEG."""
        return await compute("object-picture", scene, number=number)

    @app.get("/scenes/{scene}/objects/{number}/ply", tags=["objects"], response_class=Response, responses=binary(PLY))
    async def object_ply(scene: Scene, number: Number) -> Response:
        """Send the Gaussians of an object, as PLY."""
        return await compute("object-ply", scene, number=number)


def _add_queries(app: FastAPI, compute: Compute) -> None:
    for act, way in ANSWERS.items():
        if way.asked is not None:
            _add_query(app, compute, act, way)


def _add_query(app: FastAPI, compute: Compute, act: str, way: Answering) -> None:
    async def computed(scene: Scene, asked: way.asked) -> Response:  # type: ignore[name-defined]
        return await compute(act, scene, **asked.model_dump(mode="json"))

    made: dict[str, Any] = {"response_model": signature(way.answer).return_annotation}
    if way.media:
        made = {"response_class": Response, "responses": binary(*way.media)}
    made |= {"name": act.replace("-", "_"), "description": (way.answer.__doc__ or "").partition("\n")[0]}
    app.post(f"/scenes/{{scene}}/{act}", tags=["queries"], **made)(computed)


def _add_live(app: FastAPI, compute: Compute, adding: Adding, settings: Settings) -> None:
    """Add routes for views that are sent."""
    responses = refusals(REFUSALS_OF_VIEWS) | {200: {"model": ViewState, "description": "sent before"}}

    @app.get("/scenes/{scene}/views", tags=["views"], response_model=ViewList)
    async def views(scene: Scene) -> Response:
        """List the photos that were sent to a scene, and what has become of each."""
        return await compute(LIST, scene, working=adding.working(scene), problem=adding.problem(scene))

    @app.post("/scenes/{scene}/views", tags=["views"], status_code=202, response_model=ViewState, responses=responses)
    async def take_view(scene: Scene, view: NewView, request: Request) -> Response:
        """Take a posed photo: it is on disk when this is answered, and added to the scene's field within seconds."""
        refused = settings.why_not(request.headers.get("origin"), request.headers.get("host", ""))
        if refused:
            return sent(problem(403, refused, "not let"))

        def added(reply: Reply) -> None:
            if reply.status == 202:
                adding.notice(scene)

        return await compute(TAKE, scene, added, **view.model_dump(mode="json", exclude_none=True))


def _add_catalogue(app: FastAPI, compute: Compute) -> None:
    @app.get("/catalogue", tags=["catalogue"], response_model=CatalogueScenes)
    async def catalogue_scenes() -> Response:
        """List the scenes whose objects can be asked for together."""
        return await compute("catalogue-list")

    @app.post("/catalogue/ask", tags=["catalogue"], response_model=CatalogueAnswer)
    async def ask_catalogue(asked: AskCatalogue) -> Response:
        """Search the objects of all scenes by a text, vector or image, best first."""
        return await compute("catalogue-ask", **asked.model_dump(mode="json"))

    @app.get("/catalogue/picture", tags=["catalogue"], response_class=Response, responses=binary(JPEG))
    async def catalogue_picture(
        scene: Annotated[str, Query(min_length=1, max_length=200, description="name of the scene")],
        object_id: Annotated[int, Query(ge=0, le=2**31 - 1)],
        tile: Annotated[int, Query(ge=0, le=2**31 - 1)] = 0,
    ) -> Response:
        """Send the thumbnail of an object, as JPEG."""
        return await compute("catalogue-picture", scene=scene, object_id=object_id, tile=tile)


def _add_pages(app: FastAPI) -> None:
    @app.get("/", include_in_schema=False)
    @app.get("/docs", include_in_schema=False)
    async def page() -> HTMLResponse:
        safe = {"content-security-policy": "default-src 'none'; style-src 'unsafe-inline'"}
        return HTMLResponse(_page_of(app.openapi()), headers=safe)


def _page_of(description: Document) -> str:
    """Return a page of all routes, with an example of each that takes a body."""
    routes, examples, schemas = [], [], description["components"]["schemas"]
    for path, methods in description["paths"].items():
        for method, route in methods.items():
            name = escape(f"{method.upper()} {path}")
            routes.append(f"<tr><td><code>{name}</code></td><td>{escape(route['description'])}</td></tr>")
        if body := methods.get("post", {}).get("requestBody"):
            asked = body["content"]["application/json"]["schema"]["$ref"].rpartition("/")[2]
            given = json.dumps(schemas[asked]["examples"][0])
            address = "localhost:8765" + path.replace("{scene}", "NAME")
            line = f"curl -s {address} -H 'content-type: application/json' -d '{given}'"
            examples.append(f"<pre>{escape(line)}</pre>")
    version, about = (escape(description["info"][name]) for name in ("version", "description"))
    return _PAGE.format(version=version, about=about, routes="".join(routes), examples="".join(examples))


def serve(settings: Settings, listening: socket.socket, quiet: bool = False) -> None:
    """Answer on a socket until stopped (SIGINT, SIGTERM): finish what is being answered, take nothing new.

    A process that computes and dies is started again: nothing is lost but its answer, and views that were taken are
    on disk.
    """
    run(
        create_app(settings),
        listening,
        log_level="warning" if quiet else "info",
        access_log=False,
        timeout_graceful_shutdown=int(settings.limits.seconds) + GRACE_S,
        timeout_keep_alive=30,
    )
