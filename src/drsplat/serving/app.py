"""The HTTP service: every route is one public call on a thread of the workbench."""

import json
import os
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, TypeVar

from fastapi import FastAPI, Query, Response
from fastapi import Path as InPath
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from .. import __version__
from ..asking import AskableScene
from ..errors import DrSplatError, MissingExtraError
from . import answers
from .catalog import Catalog, SceneFaultError, Sources, UnknownSceneError, without_paths
from .guards import Guard
from .limits import Limits
from .metrics import Metrics
from .models import (
    Health,
    Named,
    Problem,
    SceneDetails,
    SceneList,
    Segmented,
    Selected,
    Things,
    summarized,
)
from .requests import Ids, Locate, Picture, Segment, WhatIs
from .workbench import BusyError, Workbench

T = TypeVar("T")
SETTINGS = "DRSPLAT_SERVE"
DESCRIPTION = """\
Scenes that answer words. Positions are world coordinates in scene units. Whatever cannot be answered gets
`{"error": ..., "kind": ...}` with a status of 4xx, or 503 where it can be asked again later."""

Scene = Annotated[str, InPath(min_length=1, max_length=200, description="a name from /scenes")]
_REFUSALS = {
    400: "not HTTP as expected",
    401: "no key, or a wrong one",
    404: "no such scene or photo",
    413: "the body is too large",
    422: "the request makes no sense, or not for this scene",
    503: "too busy, too slow, or the scene's files are damaged",
}
REFUSALS: dict[int | str, dict[str, Any]] = {
    status: {"model": Problem, "description": text} for status, text in _REFUSALS.items()
}
PNG: dict[int | str, dict[str, Any]] = {
    200: {"content": {"image/png": {"schema": {"type": "string", "format": "binary"}}}}
}


@dataclass(frozen=True)
class Settings:
    """What a worker needs to start. key: of the service, None for none. hosts: as in `Guard`."""

    folder: str
    sources: Sources = field(default_factory=Sources)
    limits: Limits = field(default_factory=Limits)
    key: str | None = field(default=None, repr=False)
    hosts: tuple[str, ...] | None = None


def create_app(settings: Settings) -> FastAPI:
    """The service over the scenes of a folder, as an ASGI application.

    Raises: InputError: no such folder.
    """
    catalog, limits, metrics = (
        Catalog(Path(settings.folder), settings.sources),
        settings.limits,
        Metrics(),
    )
    bench = Workbench(limits, metrics)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        yield
        bench.close()

    app = FastAPI(
        title="drsplat",
        version=__version__,
        description=DESCRIPTION,
        lifespan=lifespan,
        docs_url=None,  # these load scripts from elsewhere
        redoc_url=None,
        responses=REFUSALS,
    )
    _add_errors(app, catalog)
    _add_watching(app, catalog, metrics)
    _add_scenes(app, catalog, bench)
    _add_questions(app, catalog, bench, limits)
    app.add_middleware(
        Guard, limits=limits, metrics=metrics, key=settings.key, hosts=settings.hosts
    )  # type: ignore[arg-type]
    return app


def app_from_environment() -> FastAPI:
    """As the workers make it: settings are in the environment, where they outlive a worker."""
    given = json.loads(os.environ[SETTINGS])
    given["sources"], given["limits"] = Sources(**given["sources"]), Limits(**given["limits"])
    given["hosts"] = None if given["hosts"] is None else tuple(given["hosts"])
    return create_app(Settings(**given))


def _add_errors(app: FastAPI, catalog: Catalog) -> None:
    @app.exception_handler(DrSplatError)
    async def refused(_: Any, error: DrSplatError) -> JSONResponse:
        statuses = {
            UnknownSceneError: 404,
            SceneFaultError: 503,
            BusyError: 503,
            MissingExtraError: 503,
        }
        status = statuses.get(type(error), 422)
        return _problem(status, without_paths(str(error), catalog.folder), type(error).__name__)

    @app.exception_handler(RequestValidationError)
    async def invalid(_: Any, error: RequestValidationError) -> JSONResponse:
        faults = [
            f"{'.'.join(map(str, fault['loc']))}: {fault['msg']}" for fault in error.errors()[:5]
        ]
        return _problem(422, "; ".join(faults)[:1000], "invalid")

    @app.exception_handler(HTTPException)
    async def http(_: Any, error: HTTPException) -> JSONResponse:
        return _problem(error.status_code, str(error.detail), "http", error.headers)


