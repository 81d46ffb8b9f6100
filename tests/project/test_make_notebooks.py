"""The notebooks of examples/ and docs/: what is in a source is in its notebook, and runs from there."""

import contextlib
import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scripts import make_notebooks

from drsplat import open_scene

ROOT = Path(__file__).resolve().parents[2]


def source(cell: dict[str, Any]) -> str:
    return "".join(cell["source"])


@pytest.mark.parametrize("path", make_notebooks.examples(), ids=lambda path: path.stem)
def test_a_notebook_has_prose_cells_and_a_picture(path):
    title, first, *cells = make_notebooks.notebook(path)["cells"]
    assert source(title).startswith("# ")
    assert first["cell_type"] == "markdown"
    prose = [source(cell) for cell in cells if cell["cell_type"] == "markdown"]
    code = [source(cell) for cell in cells if cell["cell_type"] == "code"]
    assert len(prose) >= 2
    assert all(text[0].isupper() and "%%" not in text for text in prose)
    assert "__main__" not in "".join(code)
    assert "def main" not in "".join(code)
    assert sum(text.startswith(make_notebooks.SHOW) for text in code) == 1
    assert all(cell["outputs"] == [] for cell in cells if cell["cell_type"] == "code")
    for text in code:
        compile(text, path.name, "exec")


def test_a_notebook_for_each_example(tmp_path):
    made = make_notebooks.write(tmp_path, make_notebooks.examples())
    assert [path.stem for path in made] == [path.stem for path in make_notebooks.examples()]


def test_cells_run_as_the_example_does(tmp_path):
    example = tmp_path / "00_add.py"
    example.write_text('"""Adds.\n\nTwice."""\n\nA = 2\n\n\ndef main(b: int = 3, *more: int) -> None:\n'
                       '    # %% Adds\n    # them.\n    total = A + b + sum(more)\n\n    # %% Prints.\n'
                       '    if total:\n        print(total)\n\n\nif __name__ == "__main__":\n    main()\n')  # fmt: skip
    cells = make_notebooks.notebook(example)["cells"]
    assert [(cell["cell_type"][0], source(cell)) for cell in cells] == [
        ("m", "# Add"), ("m", "Adds.\n\nTwice."), ("c", "A = 2"), ("c", "b = 3\nmore = ()"), ("m", "Adds them."),
        ("c", "total = A + b + sum(more)"), ("m", "Prints."), ("c", "if total:\n    print(total)"),
    ]  # fmt: skip
    names: dict[str, object] = {}
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        for cell in cells:
            if cell["cell_type"] == "code":
                exec(source(cell), names)
    assert said.getvalue() == "5\n"


def test_they_are_notebooks_to_others_too(tmp_path):
    nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed")
    for path in make_notebooks.write(tmp_path, [*make_notebooks.examples(), *make_notebooks.of_docs()]):
        nbformat.validate(nbformat.read(path, 4))


@pytest.mark.parametrize("path", make_notebooks.of_docs(), ids=lambda path: path.stem)
def test_notebooks_of_the_docs_are_their_sources_with_outputs(path):
    """Executed, without an error, and with a picture; `make_notebooks.py FOLDER --run --docs` makes them again."""
    kept = json.loads((make_notebooks.PAGES / f"{path.stem}.ipynb").read_text(encoding="utf-8"))
    made = make_notebooks.notebook(path)
    assert [source(cell) for cell in kept["cells"]] == [source(cell) for cell in made["cells"]]
    code = [cell for cell in kept["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1))
    outputs = [output for cell in code for output in cell["outputs"]]
    assert {output["output_type"] for output in outputs} <= {"stream", "execute_result"}
    assert {output["name"] for output in outputs if output["output_type"] == "stream"} == {"stdout"}
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 1
    tutorials = "".join(page.read_text(encoding="utf-8") for page in (ROOT / "docs/tutorials").glob("*.md"))
    assert f"../notebooks/{path.stem}.ipynb" in tutorials


@pytest.mark.slow
@pytest.mark.parametrize("path", make_notebooks.of_docs(), ids=lambda path: path.stem)
def test_notebooks_of_the_docs_run(path, household_story, household_folder, tmp_path):
    """As a reader runs them, in a folder with the demo's; they find the vase, and say where."""
    for name in ("nbclient", "ipykernel"):
        pytest.importorskip(name, reason="nbclient and ipykernel are not installed")
    (tmp_path / "drsplat-demo").symlink_to(household_folder)
    (place,) = make_notebooks.write(tmp_path, [path])
    make_notebooks.run(place)
    cells = json.loads(place.read_text(encoding="utf-8"))["cells"]
    printed = "".join("".join(output.get("text", ())) for cell in cells for output in cell.get("outputs", ()))
    center = open_scene(household_folder).locate("red vase")[0].center
    found = [
        np.array(triple.split(), float) for triple in re.findall(r"\[([^]]+)\]", printed) if len(triple.split()) == 3
    ]
    assert any(np.linalg.norm(one - center) < 0.1 for one in found), printed
