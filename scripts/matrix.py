"""drsplat in fresh environments: Pythons, the oldest and the newest packages that are allowed, each extra alone.

usage: python matrix.py WORK_FOLDER [PYTHON...]    PYTHON: an interpreter, by name or path (default: this one)

Every Python gets the newest packages; the first one also the oldest of what pyproject.toml names, and the extras, one
at a time. A wheel is made for each kind of Python that needs one. In each environment some tests run against what is
installed; the table that is printed says which versions those were. Cells whose packages cannot be had are said so,
cells that fail make the script fail, and cells that passed are not run again.
"""

import json
import re
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
TESTERS = ("pytest", "hypothesis", "beartype", "jaxtyping")
EXTRAS = ("cuda", "cuda13", "capture", "viewer", "serve", "mcp", "docs", "ray", "models", "open-clip", "usd", "rerun")
QUICK = tuple(
    f"tests/{name}.py"
    for name in (
        "project/test_api", "fronts/test_doctor", "base/test_system", "kernels/test_algebra", "field/test_registration",
        "authoring/test_notebook",
    )
)  # fmt: skip
IMPORT = "import drsplat, numpy, platform; print(platform.python_version(), numpy.__version__)"


@dataclass(frozen=True)
class Cell:
    """extra: empty for none. oldest: of what the project needs directly."""

    python: str
    extra: str = ""
    oldest: bool = False

    @property
    def name(self) -> str:
        where = self.python.strip("/").replace("/", "_")
        return f"{where}-{self.extra or 'none'}-{'oldest' if self.oldest else 'newest'}"


def cells(pythons: list[str]) -> Iterator[Cell]:
    for python in pythons:
        yield Cell(python)
    yield Cell(pythons[0], oldest=True)
    for extra in EXTRAS:
        yield Cell(pythons[0], extra)


def project() -> dict[str, Any]:
    named: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return named


def lowest() -> list[str]:
    """The lower bounds of what the project needs, as pins."""
    return [re.sub(r"^([\w-]+)>=([\d.]+).*$", r"\1==\2", one) for one in project()["dependencies"]]


def said(command: list[str]) -> str:
    try:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    except FileNotFoundError as error:
        raise RuntimeError(f"{command[0]}: {error.strerror}") from None
    if done.returncode:
        raise RuntimeError(f"{' '.join(command[:6])} ...: {(done.stdout + done.stderr)[-800:]}")
    return done.stdout


def wheel_for(python: str, work: Path) -> Path:
    """One for 3.11, and one of the stable ABI for all later ones."""
    minor = int(said([python, "-c", "import sys; print(sys.version_info.minor)"]))
    place = work / ("cp311" if minor == 11 else "abi3")
    if not list(place.glob("*.whl")):
        said([python, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(place), str(ROOT)])
    return next(place.glob("*.whl"))


def environment(cell: Cell, work: Path) -> str:
    """The interpreter of a new environment with all that the cell has."""
    wheel, place = wheel_for(cell.python, work), work / cell.name
    said([cell.python, "-m", "venv", "--clear", str(place)])
    inside = str(place / "bin/python")
    wanted = f"drsplat[{cell.extra}] @ {wheel.as_uri()}" if cell.extra else str(wheel)
    pins = lowest() if cell.oldest else []
    said([inside, "-m", "pip", "install", "--quiet", wanted, *TESTERS, *pins])
    return inside


def run(cell: Cell, work: Path) -> dict[str, object]:
    begin = time.perf_counter()
    try:
        inside = environment(cell, work)
    except RuntimeError as error:
        return {"cell": cell.name, "result": "not to be had", "why": str(error)}
    python, numpy = said([inside, "-P", "-c", IMPORT]).split()
    done = subprocess.run(
        [inside, "-P", "-m", "pytest", "-p", "no:cacheprovider", *QUICK],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    counted = {what: int(number) for number, what in re.findall(r"(\d+) (passed|failed|skipped|error)", done.stdout)}
    return {
        "cell": cell.name, "python": python, "numpy": numpy, "extra": cell.extra or "none",
        "packages": "oldest" if cell.oldest else "newest", **counted,
        "result": "passed" if done.returncode == 0 else "FAILED", "why": done.stdout[-3000:] if done.returncode else "",
        "seconds": round(time.perf_counter() - begin),
    }  # fmt: skip


def main(arguments: list[str]) -> int:
    work, pythons = Path(arguments[0]).resolve(), arguments[1:] or [sys.executable]
    work.mkdir(parents=True, exist_ok=True)
    told = []
    for cell in cells(pythons):
        kept = work / f"{cell.name}.json"
        one = json.loads(kept.read_text(encoding="utf-8")) if kept.exists() else run(cell, work)
        if one["result"] == "passed":
            kept.write_text(json.dumps(one), encoding="utf-8")
        told.append(one)
        print(f"{cell.name}: {one['result']} {one.get('why', '')}", file=sys.stderr, flush=True)
    print("| Python | NumPy | extra | other packages | tests passed | skipped | |\n|---|---|---|---|---|---|---|")
    for one in told:
        keys = ("python", "numpy", "extra", "packages", "passed", "skipped", "result")
        print("| " + " | ".join(str(one.get(key, "")) for key in keys) + " |")
    return int(any(one["result"] == "FAILED" for one in told))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
