"""`train` on a CUDA GPU through gsplat, where it can be used; optional extra `[cuda]`."""

import os
import shutil
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ..errors import MissingExtraError
from .job import Job
from .result import Training

INSTALL = 'pip install "drsplat[cuda]"'
ELSE_CPU = "or train with device 'cpu'"


def unavailable() -> str | None:
    """Why this machine cannot train on CUDA, with what to do; None when it can."""
    absent = [name for name in ("torch", "gsplat") if find_spec(name) is None]
    if absent:
        return f"device 'cuda' needs {' and '.join(absent)}, not installed: {INSTALL}, {ELSE_CPU}"
    torch = import_module("torch")
    if not torch.cuda.is_available():
        return (
            f"device 'cuda': torch {torch.__version__} sees no CUDA GPU. On a machine that has one, "
            f"check nvidia-smi and that torch is a CUDA build ({INSTALL} brings one); here {ELSE_CPU[3:]}"
        )
    if find_spec("gsplat.csrc") is None and not _has_cuda_compiler():
        return (
            "device 'cuda': gsplat compiles its kernels at first use and finds no nvcc: install the "
            f"CUDA toolkit of torch's version ({torch.version.cuda}) and set CUDA_HOME, install a "
            f"wheel of gsplat with compiled kernels over {INSTALL}, {ELSE_CPU}"
        )
    return None


def _has_cuda_compiler() -> bool:
    """Look for nvcc where torch does."""
    named = os.environ.get("CUDA_HOME") or os.environ.get("CUDA_PATH") or "/usr/local/cuda"
    return shutil.which("nvcc") is not None or (Path(named) / "bin" / "nvcc").is_file()


def train(job: Job) -> Training:
    """Train with gsplat on "cuda", see `gsplat_loop.train`.

    Raises: as `gsplat_loop.train`, and MissingExtraError: torch, gsplat, its kernels or a GPU is absent.
    """
    engine = installed_engine()
    from . import gsplat_loop

    return gsplat_loop.train(job, engine)


def installed_engine() -> Any:
    """Return a `gsplat_run.Engine`: gsplat on "cuda", its kernels built first if need be (minutes).

    Raises: MissingExtraError: it cannot be used; says why.
    """
    reason = unavailable()
    if reason is not None:
        raise MissingExtraError(reason)
    try:
        gsplat = import_module("gsplat")
        import_module("gsplat.cuda._backend")
    except (ImportError, OSError, RuntimeError) as error:
        raise MissingExtraError(
            f"device 'cuda': gsplat's kernels cannot be built or loaded: {error}. Install it anew for "
            f"this torch: {INSTALL}, {ELSE_CPU}"
        ) from error
    from .gsplat_run import Engine
    from .gsplat_strategy import Strategies

    strategies = Strategies(gsplat.DefaultStrategy, gsplat.MCMCStrategy)
    return Engine(gsplat.rasterization, strategies, "cuda")
