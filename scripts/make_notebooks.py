"""A notebook for each of examples/, in a folder: prose, code in cells, and the pictures that it makes.

usage: python make_notebooks.py FOLDER [--run] [--docs]

--run: execute them there, one after another, and keep their outputs. --docs: those of examples/notebooks alone, which
are copied to docs/notebooks; FOLDER holds what `drsplat demo` wrote.

A comment `# %% ...` begins a cell and is the prose above it. The arguments of `main` become a cell with their defaults,
its body the cells after it; a cell that writes a picture shows it. A notebook is JSON, so that nothing is needed to
make it; to run it needs nbclient and ipykernel.
"""

import ast
import json
import re
import shutil
import sys
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
NOTEBOOKS, PAGES = ROOT / "examples" / "notebooks", ROOT / "docs" / "notebooks"
CELL = re.compile(r"^# %% (.+\n(?:# .+\n)*)", re.MULTILINE)
PICTURE = re.compile(r"(?:save|Path)\(\"(\w+\.png)\"\)")
SHOW = "from IPython.display import Image as Shown\n\nShown("


def cells(source: str) -> list[dict[str, Any]]:
    """Return the docstring, what stands before `main`, its arguments, and its body."""
    tree, lines = ast.parse(source), source.splitlines(keepends=True)
    last = next((node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == "main"), None)
    begin = tree.body[0].end_lineno or 0
    made = [_cell("markdown", ast.get_docstring(tree) or "")]
    if last is None:
        return [*made, *_split("".join(lines[begin:]))]
    body = textwrap.dedent("".join(lines[_first_line(last, lines) : last.end_lineno]))
    return [*made, *_split("".join(lines[begin : last.lineno - 1])), _cell("code", _arguments(last)), *_split(body)]


def _first_line(function: ast.FunctionDef, lines: list[str]) -> int:
    """Return where the body of a function begins, with the comments above its first statement."""
    first = function.body[0].lineno - 1
    while lines[first - 1].lstrip().startswith("#"):
        first -= 1
    return first


def _arguments(function: ast.FunctionDef) -> str:
    """Return assignments of the defaults, and of nothing to `*arguments`."""
    given = function.args
    pairs = zip(given.args, given.defaults, strict=True)
    rows = [f"{one.arg} = {json.dumps(ast.literal_eval(value))}" for one, value in pairs]
    return "\n".join([*rows, *([f"{given.vararg.arg} = ()"] if given.vararg else [])])


def _split(code: str) -> Iterator[dict[str, Any]]:
    """Return cells of code, with the prose that begins each, and the pictures that it writes."""
    first, *rest = CELL.split(code)
    for prose, part in zip(["", *rest[::2]], [first, *rest[1::2]], strict=True):
        if prose:
            yield _cell("markdown", " ".join(line.removeprefix("# ") for line in prose.splitlines()))
        if part.strip():
            yield _cell("code", part.strip())
        for name in PICTURE.findall(part):
            yield _cell("code", f'{SHOW}"{name}")')


def _cell(kind: str, text: str) -> dict[str, Any]:
    cell: dict[str, Any] = {"cell_type": kind, "metadata": {}, "source": text.splitlines(keepends=True)}
    return cell | ({"execution_count": None, "outputs": []} if kind == "code" else {})


def notebook(path: Path) -> dict[str, Any]:
    """Of the format 4.4, without outputs."""
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    title = re.sub(r"^\d+_", "", path.stem).replace("_", " ").capitalize()
    body = [_cell("markdown", f"# {title}"), *cells(path.read_text(encoding="utf-8"))]
    return {"cells": body, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 4}


def examples() -> list[Path]:
    return sorted((ROOT / "examples").glob("[0-9]*.py"))


def of_docs() -> list[Path]:
    return sorted(NOTEBOOKS.glob("*.py"))


def write(folder: Path, sources: Sequence[Path]) -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    made = [folder / f"{path.stem}.ipynb" for path in sources]
    for path, place in zip(sources, made, strict=True):
        place.write_text(json.dumps(notebook(path), indent=1) + "\n", encoding="utf-8")
    return made


def run(place: Path) -> None:
    """Execute it in its folder and keep the outputs. Raises: nbclient's CellExecutionError: a cell failed."""
    import nbformat
    from nbclient import NotebookClient

    made = nbformat.read(place, 4)
    folder = {"metadata": {"path": place.parent}}
    NotebookClient(made, timeout=600, resources=folder, record_timing=False).execute()
    nbformat.write(made, place)
    print(f"{place.name} ran", flush=True)


def main(arguments: list[str]) -> int:
    made = write(Path(arguments[0]), of_docs() if "--docs" in arguments else examples())
    print(f"{len(made)} notebooks in {arguments[0]}")
    for place in made if "--run" in arguments else []:
        run(place)
        if "--docs" in arguments:
            shutil.copy(place, PAGES)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
