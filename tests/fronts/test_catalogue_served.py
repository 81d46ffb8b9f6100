"""A catalogue over HTTP and for language models."""

import asyncio
import io
import json
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from catalogued import write_scene
from command_line import error_of

pytest.importorskip("fastapi", reason="the extra drsplat[serve] is not installed")
pytest.importorskip("httpx", reason="httpx, which the tests ask with, is not installed")

import httpx
from test_catalogue import WORDS
from test_glossary import descriptions, offenders, retired, schema_keys

from drsplat.fronts.serving.app import Settings, create_app
from drsplat.query.catalogue import Catalogue


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenes, and the catalogue of them beside these."""
    made = tmp_path_factory.mktemp("served")
    catalogue = Catalogue.open(made / "flats.catalogue")
    for number, (name, words) in enumerate(WORDS.items()):
        catalogue.add(write_scene(made / "scenes" / name, words, moved=10.0 * number))
    return made


@pytest.fixture(scope="module")
def app(folder: Path) -> Iterator[Any]:
    made = create_app(Settings(str(folder / "scenes"), catalogue=str(folder / "flats.catalogue")))
    with closing(made.state.bench):
        yield made


def asked(app: Any, method: str, path: str, **given: Any) -> Any:
    async def ask() -> Any:
        async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://here") as client:
            return await client.request(method, path, **given)

    return asyncio.run(ask())


@pytest.mark.slow
def test_matches_of_all_scenes_with_their_pictures(app, folder):
    answer = asked(app, "POST", "/catalogue/ask", json={"text": "mug"}).json()
    assert [one["scene"] for one in answer["matches"]] == ["kitchen", "o'hara"]
    assert (answer["measure"], answer["threshold_rule"], answer["exact"]) == ("cosine", "encoder", True)
    picture = asked(app, "GET", answer["matches"][1]["picture"])
    assert picture.headers["content-type"] == "image/jpeg"
    assert Image.open(io.BytesIO(picture.content)).size == (240, 180)
    assert picture.content == Catalogue.open(folder / "flats.catalogue").thumbnail("o'hara", 0)


def test_filters_and_what_is_not_there(app):
    def scenes(**more: Any) -> list[str]:
        answer = asked(app, "POST", "/catalogue/ask", json={"text": "mug", **more})
        return [one["scene"] for one in answer.json()["matches"]]

    assert scenes(scenes=["o'hara"]) == ["o'hara"]
    assert scenes(box=[-1, -1, -1, 1, 1, 1]) == ["kitchen"]
    assert scenes(since="2999-01-01T00:00:00Z") == []
    assert scenes(since="0500-01-01T00:00:00Z") == ["kitchen", "o'hara"]
    assert scenes(since="0001-01-01T00:00:00Z") == ["kitchen", "o'hara"]
    assert scenes(exclude=["red"]) == ["o'hara"]
    assert scenes(scenes=["x' OR 1 = 1 --"]) == []
    nothing = asked(app, "POST", "/catalogue/ask", json={"text": "elephant"}).json()
    assert (nothing["matches"], nothing["advice"].split(":")[0]) == ([], "no match in any scene")


def test_the_scenes_of_it(app, folder):
    listed = asked(app, "GET", "/catalogue")
    assert [(one["name"], one["num_objects"], one["state"]) for one in listed.json()["scenes"]] == [
        ("kitchen", 3, "current"), ("o'hara", 3, "current"),
    ]  # fmt: skip
    assert str(folder) not in listed.text


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({}, "exactly one of text"),
        ({"text": "mug", "vector": [1.0]}, "exactly one of text"),
        ({"text": "mug", "top": 10**9}, "top"),
        ({"text": "mug", "wrong": 1}, "wrong"),
        ({"text": "m" * 201}, "text"),
        ({"text": "mug", "scenes": ["a"] * 65}, "scenes"),
        ({"text": "mug", "scenes": ["a\0"]}, "a scene's name"),
        ({"text": "mug", "box": [1, 0, 0, 0, 1, 1]}, "box"),
        ({"text": "mug", "since": "yesterday"}, "since"),
        ({"text": "mug", "since": "2026-01-01"}, "with its zone"),
        ({"text": "mug", "since": "0001-01-01T00:00:00+14:00"}, "years 1 to 9999"),
        ({"text": "mug", "since": "9999-12-31T23:59:59-14:00"}, "years 1 to 9999"),
        ({"vector": [1.0, 2.0]}, "the query has 2 numbers"),
        ({"image": "no base64"}, "expected base64"),
    ],
)
def test_requests_that_make_no_sense(app, given, said):
    answer = asked(app, "POST", "/catalogue/ask", json=given)
    assert answer.status_code == 422
    assert said in answer.json()["error"]


def test_pictures_that_are_not_there(app, folder):
    for which in ({"scene": "nobody", "object_id": 0}, {"scene": "kitchen", "object_id": 99}):
        answer = asked(app, "GET", "/catalogue/picture", params=which)
        assert (answer.status_code, str(folder) in answer.text) == (422, False)
    assert asked(app, "GET", "/catalogue/picture", params={"scene": "kitchen", "object_id": -1}).status_code == 422


def test_no_catalogue_no_routes(folder):
    made = create_app(Settings(str(folder / "scenes")))
    with closing(made.state.bench):
        assert asked(made, "POST", "/catalogue/ask", json={"text": "mug"}).status_code == 404
        assert not [path for path in made.openapi()["paths"] if "catalogue" in path]


def test_its_words_are_those_of_the_glossary(app):
    document = app.openapi()
    assert {"object_id", "scenes"} <= set(schema_keys(document))
    assert not offenders(schema_keys(document), retired())
    assert not [text for text in descriptions(document) if "thing" in text.replace("something", "").split()]


def test_a_catalogue_that_is_none_is_told_at_the_start(folder, capsys):
    scenes = str(folder / "scenes")
    assert "no catalogue is here" in error_of(capsys, "serve", scenes, "--catalogue", folder / "none")
    assert "expected a catalogue" in error_of(capsys, "serve", scenes, "--catalogue", scenes)


@pytest.mark.slow
def test_language_models_search_all_scenes(folder):
    pytest.importorskip("mcp", reason="the extra drsplat[mcp] is not installed")
    from drsplat.fronts.serving.guards import Limits
    from drsplat.fronts.serving.metrics import Metrics
    from drsplat.fronts.serving.scene_folder import SceneFolder
    from drsplat.fronts.serving.tools import make_server
    from drsplat.fronts.serving.workbench import Workbench
    from drsplat.fronts.serving.worker import Workplace

    scenes, path = folder / "scenes", folder / "flats.catalogue"
    with closing(Workbench(Workplace(str(scenes), catalogue=str(path)), Metrics())) as bench:
        server = make_server(SceneFolder(scenes, catalogue_path=path), bench, Limits())
        given = {"text": "mug", "scenes": ["o'hara"]}
        result = asyncio.run(server.call_tool("search_all_scenes", given))
        names = [tool.name for tool in asyncio.run(server.list_tools())]
        without = make_server(SceneFolder(scenes), bench, Limits())
        assert "search_all_scenes" not in [tool.name for tool in asyncio.run(without.list_tools())]
    assert "search_all_scenes" in names
    told = json.loads(result.content[0].text)
    assert [(one["scene"], one["object_id"]) for one in told["matches"]] == [("o'hara", 0)]
