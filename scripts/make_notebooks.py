"""A notebook for each of examples/, in a folder: its docstring as text, its functions, and the call of its main.

usage: python make_notebooks.py FOLDER [--run]    --run: execute them there, one after another; outputs are not kept

A notebook is JSON, so that nothing is needed to make it; to run it needs nbclient and ipykernel.
"""

import ast
import json
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
MARK = 'if __name__ == "__main__":'


def cells(source: str) -> list[dict[str, Any]]:
    """The docstring, then the code, then the call with the defaults of `main`."""
    tree = ast.parse(source)
    text = ast.get_docstring(tree) or ""
    code = "\n".join(source.split("\n")[tree.body[0].end_lineno :]).split(MARK)[0].strip()
    made = [_cell("markdown", text), _cell("code", code)]
    return [*made, _cell("code", "main()")] if "def main(" in code else made


def _cell(kind: str, text: str) -> dict[str, Any]:
    cell: dict[str, Any] = {"cell_type": kind, "metadata": {}, "source": text.splitlines(keepends=True)}
    return cell | ({"execution_count": None, "outputs": []} if kind == "code" else {})


def notebook(path: Path) -> dict[str, Any]:
    """Of the format 4.4, without outputs."""
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    body = cells(path.read_text(encoding="utf-8"))
    return {"cells": body, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 4}


def examples() -> list[Path]:
    return sorted((ROOT / "examples").glob("[0-9]*.py"))


def write(folder: Path) -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    made = [folder / f"{path.stem}.ipynb" for path in examples()]
    for path, place in zip(examples(), made, strict=True):
        place.write_text(json.dumps(notebook(path), indent=1) + "\n", encoding="utf-8")
    return made


def run(place: Path) -> None:
    """In its folder. Raises: nbclient's CellExecutionError: a cell failed."""
    import nbformat
    from nbclient import NotebookClient

    NotebookClient(nbformat.read(place, 4), timeout=600, resources={"metadata": {"path": place.parent}}).execute()
    print(f"{place.name} ran", flush=True)


def main(arguments: list[str]) -> int:
    made = write(Path(arguments[0]))
    print(f"{len(made)} notebooks in {arguments[0]}")
    for place in made if "--run" in arguments else []:
        run(place)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
