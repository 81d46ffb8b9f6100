"""Null for what may be left out is what leaving it out is: libraries of clients send it for every optional field."""

import asyncio
from collections.abc import Iterator
from typing import Any, get_args

import pytest

pytest.importorskip("fastapi", reason="the extra drsplat[serve] is not installed")

from pydantic import BaseModel, ValidationError

from drsplat.errors import DrSplatError
from drsplat.fronts.serving.guards import Limits
from drsplat.fronts.serving.live import NewView
from drsplat.fronts.serving.query_fields import AskCatalogue, Request
from drsplat.fronts.serving.scene_folder import SceneFolder
from drsplat.fronts.serving.workbench import Job, Workbench
from drsplat.fronts.serving.worker import ANSWERS

SOUND: dict[str, Any] = {
    "text": "mug", "classes": ["mug"], "one": "mug", "other": "table", "relation": "on", "first": "mug",
    "second": "table", "to": "table", "view": "a.png", "x": 1.0, "y": 2.0, "fx": 500.0, "point": [0.0, 0.0, 0.0],
    "center": [0.0, 0.0, 0.0], "radius": 1.0, "name": "a.png", "picture": "AAAA", "pose": {}, "lens": {"fx": 500.0},
}  # fmt: skip
"""A value for each field that is required somewhere."""


def models_in(kind: Any) -> Iterator[type[BaseModel]]:
    """The models of requests in an annotation, and in their fields."""
    if isinstance(kind, type) and issubclass(kind, Request):
        yield kind
        for field in kind.model_fields.values():
            yield from models_in(field.annotation)
    for part in get_args(kind):
        yield from models_in(part)


BODIES = [way.asked for way in ANSWERS.values() if way.asked] + [AskCatalogue, NewView]
MODELS = list(dict.fromkeys(model for body in BODIES for model in models_in(body)))


def test_models_are_found_in_models():
    assert {"Click", "Pose", "Lens"} < {model.__name__ for model in MODELS}


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.__name__)
def test_null_in_a_body_is_the_default(model):
    fields = model.model_fields
    sound = {name: SOUND[name] for name, field in fields.items() if field.is_required()}
    bare = model.model_validate(sound)
    optional = [name for name in fields if name not in sound]
    for nulls in ({name: None} for name in optional):
        assert model.model_validate({**sound, **nulls}) == bare
    assert model.model_validate({**sound, **dict.fromkeys(optional)}) == bare
    for name in sound:
        with pytest.raises(ValidationError) as refused:
            model.model_validate({**sound, name: None})
        assert refused.value.errors()[0]["loc"][0] == name
    with pytest.raises(ValidationError, match="treshold"):
        model.model_validate({**sound, "treshold": None})


class Bench(Workbench):
    """A workbench that keeps what it is asked, and answers nothing."""

    def __init__(self) -> None:
        self.jobs: list[Job] = []

    async def run(self, job: Job) -> Any:
        self.jobs.append(job)
        raise DrSplatError("asked")


def test_null_for_a_tool_is_the_default(tmp_path):
    pytest.importorskip("mcp", reason="the extra drsplat[mcp] is not installed")
    from mcp.server.mcpserver.exceptions import ToolError

    from drsplat.fronts.serving.tools import make_server

    for made in ("room/room.field", "catalogue"):
        (tmp_path / made).mkdir(parents=True)
    folder, bench = SceneFolder(tmp_path, catalogue_path=tmp_path / "catalogue"), Bench()
    server: Any = make_server(folder, bench, Limits())

    def asked(tool: str, arguments: dict[str, Any]) -> tuple[str, Any]:
        with pytest.raises(ToolError, match=r"^asked$"):
            asyncio.run(server.call_tool(tool, arguments))
        return bench.jobs[-1].act, bench.jobs[-1].asked

    for tool in asyncio.run(server.list_tools()):
        required = tool.input_schema.get("required", [])
        sound = {name: SOUND[name] for name in required}
        optional = tool.input_schema["properties"].keys() - sound.keys()
        bare = asked(tool.name, sound)
        for nulls in (*({name: None} for name in optional), dict.fromkeys(optional)):
            assert asked(tool.name, {**sound, **nulls}) == bare
        for name in required:
            with pytest.raises(ToolError, match=f"^{tool.name}: {name}: "):
                asyncio.run(server.call_tool(tool.name, {**sound, name: None}))
        with pytest.raises(ToolError, match="no argument treshold"):
            asyncio.run(server.call_tool(tool.name, {**sound, "treshold": None}))
