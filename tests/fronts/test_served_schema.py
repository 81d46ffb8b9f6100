"""All routes of `drsplat serve`, asked what fits their description and what does not: never a fault, always as told.

DRSPLAT_EXAMPLES is how many requests of each kind every route gets.
"""

import os
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import pytest
from hypothesis import HealthCheck, given, seed, settings
from hypothesis import strategies as st

pytest.importorskip("schemathesis", reason="schemathesis is not installed")
pytest.importorskip("fastapi", reason="the extra drsplat[serve] is not installed")

from schemathesis import GenerationMode, checks
from schemathesis.openapi import from_asgi

from catalogued import write_scene
from drsplat.fronts.serving.app import Settings, create_app
from drsplat.query.catalogue import Catalogue

EXAMPLES = int(os.environ.get("DRSPLAT_EXAMPLES", "8"))
SEED = int(os.environ.get("DRSPLAT_SEED", "0"))
WORDS = ("red mug", "wooden table", "green plant")
KEY = "0123456789abcdef-key"
PRESENT = {
    "scene": ["room"], "text": ["mug", "red mug, not blue", "table"], "view": ["a.png", "b.png"], "one": ["mug"],
    "other": ["table"], "names": [["mug", "table"]], "classes": [["mug", "wooden table"]], "negatives": [["object"]],
    "number": [0, 2, 3], "object_id": [0, 3], "scenes": [["room"], []], "exclude": [["red"]],
    "point": [[0.0, 0.0, 0.0], [3.0, 0.1, 0.0]], "click": [{"view": "a.png", "x": 40.0, "y": 30.0}],
    "since": ["2026-01-01T00:00:00Z", "0001-01-01T00:00:00+14:00"],
}  # fmt: skip
"""Values that are there, of parameters whose schema cannot say which are."""


@pytest.fixture(scope="module")
def schema(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    made = tmp_path_factory.mktemp("served")
    write_scene(made / "scenes" / "room", WORDS)
    Catalogue.open(made / "all.catalogue").add(made / "scenes" / "room")
    settings = Settings(str(made / "scenes"), key=KEY, catalogue=str(made / "all.catalogue"), takes_views=True)
    app = create_app(settings)

    async def running(scope: Any, receive: Any, send: Any) -> None:
        """Give the key; start and stop nothing: schemathesis would do so for every request."""
        if scope["type"] != "lifespan":
            await app({**scope, "headers": [*scope["headers"], (b"x-api-key", KEY.encode())]}, receive, send)
            return
        for moment in ("startup", "shutdown"):
            await receive()
            await send({"type": f"lifespan.{moment}.complete"})

    with closing(app.state.bench), closing(app.state.adding):
        yield from_asgi("/openapi.json", running)


PLAIN = [("GET", path) for path in ("/health", "/metrics", "/scenes", "/catalogue")]  # without a parameter
ROUTES = [
    ("GET", "/scenes/{scene}"), ("GET", "/scenes/{scene}/photo"), ("GET", "/scenes/{scene}/objects"),
    ("GET", "/scenes/{scene}/objects/{number}/picture"), ("GET", "/scenes/{scene}/objects/{number}/ply"),
    ("POST", "/scenes/{scene}/select"), ("POST", "/scenes/{scene}/locate"), ("POST", "/scenes/{scene}/when"),
    ("POST", "/scenes/{scene}/segment"), ("POST", "/scenes/{scene}/what-is"), ("POST", "/scenes/{scene}/picture"),
    ("POST", "/scenes/{scene}/export"), ("GET", "/scenes/{scene}/views"), ("POST", "/scenes/{scene}/views"),
    ("POST", "/catalogue/ask"), ("GET", "/catalogue/picture"),
]  # fmt: skip
SOUND: dict[str, dict[str, Any]] = {
    "/scenes/{scene}/photo": {"query": {"view": "a.png"}},
    "/scenes/{scene}/select": {"body": {"text": "red mug", "ids": True}},
    "/scenes/{scene}/locate": {"body": {"text": "mug", "box": "free"}},
    "/scenes/{scene}/segment": {"body": {"classes": ["mug", "table"], "labels": True}},
    "/scenes/{scene}/what-is": {"body": {"point": [0.0, 0.0, 0.0], "names": ["mug", "table"]}},
    "/scenes/{scene}/picture": {"body": {"text": "mug", "max_side": 64}},
    "/scenes/{scene}/export": {"body": {"text": "mug", "format": "glb"}},
    "/catalogue/ask": {"body": {"text": "mug", "scenes": ["room"]}},
    "/catalogue/picture": {"query": {"scene": "room", "object_id": 0}},
}
"""Requests that have an answer, of routes that need more than the names of a scene and an object."""
UNANSWERED = (
    ("POST", "/scenes/{scene}/when"),  # of a scene that stands still
    ("POST", "/scenes/{scene}/views"),  # of a field that does not say how it was made
)
PATIENCE_S = 600  # for an answer: on a busy machine the first one, with its imports, takes longer than the usual 10
CHECKS = [
    checks.not_a_server_error, checks.status_code_conformance, checks.content_type_conformance,
    checks.response_schema_conformance, checks.response_headers_conformance,
]  # fmt: skip


def test_no_route_is_left_out(schema):
    described = {(one.ok().method.upper(), one.ok().path) for one in schema.get_all_operations()}
    assert described == {*ROUTES, *PLAIN}


@pytest.mark.slow
@pytest.mark.parametrize(("method", "path"), [route for route in (*PLAIN, *ROUTES) if route not in UNANSWERED], ids=str)
def test_answers_are_as_described(schema, method, path):
    names = {"scene": "room", "number": 0} if "{number}" in path else {"scene": "room"} if "{scene}" in path else {}
    case = schema[path][method].Case(path_parameters=names, **SOUND.get(path, {}))
    assert case.call_and_validate(checks=CHECKS, timeout=PATIENCE_S).status_code == 200


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "path", "mode"),
    [
        *((*route, GenerationMode.POSITIVE) for route in (*PLAIN, *ROUTES)),
        *((*route, GenerationMode.NEGATIVE) for route in ROUTES),
    ],
    ids=str,
)
def test_what_is_answered_is_what_is_described(schema, method, path, mode):
    operation = schema[path][method]

    @seed(SEED)
    @settings(max_examples=EXAMPLES, deadline=None, database=None, suppress_health_check=list(HealthCheck))
    @given(case=operation.as_strategy(generation_mode=mode), data=st.data())
    def asked(case: Any, data: Any) -> None:
        for given_here in (case.path_parameters, case.query, case.body):
            for name in sorted(given_here.keys() & PRESENT.keys()) if isinstance(given_here, dict) else ():
                if data.draw(st.integers(0, 3)):
                    given_here[name] = data.draw(st.sampled_from(PRESENT[name]))
        case.call_and_validate(checks=CHECKS, timeout=PATIENCE_S)

    asked()