def _problem(status: int, error: str, kind: str, headers: Any = None) -> JSONResponse:
    # texts may hold halves of surrogate pairs, which are no UTF-8
    said = error.encode("utf-8", "replace").decode()
    more = {"retry-after": "1"} if status == 503 else {}
    return JSONResponse({"error": said, "kind": kind}, status, {**(headers or {}), **more})


def _add_watching(app: FastAPI, catalog: Catalog, metrics: Metrics) -> None:
    @app.get("/health", tags=["watching"])
    async def health() -> Health:
        """Whether the service lives; needs no key."""
        return Health(status="ok", num_scenes=len(catalog.folders()))

    @app.get(
        "/metrics",
        tags=["watching"],
        response_class=Response,
        responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}}},
    )
    async def numbers() -> Response:
        """Counters and times, in Prometheus' text format."""
        return Response(metrics.text(), media_type=metrics.content_type)


def _add_scenes(app: FastAPI, catalog: Catalog, bench: Workbench) -> None:
    @app.get("/scenes", tags=["scenes"])
    async def scenes() -> SceneList:
        """All scenes, without opening them."""
        return SceneList(scenes=[summarized(one) for one in await bench.run(catalog.summaries)])

    @app.get("/scenes/{scene}", tags=["scenes"])
    async def scene_details(scene: Scene) -> SceneDetails:
        """One scene: its size, its photos, which way is up."""
        return await bench.run(lambda: answers.details(catalog.scene(scene), scene))

    @app.get("/scenes/{scene}/photo", tags=["scenes"], response_class=Response, responses=PNG)
    async def photo(
        scene: Scene,
        view: Annotated[str, Query(min_length=1, max_length=500, description="a photo's name")],
        max_side: Annotated[int, Query(ge=16, le=Limits.side)] = 800,
    ) -> Response:
        """A photo of the scene, such as one that speaks for an answer, as PNG."""
        work = lambda: answers.photo(catalog.scene(scene), view, max_side)  # noqa: E731
        return Response(await bench.run(work), media_type="image/png")


def _add_questions(app: FastAPI, catalog: Catalog, bench: Workbench, limits: Limits) -> None:
    async def computed(scene: str, work: Callable[[AskableScene], T]) -> T:
        return await bench.run(lambda: work(catalog.scene(scene)))

    @app.post("/scenes/{scene}/query", tags=["questions"])
    async def query(scene: Scene, asked: Ids) -> Selected:
        """Which Gaussians a text, vector, image, point or click means."""
        return await computed(scene, lambda opened: answers.selected(opened, asked, limits))

    @app.post("/scenes/{scene}/locate", tags=["questions"])
    async def locate(scene: Scene, asked: Locate) -> Things:
        """The things that a query means, best first: centre, oriented box, the photos that say so."""
        return await computed(scene, lambda opened: answers.located(opened, asked, limits))

    @app.post("/scenes/{scene}/segment", tags=["questions"])
    async def segment(scene: Scene, asked: Segment) -> Segmented:
        """The best of some classes for each Gaussian."""
        return await computed(scene, lambda opened: answers.segmented(opened, asked))

    @app.post("/scenes/{scene}/what-is", tags=["questions"])
    async def what_is(scene: Scene, asked: WhatIs) -> Named:
        """The best words for what is at a point or a pixel."""
        return await computed(scene, lambda opened: answers.named(opened, asked))

    @app.post("/scenes/{scene}/picture", tags=["questions"], response_class=Response, responses=PNG)
    async def picture(scene: Scene, asked: Picture) -> Response:
        """A rendering as PNG, if wanted with what a query means kept in colour."""
        data = await computed(scene, lambda opened: answers.picture(opened, asked, limits))
        return Response(data, media_type="image/png")
