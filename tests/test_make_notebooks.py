"""The notebooks of examples/: what is in an example is in its notebook, and runs from there."""

import contextlib
import io
import json
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "scripts"))
import make_notebooks  # noqa: E402


def test_a_notebook_for_each_example_without_outputs(tmp_path: Path) -> None:
    made = make_notebooks.write(tmp_path)
    assert [path.stem for path in made] == [path.stem for path in make_notebooks.examples()]
    for path in made:
        text, code, call = json.loads(path.read_text(encoding="utf-8"))["cells"]
        assert (text["cell_type"], code["cell_type"]) == ("markdown", "code")
        assert code["outputs"] == call["outputs"] == []
        assert "__main__" not in "".join(code["source"])
        assert "".join(call["source"]) == "main()"


def test_cells_run_as_the_example_does(tmp_path: Path) -> None:
    example = tmp_path / "00_add.py"
    example.write_text('"""Adds.\n\nTwice."""\n\nA = 2\n\n\ndef main(b: int = 3) -> None:\n    print(A + b)\n\n\n'
                       'if __name__ == "__main__":\n    main()\n')  # fmt: skip
    names: dict[str, object] = {}
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        for cell in make_notebooks.notebook(example)["cells"][1:]:
            exec("".join(cell["source"]), names)
    assert said.getvalue() == "5\n"


def test_they_are_notebooks_to_others_too(tmp_path: Path) -> None:
    nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed")
    for path in make_notebooks.write(tmp_path):
        nbformat.validate(nbformat.read(path, 4))
