"""The matrix of environments: which there are, and what they are pinned to."""

from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version
from scripts import matrix

ROOT = Path(__file__).resolve().parents[2]


def test_the_oldest_are_the_lower_bounds():
    pins = {Requirement(one).name: Requirement(one).specifier for one in matrix.lowest()}
    needed = [Requirement(one) for one in matrix.project()["dependencies"]]
    assert set(pins) == {one.name for one in needed}
    for one in needed:
        (bound,) = (part for part in one.specifier if part.operator == ">=")
        assert str(pins[one.name]) == f"=={bound.version}"
        assert one.specifier.contains(Version(bound.version))


def test_every_extra_has_a_cell():
    extras = set(matrix.project()["optional-dependencies"]) - {"dev", "contributing"}
    cells = list(matrix.cells(["python3.11", "python3.12"]))
    assert {cell.extra for cell in cells} - {""} == extras
    assert [cell.python for cell in cells if not cell.extra and not cell.oldest] == ["python3.11", "python3.12"]
    assert len({cell.name for cell in cells}) == len(cells)


@pytest.mark.parametrize("file", matrix.QUICK)
def test_what_is_run_exists(file):
    assert (ROOT / file).exists()


def test_what_cannot_be_had_is_said(tmp_path):
    told = matrix.run(matrix.Cell(str(tmp_path / "python9")), tmp_path)
    assert told["result"] == "not to be had"
    assert "python9" in str(told["why"])
