"""One word, one thing: the retired words of docs/glossary.md stand in no public name, option, key or heading."""

import argparse
import ast
import asyncio
import inspect
import re
from collections.abc import Iterable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

import drsplat
from drsplat.cli import VERBS, make_parser

ROOT = Path(__file__).resolve().parents[2]
GLOSSARY = ROOT / "docs" / "glossary.md"
# `docs/evaluation.md` is generated; README.md quotes commands.
FOLDERS = (ROOT, ROOT / "docs", ROOT / "docs/measured")
DOCUMENTS = sorted([*(path for folder in FOLDERS for path in folder.glob("*.md")), ROOT / "world/README.md"])
KEYED = ("fronts/commands", "evaluation/demo", "fronts/serving", "evaluation")  # what makes JSON that people read
THEIRS = {
    "info", "objects", "things",  # files of LERF-OVS
    "asked",  # what a worker is sent, between two processes of ours
}  # fmt: skip
VERB = "segment"  # is no noun: it stands alone
PROSE = (
    "speaks for", "speak for", "not meant", "and leave", "say what is in", "if wanted", "thing", "things", "unwanted",
    "asked for", "instance",
)  # fmt: skip
NO_BEGINNING = (
    "a", "an", "the", "of", "what", "who", "where", "how", "as", "also", "never", "in", "behind",
    "this", "these", "it", "they", "things", "for",
)  # fmt: skip


def retired() -> set[str]:
    """The third column of the glossary's tables."""
    rows = re.findall(r"^\| [^|]+ \| [^|]+ \| ([^|]+) \|$", GLOSSARY.read_text(), re.MULTILINE)
    return {word.strip() for row in rows for word in row.split(",")} - {"never", ""}


