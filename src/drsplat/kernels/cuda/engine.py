"""The GPU: CuPy's arrays, and our kernels compiled for it at first use (by NVRTC; CuPy keeps them on the disk)."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from ...errors import DrSplatError, MissingExtraError, pip_install

COMMON = ("basics", "projection", "walk")
MODULES = {  # files that are compiled together
    "tiling": ("basics", "sort", "projection", "tiles"),
    "drawing": (*COMMON, "draw", "weights"),
    "training": (*COMMON, "training"),
    "loss": ("basics", "loss"),
    "noise": ("basics", "noise"),
    "scan": ("basics", "scan"),
}
KERNEL = re.compile(r"^KERNEL(?:\s+__launch_bounds__\([^)]*\))?\s+(\w+)\(([^)]*)\)", re.MULTILINE)


@runtime_checkable
class Engine(Protocol):
    """Arrays that kernels read and write, and the kernels. xp: the module of the arrays: cupy, or numpy in tests."""

    xp: Any

    def launch(self, kernel: str, blocks: int, threads: int, *arguments: object, shared_bytes: int = 0) -> None:
        """Run a kernel on contiguous arrays and scalars; None stands for no array."""

    @property
    def shared_bytes(self) -> int:
        """Largest shared memory that a block may ask for."""

    def free_bytes(self) -> int:
        """Return the memory of the device that is left."""

    def release(self) -> None:
        """Give back what is held for arrays to come: their sizes have changed."""


def source_of(module: str) -> str:
    """Return the CUDA C++ of one of MODULES."""
    folder = Path(__file__).parent
    return "\n".join((folder / f"{name}.cuh").read_text(encoding="utf-8") for name in MODULES[module])


@cache
def module_of(kernel: str) -> str:
    """Return the first module that a kernel is in."""
    folder = Path(__file__).parent
    for module, files in MODULES.items():
        for name in files:
            if any(found[1] == kernel for found in KERNEL.finditer((folder / f"{name}.cuh").read_text("utf-8"))):
                return module
    raise KeyError(kernel)


class CudaEngine:
    """CuPy on the current GPU."""

    def __init__(self) -> None:
        self.xp = import_module("cupy")
        self._modules: dict[str, Any] = {}
        self._kernels: dict[str, Any] = {}
        attributes = self.xp.cuda.Device().attributes
        self.shared_bytes = int(attributes["MaxSharedMemoryPerBlockOptin"])

    def launch(self, kernel: str, blocks: int, threads: int, *arguments: object, shared_bytes: int = 0) -> None:
        """Run a kernel; nothing waits for it."""
        if blocks:
            self._kernel(kernel, shared_bytes)(
                (blocks,), (threads,), tuple(map(_passed, arguments)), shared_mem=shared_bytes
            )

    def _kernel(self, name: str, shared_bytes: int) -> Any:
        if name not in self._kernels:
            module = module_of(name)
            if module not in self._modules:
                self._modules[module] = self.xp.RawModule(code=source_of(module), options=("-std=c++17",))
            self._kernels[name] = self._modules[module].get_function(name)
        kernel = self._kernels[name]
        if shared_bytes > kernel.max_dynamic_shared_size_bytes:
            kernel.max_dynamic_shared_size_bytes = shared_bytes
        return kernel

    def release(self) -> None:
        """Give back what CuPy holds for arrays to come."""
        self.xp.get_default_memory_pool().free_all_blocks()

    def free_bytes(self) -> int:
        """Return the memory of the device that is left, with what CuPy holds for later."""
        return int(self.xp.cuda.runtime.memGetInfo()[0]) + int(self.xp.get_default_memory_pool().free_bytes())


def _passed(argument: object) -> object:
    """Return an argument as kernels take it: 32-bit numbers, addresses."""
    if argument is None:
        return np.uintp(0)
    if isinstance(argument, bool | int):
        return np.uint32(argument & 0xFFFFFFFF)
    if isinstance(argument, float):
        return np.float32(argument)
    return argument


@cache
def unavailable() -> str | None:
    """Return why this machine runs no CUDA kernels, and what to do; None where it does."""
    if find_spec("cupy") is None:
        return f"device 'cuda' needs CuPy, which is not installed: {pip_install('cuda')}, or take device 'cpu'"
    try:
        cupy = import_module("cupy")
        count = int(cupy.cuda.runtime.getDeviceCount())
    except Exception as error:  # of CuPy, its libraries or the driver: whatever it is, there is no GPU for us
        return f"device 'cuda': CuPy finds no GPU ({error}): check nvidia-smi, or take device 'cpu'"
    return None if count else "device 'cuda': CuPy finds no GPU: check nvidia-smi, or take device 'cpu'"


@cache
def cuda_engine() -> Engine:
    """Return the GPU. Raises: MissingExtraError: it cannot be used; says why."""
    reason = unavailable()
    if reason is not None:
        raise MissingExtraError(reason)
    return CudaEngine()


def blocks_of(count: int, threads: int = 256) -> int:
    """Return how many blocks have a thread for each of `count`."""
    return -(-count // threads)


def is_memory_full(error: Exception) -> bool:
    """Return whether an error says that the device's memory is full: CuPy's, which is not loaded without a GPU."""
    return type(error).__name__ == "OutOfMemoryError"


@contextmanager
def memory_explained(where: Callable[[], str]) -> Iterator[None]:
    """Turn an allocation that fails on the device into an error that says where, and what to do.

    Raises: DrSplatError: the device's memory is full.
    """
    try:
        yield
    except Exception as error:
        if not is_memory_full(error):
            raise
        raise DrSplatError(f"the GPU's memory is full {where()}. {error}") from error
