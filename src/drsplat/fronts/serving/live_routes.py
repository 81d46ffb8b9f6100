"""Routes for views that are sent to a scene."""

from collections.abc import Callable
from typing import Any

from fastapi import FastAPI, Request, Response

from .adding import Adding
from .live import LIST, TAKE, NewView, ViewList, ViewState
from .models import Problem
from .replies import Reply, problem
from .responses import Scene, sent
from .workbench import Job, Workbench

_REFUSALS = {
    403: "the service takes no photos, or not from this page", 409: "another photo has the name",
    429: "many photos wait already", 507: "the disk is full",
}  # fmt: skip
_RESPONSES: dict[int | str, dict[str, Any]] = {
    status: {"model": Problem, "description": text} for status, text in _REFUSALS.items()
}
_RESPONSES[200] = {"model": ViewState, "description": "sent before"}


def add_live(app: FastAPI, bench: Workbench, adding: Adding, why_not: Callable[[str | None, str], str]) -> None:
    """Add the routes. why_not: of the headers Origin and Host of a request, why it may not change a scene, or ""."""

    @app.get("/scenes/{scene}/views", tags=["views"], response_model=ViewList)
    async def views(scene: Scene) -> Response:
        """List the photos that were sent to a scene, and what has become of each."""
        asked = {"working": adding.working(scene), "problem": adding.problem(scene)}
        return sent(await bench.run(Job(LIST, scene, asked)))

    @app.post("/scenes/{scene}/views", tags=["views"], status_code=202, response_model=ViewState, responses=_RESPONSES)
    async def take_view(scene: Scene, view: NewView, request: Request) -> Response:
        """Take a posed photo: it is on disk when this is answered, and added to the scene's field within seconds."""
        refused = why_not(request.headers.get("origin"), request.headers.get("host", ""))
        if refused:
            return sent(problem(403, refused, "not let"))

        def added(reply: Reply) -> None:
            if reply.status == 202:
                adding.notice(scene)

        return sent(await bench.run(Job(TAKE, scene, view.model_dump(mode="json", exclude_none=True), added)))
