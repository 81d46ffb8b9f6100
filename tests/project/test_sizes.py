"""The count of code that `scripts/check` holds to its ceiling."""

import pytest
from scripts import sizes

CODE = '''"""What it is for."""
# why
def cut(peak):
    """Where."""
    return peak / 2
'''


@pytest.mark.parametrize(
    ("source", "count"),
    [("", 0), ('"""Words."""\n', 0), ("x = 1  # why\n", 3), ("x = (\n    1,\n)\n", 6), (CODE, 10), ('x = "said"\n', 3)],
)
def test_only_what_does_something_is_counted(source, count):
    assert sizes.tokens(source) == count


@pytest.mark.parametrize(("ceiling", "code"), [(3, 0), (2, 1)])
def test_more_than_the_ceiling_is_refused(ceiling, code, tmp_path, monkeypatch, capsys):
    (tmp_path / "one.py").write_text("x = 1\n")
    monkeypatch.setattr(sizes, "SOURCE", tmp_path)
    monkeypatch.setattr(sizes, "CEILING", ceiling)
    assert sizes.main(["--check"]) == code
    assert capsys.readouterr().out == f"src/drsplat: 3 tokens of {ceiling}\n"
