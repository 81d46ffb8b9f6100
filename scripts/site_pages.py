"""Hook of mkdocs: pages of the site that lie elsewhere in the repository or are made from the code.

docs/ stays readable as it lies there; what points out of it is turned here.
"""

import argparse
import ast
import inspect
import json
import os
import posixpath
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from mkdocs.utils.templates import TemplateContext

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "scripts"), str(ROOT)]
import make_gallery  # noqa: E402

GALLERY = Path(os.environ.get("DRSPLAT_GALLERY", ROOT / "build/gallery"))  # of make_gallery.py
DEMO = "demo"  # the scene of the front page
BROUGHT = {
    "README.md": "overview.md", "CHANGELOG.md": "changelog.md", "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "security.md", "CODE_OF_CONDUCT.md": "code_of_conduct.md", "world/README.md": "world.md",
}  # fmt: skip
"""Documents outside of docs/, and the pages that they become."""
_LINK = re.compile(r"(\[[^\]]*\])\(([^)\s]+)\)")
_CODE = re.compile(r"(^```.*?^```$|`[^`\n]+`)", re.MULTILINE | re.DOTALL)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    pages = {page: (ROOT / source).read_text(encoding="utf-8") for source, page in BROUGHT.items()}
    pages |= {
        "examples.md": examples(), "benchmarks.md": benchmarks(),
        "reference/python.md": python_names(), "reference/command_line.md": command_line(),
        "reference/http.md": http(), "reference/mcp.md": mcp(),
    }  # fmt: skip
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    for one in make_gallery.read_list(GALLERY):
        for name in (f"{one['name']}.html", f"{one['name']}.jpg"):
            files.append(File.generated(config, f"gallery/{name}", abs_src_path=str(GALLERY / name)))
    for file in list(files):
        if file.src_uri.endswith(".json"):
            files.remove(file)
    return files


def on_template_context(context: TemplateContext, template_name: str, config: MkDocsConfig) -> TemplateContext:
    """Let 404.html find its styles in a folder; on a server site_url says where they are."""
    if template_name == "404.html" and not config.site_url:
        context["base_url"] = "."
    return context


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    origin = {made: source for source, made in BROUGHT.items()}.get(page.file.src_uri, f"docs/{page.file.src_uri}")
    here = posixpath.dirname(page.file.src_uri)

    def turned(found: re.Match[str]) -> str:
        text, target = found.groups()
        if re.match(r"[a-z]+:|#", target):
            return found[0]
        path, mark, anchor = target.partition("#")
        meant = posixpath.normpath(posixpath.join(posixpath.dirname(origin), path))
        made = BROUGHT.get(meant) or (meant.removeprefix("docs/") if meant.startswith("docs/") else None)
        if made is None or files.get_file_from_path(made) is None:
            return f"{text[1:-1]} (`{meant}`)" if (ROOT / meant).exists() else found[0]
        return f"{text}({posixpath.relpath(made, here or '.')}{mark}{anchor})"

    for place, made in PLACES.items():
        if place in markdown:
            markdown = markdown.replace(place, made())
    parts = _CODE.split(markdown)
    return "".join(part if number % 2 else _LINK.sub(turned, part) for number, part in enumerate(parts))


def gallery() -> str:
    """Return a picture and a line for each page."""
    return "\n\n".join(_exhibit(one) for one in exhibits())


def exhibits() -> list[dict[str, Any]]:
    """Return what the gallery has. Raises: PluginError: the demo is not in it."""
    made = make_gallery.read_list(GALLERY)
    if not any(one["name"] == DEMO for one in made):
        raise PluginError(f"{GALLERY} has no page of the demo: run scripts/site, or scripts/make_gallery.py first")
    return made


def live() -> str:
    """Return the demo's page for the front page: its picture, until somebody starts it."""
    one = next(one for one in exhibits() if one["name"] == DEMO)
    asked = ", ".join(f"“{text}”" for text in one["matches"])
    clearest = min(one["matches"], key=lambda text: one["matches"][text] or len(one["matches"]))
    size = f"{one['page_bytes'] / 1e6:.1f} MB"
    return (
        f'<div class="live" data-start="Start ({size})" data-ask="{clearest}" '
        'data-title="The demo, to ask, click and turn" markdown>\n'
        f'<div class="poster"><img src="gallery/{DEMO}.jpg" alt="A room with boxes around what was found"></div>\n\n'
        f"A room of {one['num_shown']:,} Gaussians, of {one['num_gaussians']:,} in the scene, registered from "
        f"{one['num_photos']} photos by the models that ship, and asked for {asked}. It is one file, which `drsplat "
        f"view --export` writes: [open it on a page of its own](gallery/{DEMO}.html), or see "
        "[the gallery](gallery.md).\n\n</div>"
    )


