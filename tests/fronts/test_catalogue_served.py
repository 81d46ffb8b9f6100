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
from test_catalogue import WORDS
from test_glossary import descriptions, offenders, retired, schema_keys

from callers import Service, reason
from catalogued import write_scene
from command_line import error_of
from drsplat.fronts.serving.guards import Limits
from drsplat.fronts.serving.scene_folder import SceneFolder
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
def service(folder: Path) -> Iterator[Service]:
    with closing(Service(folder / "scenes", catalogue=str(folder / "flats.catalogue"))) as made:
        yield made


def asked(service: Service, **given: Any) -> Any:
    return service("POST", "/catalogue/ask", json=given)


@pytest.mark.slow
def test_matches_of_all_scenes_with_their_pictures(service, folder):
    answer = asked(service, text="mug").json()
    assert [one["scene"] for one in answer["matches"]] == ["kitchen", "o'hara"]
    assert (answer["measure"], answer["threshold_rule"], answer["exact"]) == ("cosine", "encoder", True)
    picture = service("GET", answer["matches"][1]["picture"])
    assert picture.headers["content-type"] == "image/jpeg"
    assert Image.open(io.BytesIO(picture.content)).size == (240, 180)
    assert picture.content == Catalogue.open(folder / "flats.catalogue").thumbnail("o'hara", 0)


def test_filters_and_what_is_not_there(service):
    def scenes(**more: Any) -> list[str]:
        return [one["scene"] for one in asked(service, text="mug", **more).json()["matches"]]

    assert scenes(scenes=["o'hara"]) == ["o'hara"]
    assert scenes(box=[-1, -1, -1, 1, 1, 1]) == ["kitchen"]
    assert scenes(since="2999-01-01T00:00:00Z") == []
    assert scenes(since="0500-01-01T00:00:00Z") == ["kitchen", "o'hara"]
    assert scenes(since="0001-01-01T00:00:00Z") == ["kitchen", "o'hara"]
    assert scenes(exclude=["red"]) == ["o'hara"]
    assert scenes(scenes=["x' OR 1 = 1 --"]) == []
    nothing = asked(service, text="elephant").json()
    assert (nothing["matches"], nothing["advice"].split(":")[0]) == ([], "no match in any scene")


def test_the_scenes_of_it(service, folder):
    listed = service("GET", "/catalogue")
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
def test_requests_that_make_no_sense(service, given, said):
    assert said in reason(asked(service, **given), 422)


def test_pictures_that_are_not_there(service, folder):
    for scene, number in (("nobody", 0), ("kitchen", 99), ("kitchen", -1)):
        answer = service("GET", "/catalogue/picture", params={"scene": scene, "object_id": number})
        assert str(folder) not in reason(answer, 422)


def test_no_catalogue_no_routes(folder):
    with closing(Service(folder / "scenes")) as made:
        assert asked(made, text="mug").status_code == 404
        assert not [path for path in made.app.openapi()["paths"] if "catalogue" in path]


def test_its_words_are_those_of_the_glossary(service):
    document = service.app.openapi()
    assert {"object_id", "scenes"} <= set(schema_keys(document))
    assert not offenders(schema_keys(document), retired())
    assert not [text for text in descriptions(document) if "thing" in text.replace("something", "").split()]


def test_a_catalogue_that_is_none_is_told_at_the_start(folder, capsys):
    scenes = str(folder / "scenes")
    assert "no catalogue is here" in error_of(capsys, "serve", scenes, "--catalogue", folder / "none")
    assert "expected a catalogue" in error_of(capsys, "serve", scenes, "--catalogue", scenes)


@pytest.mark.slow
def test_language_models_search_all_scenes(service, folder):
    pytest.importorskip("mcp", reason="the extra drsplat[mcp] is not installed")
    from drsplat.fronts.serving.tools import make_server

    scenes, bench = folder / "scenes", service.app.state.bench
    server, without = (
        make_server(SceneFolder(scenes, catalogue_path=path), bench, Limits())
        for path in (folder / "flats.catalogue", None)
    )
    given = {"text": "mug", "scenes": ["o'hara"]}
    result = asyncio.run(server.call_tool("search_all_scenes", given))
    for one, offers in ((server, True), (without, False)):
        assert ("search_all_scenes" in [tool.name for tool in asyncio.run(one.list_tools())]) == offers
    told = json.loads(result.content[0].text)
    assert [(one["scene"], one["object_id"]) for one in told["matches"]] == [("o'hara", 0)]