def parts(name: str) -> str:
    """ "mask_ids", "--min-gaussians" and "MaskIds" as words with spaces around each."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    return f" {' '.join(re.findall('[a-z]+', spaced.lower()))} "


def offenders(names: Iterable[str], words: Iterable[str]) -> set[str]:
    words = list(words)
    return {
        name
        for name in names
        if any(f" {word} " in parts(name) for word in words)
        or (f" {VERB} " in parts(name) and parts(name).strip() != VERB)
    }


def public_names() -> Iterator[str]:
    for name in drsplat.__all__:
        yield name
        thing = getattr(drsplat, name)
        if inspect.isclass(thing):
            yield from (one for one in vars(thing) if not one.startswith("_"))
            for _, method in inspect.getmembers(thing, callable):
                yield from parameters(method)  # also of __init__: the fields of a dataclass
        elif callable(thing):
            yield from parameters(thing)


def parameters(thing: Any) -> list[str]:
    try:
        return list(inspect.signature(thing).parameters)
    except (TypeError, ValueError):  # of builtins
        return []


def actions() -> Iterator[tuple[str, argparse.Action]]:
    """Every option and argument, with its verb."""
    (verbs,) = (action.choices for action in make_parser()._actions if action.choices)
    for verb, parser in verbs.items():
        yield from ((verb, action) for action in parser._actions)


def json_keys() -> Iterator[str]:
    """The keys of dictionaries that are written out in the code that prints JSON."""
    for folder in KEYED:
        for path in (ROOT / "src/drsplat" / folder).glob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                keys = node.keys if isinstance(node, ast.Dict) else []
                yield from (key.value for key in keys if isinstance(key, ast.Constant) and isinstance(key.value, str))


def parts_of(node: Any) -> Iterator[dict[str, Any]]:
    """Every dictionary within a JSON document."""
    if isinstance(node, dict):
        yield node
    for value in node.values() if isinstance(node, dict) else node if isinstance(node, list) else ():
        yield from parts_of(value)


def schema_keys(document: Any) -> set[str]:
    """Properties and parameters of a JSON schema or an OpenAPI document."""
    named = [(part.get("properties"), part.get("parameters")) for part in parts_of(document)]
    keys = {key for properties, _ in named if isinstance(properties, dict) for key in properties}
    return keys | {one["name"] for _, given in named if isinstance(given, list) for one in given if "name" in one}


def descriptions(document: Any) -> list[str]:
    told = [part.get(key) for part in parts_of(document) for key in ("description", "title")]
    return [text for text in told if isinstance(text, str)]


@pytest.fixture(scope="module")
def openapi(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    pytest.importorskip("fastapi")
    from drsplat.fronts.serving.app import Settings, create_app

    folder = tmp_path_factory.mktemp("scenes")
    (folder / "none").mkdir()
    return create_app(Settings(str(folder))).openapi()


@pytest.fixture(scope="module")
def tools(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    pytest.importorskip("mcp")
    from drsplat.fronts.serving.guards import Limits
    from drsplat.fronts.serving.metrics import Metrics
    from drsplat.fronts.serving.scene_folder import SceneFolder
    from drsplat.fronts.serving.tools import make_server
    from drsplat.fronts.serving.workbench import Workbench
    from drsplat.fronts.serving.worker import Workplace

    folder = tmp_path_factory.mktemp("scenes")
    with closing(Workbench(Workplace(str(folder)), Metrics())) as bench:
        made = asyncio.run(make_server(SceneFolder(folder), bench, Limits()).list_tools())
    return [tool.model_dump(mode="json") for tool in made]


def test_the_glossary_names_what_is_retired():
    assert {"segments", "thing", "instance", "question", "asked", "found", "unwanted"} <= retired()
    terms = re.findall(r"^\| ([^|]+) \|", GLOSSARY.read_text(), re.MULTILINE)
    terms = [term for term in terms if term != "term"]
    assert len(terms) == len(set(terms)) > 30
    assert not {term.split(" (")[0] for term in terms} & retired()


def test_it_can_fail_but_not_for_verbs_and_longer_words():
    bad = {"segment_id", "num_segments", "Segments", "--things", "found", "asked_for", "instance_index", "ThingCount"}
    good = {"segment", "load_segmenter", "Segmentation", "nothing", "foundry"}
    assert offenders(bad | good, retired()) == bad


def test_public_names():
    assert not offenders(public_names(), retired())


def test_options():
    flags = {flag for _, action in actions() for flag in (action.option_strings or [action.dest])}
    assert {"--threshold", "--min-gaussians"} <= flags
    assert not offenders(flags, retired())


def test_verbs_have_no_second_name():
    assert {verb for verb, _ in actions()} == set(VERBS)


def test_json_keys():
    keys = set(json_keys())
    assert {"num_matches", "num_masks", "threshold_rule"} <= keys
    assert not offenders(keys - THEIRS, retired())


def test_http_and_language_models(openapi, tools):
    for document, expected in ((openapi, {"matches", "top", "view"}), (tools, {"text", "matches", "top"})):
        keys = schema_keys(document)
        assert expected <= keys
        assert not offenders(keys, retired())
    routes = {part for path in openapi["paths"] for part in path.split("/") if part}
    assert not offenders(routes | {tool["name"] for tool in tools}, retired())


def test_headings_and_options_of_documents():
    for document in DOCUMENTS:
        text = document.read_text(encoding="utf-8")
        plain = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
        headings = [re.sub(r"`[^`]*`", "", one) for one in re.findall(r"^#+ (.+)$", plain, re.MULTILINE)]
        flags = re.findall(r"(?<![\w-])--[a-z][a-z-]+", text)
        bad = [one for one in headings if any(f" {word} " in parts(one) for word in retired() - {"asked"})]
        assert not bad, document.name
        assert not offenders(set(flags), retired()), document.name


@pytest.mark.parametrize(
    ("option", "text"),
    [(f"{verb} {'/'.join(one.option_strings) or one.dest}", one.help or "") for verb, one in actions()],
)
def test_helps_begin_with_a_noun_or_a_verb(option, text):
    first = re.split(r"[\s,:;]", text)[0]
    assert re.match(r"[A-Za-z{.]", first), f"{option}: {text}"
    assert first.lower() not in NO_BEGINNING, f"{option}: {text}"


def test_nobody_speaks_of_things(openapi, tools):
    told = " | ".join([*(action.help or "" for _, action in actions()), *descriptions(openapi), *descriptions(tools)])
    told = told.replace("object,things,stuff,texture", "").replace("object, things, stuff, texture", "")
    assert re.findall(rf"[^|]*\b(?:{'|'.join(PROSE)})\b[^|]*", told) == []
