"""Edits of a scene: a short list beside it that is applied to its Gaussians; the scene's own file stays as it is.

`edited` applies a list, `EditFile` keeps it, `targets` says what an edit is done to. A change is a module's dataclass
with `apply`.
"""

from .draft import Duplicate, Isolate, MatchPhoto, Move, Opacity, Palette, Recolour, Remove, Scale, Turn
from .edits import Edit, EditFile, EditList, edited
from .filling import Fill
from .replacement import Replace
from .targets import Box, Copies, Everything, Rows

__all__ = [
    "Box", "Copies", "Duplicate", "Edit", "EditFile", "EditList", "Everything", "Fill", "Isolate", "MatchPhoto", "Move",
    "Opacity", "Palette", "Recolour", "Remove", "Replace", "Rows", "Scale", "Turn", "edited",
]  # fmt: skip
