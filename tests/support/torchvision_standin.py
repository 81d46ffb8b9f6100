"""A stand-in for torchvision, for processes of tests alone: names to import, and nothing that computes.

timm and open_clip import torchvision for their own scaling of images, which drsplat does not use. The torchvision that
belongs to the CPU build of torch is not always to be had.
"""

import sys
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType

_MODULES = (
    "torchvision", "torchvision.transforms", "torchvision.transforms.functional", "torchvision.ops",
    "torchvision.ops.misc", "torchvision.datasets", "torchvision.models", "torchvision.models.feature_extraction",
)  # fmt: skip


class _Names(type):
    """Classes whose attributes are their own names, such as the members of an enum."""

    def __getattr__(cls, name: str) -> str:
        if name.startswith("__"):
            raise AttributeError(name)
        return name


class _StandIn(ModuleType):
    def __getattr__(self, name: str) -> type:
        if name.startswith("__"):
            raise AttributeError(name)
        return _Names(name, (), {})


def install_where_absent() -> None:
    """Make the imports of timm and open_clip work where torchvision is not installed; call it before transformers."""
    if find_spec("torchvision") is not None:
        return
    for name in _MODULES:
        module = _StandIn(name)
        module.__path__, module.__spec__ = [], ModuleSpec(name, None)
        sys.modules[name] = module
        parent, _, child = name.rpartition(".")
        if parent:
            setattr(sys.modules[parent], child, module)
