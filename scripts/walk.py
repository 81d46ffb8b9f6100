#!/usr/bin/env python3
"""Walk through one run of a verb: the modules that it passes, in order, each function where it is first called.

usage: python -m scripts.walk [DEEP] VERB ...   what `drsplat VERB ...` does, from `run` to its return
       DEEP: a number, calls below `run` that are followed: 3 is the way that docs/architecture.md shows; else all

A stop is a stay in a module: functions (no lambda, no lazy import) that are called there for the first time before
another module's is. A function that was called before is known to the reader, and counts no more. The wing `base` and
errors, which serve all, are left out, and so is what runs in other threads.
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

    def __init__(self, verb: str, deep: int) -> None:
        self.begin, self.deep = (f"fronts/commands/{verb}.py", "run"), deep
        self.stops: list[tuple[str, list[str]]] = []
        self._depth = self._importing = 0  # calls inside `run`, 0 outside; modules that are being loaded
        self._known: set[CodeType] = set()
        self._places: dict[str, str | None] = {}

    def __call__(self, frame: FrameType, event: str, _: object) -> None:
        """Note a call or a return of a function of Python (`sys.setprofile`)."""
        code, step = frame.f_code, {"call": 1, "return": -1}.get(event, 0)
        place = self._place(code.co_filename)
        if not step or place is None:
            return
        if code.co_name == "<module>":
            self._importing += step
        elif not self._importing and (self._depth or (place, code.co_name) == self.begin):
            self._depth += step
            is_function = code.co_flags & CO_OPTIMIZED and not code.co_name.startswith(("<", "__getattr__"))
            if step > 0 and is_function and self._depth <= self.deep and code not in self._known:
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


def walked(line: list[str], deep: int = sys.maxsize) -> Walk:
    """Run a line of `drsplat`, and return its walk. Raises: SystemExit: the run failed."""
    walk = Walk(line[0], deep)
    sys.setprofile(walk)
    try:
        code = main(line)
    finally:
        sys.setprofile(None)
    if code:
        raise SystemExit(code)
    return walk


if __name__ == "__main__":
    deep, line = (int(sys.argv[1]), sys.argv[2:]) if sys.argv[1].isdecimal() else (sys.maxsize, sys.argv[1:])
    walk = walked(line, deep)
    for number, (place, functions) in enumerate(walk.stops, 1):
        print(f"{number:4} {place:44} {', '.join(functions)}")
    print(f"{len(walk.stops)} stops in {len({place for place, _ in walk.stops})} modules")
