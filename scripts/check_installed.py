"""Run tests against drsplat as it is installed here, not as it lies in a checkout.

usage: python check_installed.py CHECKOUT [--all] [pytest's arguments]

Without --all: those of the kernels, readers and registration, which need nothing but pytest, hypothesis, beartype
and jaxtyping, and `drsplat demo`, with its time.
"""

import os
import subprocess
import sys
import tempfile
import time
from importlib.metadata import files, version
from pathlib import Path

FEW = (
    "kernels/test_kernels",
    "kernels/test_algebra",
    "kernels/test_scan",
    "kernels/test_regions",
    "scene/test_boxes",
    "kernels/test_mixture_kernels",
    "formats/test_gaussian_formats",
    "field/test_registration",
    "base/test_system",
)


def refuse_the_checkout(checkout: Path) -> Path:
    """Where drsplat is imported from. Raises: SystemExit: from the checkout."""
    import drsplat

    place = Path(drsplat.__file__).resolve().parent
    if checkout in place.parents:
        raise SystemExit(f"drsplat is imported from {place}: install the wheel, not the checkout")
    return place


def run_demo() -> float:
    """Seconds that it takes, with nothing on PATH but what the environment brings."""
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        bare = {**os.environ, "PATH": str(Path(sys.executable).parent)}
        subprocess.run([sys.executable, "-m", "drsplat", "demo", "-o", "room", "--json"], cwd=folder, env=bare,
                       check=True, stdout=subprocess.DEVNULL)  # fmt: skip
        return time.perf_counter() - begin


def main(arguments: list[str]) -> int:
    checkout, rest = Path(arguments[0]).resolve(), arguments[1:]
    place = refuse_the_checkout(checkout)
    size = sum(Path(file.locate()).stat().st_size for file in files("drsplat") or () if Path(file.locate()).exists())
    print(f"drsplat {version('drsplat')} in {place}, {size / 1e6:.1f} MB", flush=True)
    print(f"drsplat demo: {run_demo():.0f} s", flush=True)
    everything = "--all" in rest
    chosen = [] if everything else [f"tests/{name}.py" for name in FEW]
    rest = [argument for argument in rest if argument != "--all"]
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *chosen, *rest]
    return subprocess.run(command, cwd=checkout, check=False).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
