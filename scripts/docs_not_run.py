"""Why a command of the docs is not run: the only list of them, and each reason can be checked.

A command that no row names is run. A reason that does not hold is an error, as is a row that names no command.
"""

import ast
import importlib.util
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable
from dataclasses import dataclass

from scripts.docs_blocks import ROOT, Piece

Check = Callable[[Piece], str]
"""Returns what is wrong with a reason, or nothing."""


@dataclass(frozen=True)
class Reason:
    """Why a command is not run. check: says what is wrong with that, or with the command all the same."""

    text: str
    check: Check


def _install(piece: Piece) -> str:
    document = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    known = {*document["optional-dependencies"]}
    asked = {name for extras in re.findall(r"\.\[([\w,-]+)\]", piece.text) for name in extras.split(",")}
    wrong = asked - known
    return f"no such extra: {', '.join(sorted(wrong))}" if wrong else ""


def _options(piece: Piece) -> str:
    """Compare the options of `python -m MODULE` with its help."""
    found = re.search(r"python -m ([\w.]+)(.*)", piece.text.replace("\\\n", " "))
    if not found or importlib.util.find_spec(found[1]) is None:
        return "no such module"
    told = subprocess.run(
        [sys.executable, "-m", found[1], "--help"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    unknown = [option for option in re.findall(r"--[a-z][\w-]*", found[2]) if option not in told.stdout]
    if told.returncode and "torch" not in told.stderr and "h5py" not in told.stderr:
        return told.stderr.strip().splitlines()[-1]
    return f"no such option: {', '.join(unknown)}" if unknown and not told.returncode else ""


INSTALL = Reason("changes the environment, or makes one; its extras exist", _install)
HOURS = Reason("takes hours and data sets; its module and its options exist", _options)
ENDS = Reason("needs a checkout's tests: .ci/run runs this line", lambda piece: "" if "pytest" in piece.text else "?")


def tested(where: str) -> Reason:
    """A test that makes what the command needs, and calls the same. where: tests/FILE.py::NAME."""

    def check(piece: Piece) -> str:
        file, _, name = where.partition("::")
        tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
        return "" if any(getattr(node, "name", None) == name for node in tree.body) else f"there is no {where}"

    return Reason(f"needs data that a test makes: {where}", check)


def same(page: str) -> Reason:
    """The same command, but for names of files and words, is run elsewhere."""

    def check(piece: Piece) -> str:
        verb = " ".join(piece.words[:2])
        return "" if verb in (ROOT / page).read_text(encoding="utf-8") else f"{page} has no {verb}"

    return Reason(f"the same verb with the same options is run of {page}", check)


NOT_RUN: dict[tuple[str, str], Reason] = {
    ("README.md", "drsplat scan photos"): same("docs/scan.md"),
    ("README.md", "pytest"): ENDS,
    ("docs/tour.md", "drsplat capture photos"): same("docs/capture.md"),
    ("docs/tour.md", "drsplat photograph"): same("docs/photograph.md"),
    ("docs/search.md", "import json, pathlib"): tested(
        "tests/query/test_short_lists.py::test_the_recipe_of_the_docs_makes_a_list_that_is_long_enough"
    ),
    ("docs/neighbours.md", "drsplat register exported"): tested(
        "tests/project/test_neighbours.py::test_a_layout_leads_to_the_answer"
    ),
}
"""By page and how the command begins."""


def reason(piece: Piece) -> Reason | None:
    """Return why a command is not run, or None."""
    if piece.text.startswith(("pip install", "uvx --from .")):
        return INSTALL
    if (piece.language == "bash" and "python -m world" in piece.text) or "python -m benchmarks" in piece.text:
        return HOURS
    found = [why for (page, begin), why in NOT_RUN.items() if page == piece.page and piece.text.startswith(begin)]
    return found[0] if found else None
