"""Fail if a per-instruction-set object file could leak its code into the others.

A template of std:: instantiated in the AVX-512 copy of the kernels is a weak symbol: the linker may
keep that copy for the whole extension, which then dies on a machine without AVX-512. So every weak
symbol of such an object must lie in the object's own namespace.
"""

import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

NATIVE = Path(__file__).resolve().parent.parent / "native"
LEVELS = {"portable": [], **{level: [f"-march=x86-64-{level}"] for level in ("v2", "v3", "v4")}}
BYTES = {"v4_vbmi": ["-march=x86-64-v4", "-mavx512vbmi", "-mavx512vnni"]}
UNITS = {"kernels/kernels.cpp": LEVELS, "kernels/scan_kernels.cpp": LEVELS | BYTES}


def shared_weak_symbols(unit: str, level: str, folder: Path) -> list[str]:
    """Weak symbols of a unit, demangled, outside the namespace drsplat::LEVEL."""
    target = folder / f"{Path(unit).stem}_{level}.o"
    compiler = os.environ.get("CXX", "g++")
    flags = ["-O1", "-std=c++17", "-fPIC", "-w", f"-I{NATIVE}", f"-DDRSPLAT_ISA={level}"]
    command = [compiler, *flags, *UNITS[unit][level], "-c", NATIVE / unit, "-o", target]
    subprocess.run(command, check=True)
    listing = subprocess.run(["nm", "-C", target], check=True, capture_output=True, text=True).stdout
    weak = [line.split(maxsplit=2)[-1] for line in listing.splitlines() if line[17:18] in "WVu"]
    return [name for name in weak if f"drsplat::{level}::" not in name]


def main() -> int:
    if os.uname().machine not in ("x86_64", "amd64"):
        print("not an x86-64 machine: there is only one copy of the kernels")
        return 0
    copies = [(unit, level) for unit, levels in UNITS.items() for level in levels]
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(os.cpu_count()) as pool:
        found = list(pool.map(lambda copy: shared_weak_symbols(*copy, Path(folder)), copies))
    for (unit, level), names in zip(copies, found, strict=True):
        for name in names:
            print(f"{unit}: {name} is weak and outside drsplat::{level}", file=sys.stderr)
    print(f"{', '.join(LEVELS | BYTES)}: no weak symbol outside its own namespace" if not any(found) else "")
    return int(any(found))


if __name__ == "__main__":
    sys.exit(main())
