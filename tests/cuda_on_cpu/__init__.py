"""The CUDA kernels compiled for the CPU: threads of a block take turns. Slow, and the same source as on a GPU."""

import atexit
import ctypes
import re
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from drsplat.kernels.cuda.engine import KERNEL, MODULES, source_of

COMPILER = shutil.which("g++") or shutil.which("clang++")
NUMBERS = {"int": ctypes.c_int, "u32": ctypes.c_uint, "float": ctypes.c_float, "i64": ctypes.c_longlong}


@cache
def compiled() -> Path:
    """Return a folder for what is compiled, one for this process; skips the test where there is no compiler."""
    if COMPILER is None:
        pytest.skip("needs a C++ compiler, to run CUDA kernels on the CPU")
    folder = Path(tempfile.mkdtemp(prefix="cuda_on_cpu"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


class CpuEngine:
    """`drsplat.kernels.cuda.engine.Engine` on NumPy's arrays."""

    def __init__(self, folder: Path, shared_bytes: int = 99 << 10) -> None:
        self.xp, self.folder, self.shared_bytes = np, folder, shared_bytes

    def launch(self, kernel: str, blocks: int, threads: int, *arguments: object, shared_bytes: int = 0) -> None:
        assert shared_bytes <= self.shared_bytes
        run, kinds = kernels(self.folder)[kernel]
        assert len(kinds) == len(arguments), (kernel, len(kinds), len(arguments))
        held = [_held(kind, argument, kernel) for kind, argument in zip(kinds, arguments, strict=True)]
        pointers = (ctypes.c_void_p * len(held))(*(ctypes.cast(ctypes.byref(each), ctypes.c_void_p) for each in held))
        if blocks and run(pointers, blocks, threads):
            raise RuntimeError(f"{kernel}: threads wait for each other for ever")

    def release(self) -> None:
        pass

    def free_bytes(self) -> int:
        return 1 << 30


def _held(kind: str, argument: object, kernel: str) -> object:
    """Return a C value of an argument: an address or a number."""
    if kind.endswith("*"):
        if argument is None:
            return ctypes.c_void_p(None)
        assert isinstance(argument, np.ndarray), (kernel, kind, argument)
        assert argument.flags.c_contiguous, (kernel, kind)
        return ctypes.c_void_p(argument.ctypes.data)
    return NUMBERS[kind](argument)


@cache
def kernels(folder: Path) -> dict[str, tuple[object, list[str]]]:
    """Compile every module; return each kernel with the kinds of its parameters."""
    found = {}
    for module in MODULES:
        source = source_of(module)
        names = {match[1]: match[2] for match in KERNEL.finditer(source)}
        path = folder / f"{module}.cpp"
        path.write_text('#include "cuda.h"\n' + source + "".join(_entry(*item) for item in names.items()))
        library = path.with_suffix(".so")
        command = [COMPILER, "-std=c++17", "-O2", "-U_FORTIFY_SOURCE", "-ffp-contract=off", "-w", "-shared", "-fPIC"]
        subprocess.run([*command, f"-I{Path(__file__).parent}", str(path), "-o", str(library)], check=True)
        loaded = ctypes.CDLL(str(library))
        for name, parameters in names.items():
            run = getattr(loaded, f"run_{name}")
            run.argtypes, run.restype = (ctypes.c_void_p, ctypes.c_uint, ctypes.c_uint), ctypes.c_int
            found.setdefault(name, (run, [kind for kind, _ in _parameters(parameters)]))
    return found


def _parameters(text: str) -> list[tuple[str, str]]:
    """Split a parameter list into kinds and names; kinds without const, pointers with a star."""
    split = []
    for part in text.split(","):
        kind, star, name = re.fullmatch(r"\s*(?:const )?(\w+) (\*?)(\w+)\s*", " ".join(part.split())).groups()
        split.append((kind + star, name))
    return split


def _entry(name: str, parameters: str) -> str:
    passed = ", ".join(f"*({kind.replace('*', ' *')} *)a[{i}]" for i, (kind, _) in enumerate(_parameters(parameters)))
    return (
        f'\nstatic void call_{name}(void **a) {{ {name}({passed}); }}\nextern "C" int run_{name}(void **a, unsigned '
        f"blocks, unsigned threads) {{ return run_grid(call_{name}, a, blocks, 1, threads); }}\n"
    )
