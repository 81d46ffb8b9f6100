#!/usr/bin/env python3
"""Walk through one run of a verb: the modules that it passes, in order, each function where it is first called.

usage: python -m scripts.walk VERB ...        what `drsplat VERB ...` does, from `run` to its return
       python -m scripts.walk --short VERB ...  the count alone

A stop is a stay in a module: functions that are called there for the first time before another module's is. A function
that was called before is known to the reader, and counts no more. Modules whose code only serves (kinds of arrays,
progress, checks of shapes) and what runs in other threads are left out.
"""

import sys
from inspect import CO_OPTIMIZED
from pathlib import Path
from types import CodeType, FrameType

import drsplat
from drsplat.cli import main

ROOT = Path(drsplat.__file__).parent
LEFT_OUT = ("base", "errors.py")


class Walk:
    """The stops of a run: pairs of a module and the names of functions that are first called in it there."""

    def __init__(self, verb: str) -> None:
        self.begin = (f"fronts/commands/{verb}.py", "run")
        self.depth = 0  # of calls inside `run`, 0 outside
        self.stops: list[tuple[str, list[str]]] = []
        self._importing = 0
        self._known: set[CodeType] = set()
        self._places: dict[str, str | None] = {}

    def __call__(self, frame: FrameType, event: str, _: object) -> None:
        """Note a call or a return of a function of Python (`sys.setprofile`)."""
        code = frame.f_code
        place = self._place(code.co_filename)
        if (place, code.co_name) == self.begin and event in ("call", "return"):
            self.depth += 1 if event == "call" else -1
        if place is not None and code.co_name == "<module>" and event in ("call", "return"):
            self._importing += 1 if event == "call" else -1
        if event != "call" or not self.depth or self._importing or place is None or code in self._known:
            return
        if code.co_name.startswith("<") or not code.co_flags & CO_OPTIMIZED:  # a lambda, the body of a class
            return
        self._known.add(code)
        if not self.stops or self.stops[-1][0] != place:
            self.stops.append((place, []))
        self.stops[-1][1].append(code.co_qualname)

    def _place(self, file: str) -> str | None:
        """Return the module's place in the package; None for one that is no stop."""
        if file not in self._places:
            path = Path(file)
            inner = path.relative_to(ROOT).as_posix() if path.is_relative_to(ROOT) else None
            self._places[file] = None if inner is None or inner.startswith(LEFT_OUT) else inner
        return self._places[file]


def walked(line: list[str]) -> Walk:
    """Run a line of `drsplat`, and return its walk. Raises: SystemExit: the run failed."""
    walk = Walk(line[0])
    sys.setprofile(walk)
    try:
        code = main(line)
    finally:
        sys.setprofile(None)
    if code:
        raise SystemExit(code)
    return walk


if __name__ == "__main__":
    short = sys.argv[1] == "--short"
    walk = walked(sys.argv[1 + short :])
    for number, (place, functions) in enumerate(walk.stops, 1):
        if not short:
            print(f"{number:4} {place:44} {', '.join(functions)}")
    print(f"{len(walk.stops)} stops in {len({place for place, _ in walk.stops})} modules")