def numbers() -> str:
    """Return how good answers are, from docs/answers.json, as the evaluation's own page has it."""
    from benchmarks.suite.headline import PLACES as SAID
    from benchmarks.suite.headline import asked

    answers = json.loads((ROOT / "docs/answers.json").read_text(encoding="utf-8"))
    found = [one for one in asked(answers) if one.masks == "graph"]
    tiles = [
        (f"{one.over('objects')[0]:.0f} %", f"IoU of what a word selects, in {len(one.records)} {SAID[one.kind]}")
        for one in found
    ]
    absent = " and ".join(f"{one.share('found', 'objects'):.0f} %" for one in found)
    places = " and ".join(SAID[one.kind] for one in found)
    tiles.append((absent, f"of words for what is not there find something all the same, in {places}"))
    made = "".join(f"<div><b>{number}</b> {said}</div>\n" for number, said in tiles)
    return (
        f'<div class="numbers">\n{made}</div>\n\nMasks are those of the segmenter that ships; words are asked by '
        "genuine vectors of CLIP. Made by `python -m benchmarks.suite`, read from its results when this page was "
        "built: [how it is measured, and beside other systems](evaluation.md)."
    )


def _exhibit(one: dict[str, Any]) -> str:
    name, page = one["name"], f"gallery/{one['name']}.html"
    found = "; ".join(f"{text}: {count or 'no match'}" for text, count in one["matches"].items())
    return (
        f"## {name}\n\n[![{name}, with boxes around what was found](gallery/{name}.jpg)]({page})\n\n"
        f"[Open the page]({page}): {one['num_shown']:,} of {one['num_gaussians']:,} Gaussians, "
        f"{one['page_bytes'] / 1e6:.1f} MB, registered from {one['num_photos']} photos. Matches: {found}."
    )


def examples() -> str:
    """Every file of examples/, its docstring as its text."""
    text = "# Examples\n\nEach is a file of `examples/` that the tests run.\n"
    for path in sorted((ROOT / "examples").glob("*.py")):
        source = path.read_text(encoding="utf-8")
        title = path.stem[3:].replace("_", " ").capitalize()
        text += f"\n## {title}\n\n`examples/{path.name}`\n\n```python\n{source}```\n"
    return text


def benchmarks() -> str:
    """What each script of benchmarks/ answers, from its docstring."""
    text = (
        "# Benchmarks\n\nOne script for each question; they run in a checkout and print the machine first. What they "
        "printed here is in [speed](speed.md), in [evaluation](evaluation.md) (`python -m benchmarks.suite`: every "
        "method under every protocol) and in the page of each topic; how they are made to be fair is in "
        "[contributing](contributing.md#benchmarks). `study_` chose or tested a rule, `bench_` takes times.\n\n"
        "| script | what it answers |\n|---|---|\n"
    )
    for path in sorted((ROOT / "benchmarks").glob("*_*.py")):
        if re.match("bench|study|check", path.stem):
            said = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
            first, _, _ = said.partition("\n\n")
            text += f"| `benchmarks/{path.name}` | {_cell(first)} |\n"
    return text


def python_names() -> str:
    """Each public name where it is defined, from its docstring."""
    import drsplat

    homes = {name: home for home, names in drsplat._HOMES.items() for name in names}
    blocks = "\n\n".join(f"::: drsplat.{homes[name]}.{name}" for name in sorted(homes, key=str.lower))
    return f"# Python\n\nEvery public name of `drsplat`; [its list](../api.md) says which to use when.\n\n{blocks}\n"


def command_line() -> str:
    """Return --help-all of every verb, from the parsers themselves."""
    from drsplat.cli import make_parser

    parser = make_parser()
    text = f"# Command line\n\n```text\n{_help(parser)}```\n"
    for name, verb in _verbs(parser):
        text += f"\n## {name}\n\n```text\n{_help(verb)}```\n"
    return text


