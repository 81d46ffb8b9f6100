"""Tables on the terminal against those of rich, letter by letter."""

import io
from collections.abc import Callable

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from drsplat.commands.tables import show_facts, show_table

texts = st.lists(st.text("ab ,.é漢字—e\u0301_-1", max_size=9).map(str.strip), max_size=3).map("\n".join)
few = settings(
    derandomize=True, deadline=None, max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def of_rich(columns: list[str], rows: list[list[str]], headed: bool) -> str:
    table = Table(box=SIMPLE_HEAD if headed else None, show_header=headed, pad_edge=False)
    for at, column in enumerate(columns):
        table.add_column(column, justify="right" if headed and at else "left", overflow="fold")
    for row in rows:
        table.add_row(*row)
    console = Console(
        width=100_000, height=1, highlight=False, markup=False, emoji=False, file=io.StringIO(), legacy_windows=False
    )
    shown = Console(
        width=console.measure(table).maximum, height=1, highlight=False, markup=False, emoji=False,
        file=(file := io.StringIO()), legacy_windows=False,
    )  # fmt: skip
    shown.print(table)
    return file.getvalue()


def printed(capsys: pytest.CaptureFixture[str], show: Callable[[], None]) -> str:
    capsys.readouterr()
    show()
    return capsys.readouterr().out


@few
@given(st.data())
def test_a_table_is_that_of_rich(capsys: pytest.CaptureFixture[str], data: st.DataObject) -> None:
    count = data.draw(st.integers(1, 4))
    cells = st.lists(texts, min_size=count, max_size=count)
    columns = [name.replace("\n", "") or "x" for name in data.draw(cells)]
    rows = data.draw(st.lists(cells, max_size=4))
    table = printed(capsys, lambda: show_table("title", columns, rows))
    assert table == "title\n" + of_rich(columns, rows, headed=True)


@few
@given(st.dictionaries(texts.map(lambda text: text.replace("\n", "") + "x"), texts, min_size=1, max_size=4))
def test_facts_are_those_of_rich(capsys: pytest.CaptureFixture[str], facts: dict[str, str]) -> None:
    rows = [[name.replace("_", " "), value] for name, value in facts.items()]
    assert printed(capsys, lambda: show_facts("title", facts)) == "title\n" + of_rich(["", ""], rows, headed=False)


def test_facts_are_folded_where_a_terminal_ends(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "20")
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    lines = printed(capsys, lambda: show_facts("title", {"name": "one two three four", "of": "x" * 30})).splitlines()
    assert [line.rstrip() for line in lines] == [
        "title", "name  one two three", "      four", "of    " + "x" * 14, "      " + "x" * 14, "      xx",
    ]  # fmt: skip


def test_a_heading_is_bold_on_a_terminal_that_knows_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    shown = {}
    for name in ("dumb", "xterm"):
        monkeypatch.setenv("TERM", name)
        shown[name] = printed(capsys, lambda: show_table("title", ["a", "bc"], [["1", "2"]])).splitlines()[2]
    assert shown == {"dumb": " a   bc ", "xterm": " \x1b[1ma   bc\x1b[0m "}
