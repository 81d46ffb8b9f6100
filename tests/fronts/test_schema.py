"""One schema of queries: each front offers exactly its fields, beside some of its own that are listed here."""

import asyncio
import dataclasses
from collections.abc import Iterable, Sequence
from contextlib import closing
from typing import Any

import pytest

from drsplat import Query
from drsplat.cli import make_parser
from drsplat.fronts.commands.query_options import WAYS
from drsplat.query.schema import CUT, FIELDS, Place, QueryField, fields

NAMES = {field.name for field in FIELDS}
OF_A_SCENE = {
    "field", "scene", "views", "view", "encoder", "device", "vocabulary", "search_device", "save", "picture",
    "overwrite", "images", "dataparser_transforms", "max_side", "times",
}  # fmt: skip
OF_ALL_VERBS = {"help", "help_all", "json", "threads", "config", "print_config", "log", "debug"}
OF_MATCHES = {"top", "min_gaussians", "box", "tracks"}


def named(*places: Place, of: Sequence[QueryField] = FIELDS) -> set[str]:
    return {field.name for field in fields(*places, of=of)}


def test_a_query_has_the_fields_of_the_schema():
    own = {field.name: field.default for field in dataclasses.fields(Query)}
    assert own == {field.name: field.default for field in FIELDS}
    assert len(NAMES) == len(FIELDS)
    assert {place for field in FIELDS for place in field.places} == set(Place)
    assert WAYS.keys() == {field.kind for field in FIELDS}


def options_of(verb: str) -> dict[str, Any]:
    actions = make_parser([verb])._subparsers._group_actions[0].choices[verb]._actions
    return {action.dest: action.help for action in actions}


@pytest.mark.parametrize(("verb", "own"), [("select", set()), ("locate", OF_MATCHES)])
def test_verbs_that_ask_take_no_others(verb, own):
    assert options_of(verb).keys() == named(Place.COMMAND_LINE) | OF_A_SCENE | OF_ALL_VERBS | own


@pytest.mark.parametrize(
    ("verb", "offered"),
    [
        ("export", named(Place.COMMAND_LINE)),
        ("edit", named(Place.COMMAND_LINE)),
        ("segment", named(Place.COMMAND_LINE, of=CUT)),
        ("when", named(Place.COMMAND_LINE, Place.WORDS)),
        ("render", named(Place.COMMAND_LINE, Place.WORDS)),
        ("catalogue", named(Place.COMMAND_LINE, Place.CATALOGUE) - {"text"}),  # which is one of its own arguments
    ],
)
def test_other_verbs_take_what_is_of_their_sort(verb, offered):
    options = options_of(verb)
    assert options.keys() & NAMES == offered
    assert all(options[field.name].startswith(field.meaning) for field in CUT if field.name in offered)


def assert_offers(model: Any, offered: Iterable[str], own: Iterable[str] = ()) -> None:
    assert model.model_fields.keys() == {*offered, *own}
    described = {field.name: model.model_fields[field.name].description for field in FIELDS if field.name in offered}
    assert all(described[field.name].startswith(field.meaning) for field in FIELDS if field.name in offered)


def test_http():
    pytest.importorskip("pydantic")
    from drsplat.fronts.serving import query_fields

    assert_offers(query_fields.Select, named(Place.HTTP), {"ids"})
    assert_offers(query_fields.Locate, named(Place.HTTP), OF_MATCHES)
    assert_offers(query_fields.Picture, named(Place.HTTP), {"view", "photo", "max_side"})
    own = {"format", "only", "object", "time", "edits", "embeddings"}
    assert_offers(query_fields.Export, named(Place.HTTP), own)
    assert_offers(query_fields.Segment, named(Place.HTTP, of=CUT), {"classes", "labels"})
    assert_offers(query_fields.When, named(Place.HTTP, Place.WORDS), {"one", "relation", "other", "view"})
    own = {"top", "scenes", "box", "area", "since"}
    assert_offers(query_fields.AskCatalogue, named(Place.HTTP, Place.CATALOGUE), own)


def test_the_viewer():
    pytest.importorskip("pydantic")
    from drsplat.fronts.viewing.live.acts import Ask

    assert Ask.model_fields.keys() == named(Place.VIEWER) | {"act"}


def test_a_field_of_one_front_alone_is_noticed():
    pytest.importorskip("pydantic")
    from drsplat.fronts.serving import query_fields

    class Select(query_fields.Select):
        taste: str = ""

    with pytest.raises(AssertionError):
        assert_offers(Select, named(Place.HTTP), {"ids"})


def test_language_models(tmp_path):
    pytest.importorskip("mcp")
    from drsplat.fronts.serving.guards import Limits
    from drsplat.fronts.serving.metrics import Metrics
    from drsplat.fronts.serving.scene_folder import SceneFolder
    from drsplat.fronts.serving.tools import make_server
    from drsplat.fronts.serving.workbench import Workbench
    from drsplat.fronts.serving.worker import Workplace

    with closing(Workbench(Workplace(str(tmp_path)), Metrics())) as bench:
        listed = asyncio.run(make_server(SceneFolder(tmp_path), bench, Limits()).list_tools())
    assert {tool.name: tool.input_schema.get("properties", {}).keys() - {"scene"} for tool in listed} == {
        "list_scenes": set(),
        "about_scene": set(),
        "locate": named(Place.MCP) | {"on", "top", "box", "tracks"},
        "count": named(Place.MCP) | {"on"},
        "where_is": named(Place.MCP),
        "how_far_apart": named(Place.MCP, of=CUT) | {"first", "second"},
        "what_is_at": {"point", "names"},
        "what_is_at_pixel": {"view", "x", "y", "names"},
        "describe_region": {"center", "radius", "names"},
        "list_objects": {"top", "unsure"},
        "relations": {"relation", "to", "and_to"},
        "when": named(Place.MCP, Place.WORDS) | {"one", "relation", "other", "view"},
        "show": named(Place.MCP) | {"view"},
    }