def _verbs(parser: argparse.ArgumentParser) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            seen: set[int] = set()
            for name, verb in action.choices.items():
                if id(verb) not in seen:
                    seen.add(id(verb))
                    yield name, verb
                    yield from ((f"{name} {inner}", deeper) for inner, deeper in _verbs(verb))


def _help(parser: argparse.ArgumentParser) -> str:
    parser.formatter_class = _at_eighty(parser.formatter_class)
    return parser.format_help()


def _at_eighty(formatter: Any) -> Any:
    return type("Eighty", (formatter,), {"__init__": lambda self, prog: formatter.__init__(self, prog, width=80)})


def http() -> str:
    """From the OpenAPI description that the service itself gives."""
    described = _openapi()
    text = "# HTTP\n\nFrom the service's own OpenAPI description (`/openapi.json`); [how to use it](../serve.md).\n"
    for path, acts in described["paths"].items():
        for method, act in acts.items():
            text += f"\n## {method.upper()} {path}\n\n{act.get('description') or act.get('summary', '')}\n"
            text += _parameters(act.get("parameters", []))
            body = act.get("requestBody", {}).get("content", {})
            for kind, content in body.items():
                text += f"\nBody, `{kind}`:\n\n{_schema(content['schema'], described)}"
    return text


def _openapi() -> dict[str, Any]:
    import tempfile

    from drsplat.fronts.serving.app import Settings, create_app

    with tempfile.TemporaryDirectory() as folder:
        return dict(create_app(Settings(folder)).openapi())


def _parameters(parameters: list[dict[str, Any]]) -> str:
    rows = [f"| `{each['name']}` | {each['in']} | {_cell(each.get('description', ''))} |" for each in parameters]
    return "\n| parameter | in | |\n|---|---|---|\n" + "\n".join(rows) + "\n" if rows else ""


def _schema(schema: dict[str, Any], described: dict[str, Any]) -> str:
    name = schema.get("$ref", "").rpartition("/")[2]
    full = described["components"]["schemas"][name] if name else schema
    rows = [
        f"| `{key}` | {_kind(value)} | {_cell(value.get('description', ''))} |"
        for key, value in full.get("properties", {}).items()
    ]
    return "| key | type | |\n|---|---|---|\n" + "\n".join(rows) + "\n" if rows else f"`{json.dumps(full)[:500]}`\n"


def _kind(schema: dict[str, Any]) -> str:
    if "anyOf" in schema:
        return " or ".join(_kind(part) for part in schema["anyOf"])
    return str(schema.get("type") or schema.get("$ref", "").rpartition("/")[2])


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def mcp() -> str:
    """The tools that a language model is offered, with their own descriptions."""
    text = (
        "# Language models (MCP)\n\nThe tools of `drsplat mcp`, as a model reads them; [how to run it](../serve.md).\n"
    )
    for tool in _tools():
        text += f"\n## {tool.name}\n\n{inspect.cleandoc(tool.description or '')}\n"
        rows = [
            f"| `{key}` | {_kind(value)} | {_cell(value.get('description', ''))} |"
            for key, value in tool.input_schema.get("properties", {}).items()
        ]
        text += "\n| argument | type | |\n|---|---|---|\n" + "\n".join(rows) + "\n" if rows else ""
    return text


def _tools() -> Any:
    import asyncio
    import tempfile
    from contextlib import closing

    from drsplat.fronts.serving.guards import Limits
    from drsplat.fronts.serving.metrics import Metrics
    from drsplat.fronts.serving.scene_folder import SceneFolder
    from drsplat.fronts.serving.tools import make_server
    from drsplat.fronts.serving.workbench import Workbench
    from drsplat.fronts.serving.worker import Workplace

    with tempfile.TemporaryDirectory() as folder:
        limits = Limits()
        with closing(Workbench(Workplace(folder, limits=limits), Metrics())) as bench:
            return asyncio.run(make_server(SceneFolder(Path(folder)), bench, limits).list_tools())


PLACES = {"<!-- gallery -->": gallery, "<!-- live -->": live, "<!-- numbers -->": numbers}
"""What stands in documents for what is made when the site is built."""
