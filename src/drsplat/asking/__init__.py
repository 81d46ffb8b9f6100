"""Asking an opened scene: the questions of the command line, the viewer, the service and language models.

Names are loaded when they are first used: the command line reads the defaults here without NumPy.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .answering import Asked, Asking, Background
    from .encoding import encoder_for
    from .opening import SceneFiles, find_scene, open_scene
    from .query import Answer, query
    from .questions import Question
    from .scene import AskableScene, Classes, Found, Named
    from .views import view_named

_HOMES = {
    "answering": ("Asked", "Asking", "Background"),
    "encoding": ("encoder_for",),
    "opening": ("SceneFiles", "find_scene", "open_scene"),
    "query": ("Answer", "query"),
    "questions": ("Question",),
    "scene": ("AskableScene", "Classes", "Found", "Named"),
    "views": ("view_named",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "Answer",
    "AskableScene",
    "Asked",
    "Asking",
    "Background",
    "Classes",
    "Found",
    "Named",
    "Question",
    "SceneFiles",
    "encoder_for",
    "find_scene",
    "open_scene",
    "query",
    "view_named",
]


def __getattr__(name: str) -> object:
    if name not in _HOME_OF:
        raise AttributeError(f"module 'drsplat.asking' has no attribute '{name}'")
    return getattr(import_module(f".{_HOME_OF[name]}", __name__), name)
