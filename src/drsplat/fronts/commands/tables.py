"""Tables on the terminal, and facts about codes that several of them show."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from .declaring import Facts

if TYPE_CHECKING:
    from rich.console import Console

    from ...field.codes import Code, Codebook

UNWRAPPED_COLUMNS = 100_000


def show_facts(title: str, facts: Mapping[str, object]) -> None:
    """Show names and values, one to a line."""
    show_table(
        title, ("", ""), [(name.replace("_", " "), text_of(value)) for name, value in facts.items()], headed=False
    )


def show_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], *, headed: bool = True) -> None:
    """Print a table, the first column to the left, in headed tables the others to the right.

    Nothing is cut: a headed table is as wide as it needs to be, facts are folded where a terminal ends.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(box=SIMPLE_HEAD if headed else None, show_header=headed, pad_edge=False)
    for index, column in enumerate(columns):
        table.add_column(column, justify="right" if headed and index else "left", overflow="fold")
    for row in rows:
        table.add_row(*row)
    print(title)
    console, boundless = _console(None), _console(UNWRAPPED_COLUMNS)
    folded = console.is_terminal and not headed
    _console(console.width if folded else boundless.measure(table).maximum).print(table)


def _console(width: int | None) -> Console:
    """Return a console that shows texts as they are ([red], :warning:). width: None for the terminal's."""
    from rich.console import Console

    height = None if width is None else 1
    return Console(width=width, height=height, highlight=False, markup=False, emoji=False)


def text_of(value: object) -> str:
    """Format a value for people: 1,234; 0.123; a, b."""
    if value is None:
        return "none"
    if hasattr(value, "tolist"):
        return text_of(value.tolist())
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {text_of(part)}" for name, part in value.items()) or "none"
    if isinstance(value, list | tuple):
        shown = ", ".join(text_of(part) for part in value[:8])
        return (shown + (f" and {len(value) - 8} more" if len(value) > 8 else "")) or "none"
    return str(value)


def place_text(numbers: Iterable[float]) -> str:
    """Format a place or an extent: 1.00 -0.25 0.50."""
    return " ".join(f"{x:.2f}" for x in numbers)


def size_text(num_bytes: int) -> str:
    power = min((len(str(num_bytes)) - 1) // 3, 4)
    return f"{num_bytes / 1000**power:.{min(power, 1)}f} {('B', 'KB', 'MB', 'GB', 'TB')[power]}"


def code_facts(code: Code) -> Facts:
    """Return kind and bytes of a code, and what it is made of."""
    from ...field.codes import PQCode
    from ...field.codes.mixture import MixtureCode

    if isinstance(code, PQCode):
        return {"code": code.kind, **codebook_facts(code.codebook)}
    facts: Facts = {"code": code.kind}
    if isinstance(code, MixtureCode):
        facts |= {
            "atoms_per_row": code.atoms_per_row,
            "num_atoms": len(code.atoms),
            "bytes_per_gaussian": code.row_bytes,
        }
    return facts


def codebook_facts(codebook: Codebook) -> Facts:
    """Return a codebook's hash, and the sizes of its codes."""
    coarse = codebook.coarse
    return {
        "codebook": codebook.hash,
        "num_subvectors": codebook.num_subvectors,
        "num_coarse": 0 if coarse is None else len(coarse),
        "bytes_per_gaussian": codebook.code_bytes,
    }
