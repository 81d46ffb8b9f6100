"""Facts about torch on this machine. It imports torch, so `drsplat doctor` runs it in a process of its own."""

from importlib import import_module
from typing import Any

from .libraries import torchvision_fault


def torch_facts() -> dict[str, Any]:
    """Return the names of CUDA GPUs, whether Apple's GPU exists, and the faults of torch or torchvision."""
    try:
        torch = import_module("torch")
    except Exception as error:  # a build for another system can raise anything
        return {"torch_fault": f"{type(error).__name__}: {error}".splitlines()[0]}
    gpus = range(torch.cuda.device_count())
    return {
        "torch_fault": None,
        "torchvision_fault": torchvision_fault(),
        "cuda": [torch.cuda.get_device_name(gpu) for gpu in gpus],
        "mps": torch.backends.mps.is_available(),
    }
