"""The engine: an opened `Scene` is asked a `Query` and gives an `Answer`, and `Match`es where it has Gaussians.

Every rule of measuring, cutting and grouping is here, and every default: the command line, Python, the viewer, HTTP,
MCP, the demo and the evaluation turn their input into a query and show an answer. `catalogue` asks many scenes at once.
Begin with `query`, `scene` and `tasks`. Names are loaded when they are first used: the command line reads the defaults
here without NumPy.

Imports `scene`, `formats`, `kernels`, `field`, `photos` and `drawing`.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .answer import Answer, Match, MatchTrack, Segmentation, Word
    from .encoding import encoder_for
    from .held import view_named
    from .opening import SceneFiles, find_scene, open_scene, registered_scene
    from .query import Cut, Query
    from .scene import Scene

_HOMES = {
    "answer": ("Answer", "Match", "MatchTrack", "Segmentation", "Word"),
    "encoding": ("encoder_for",),
    "opening": ("SceneFiles", "find_scene", "open_scene", "registered_scene"),
    "query": ("Cut", "Query"),
    "scene": ("Scene",),
    "held": ("view_named",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "Answer",
    "Cut",
    "Match",
    "MatchTrack",
    "Query",
    "Scene",
    "SceneFiles",
    "Segmentation",
    "Word",
    "encoder_for",
    "find_scene",
    "open_scene",
    "registered_scene",
    "view_named",
]


def __getattr__(name: str) -> object:
    if name not in _HOME_OF:
        raise AttributeError(f"module 'drsplat.query' has no attribute '{name}'")
    return getattr(import_module(f".{_HOME_OF[name]}", __name__), name)
