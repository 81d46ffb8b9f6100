"""The method: features and a scene become a field. Registration, evidence, codes, objects, growth and tiles.

The room's own modules are of a language field: built from evidence, saved, loaded and searched. Begin with
`registration`, then `building` and `language_field`. Names are loaded when they are first used: who asks a field loads
nothing of what builds it.

Imports `scene`, `formats` and `kernels`.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .building import AT_ONCE, RowCoder, build_field
    from .carrying import Assignment, assign, carry_field, carry_label
    from .language_field import LanguageField, Negatives, WordList, relevancy_from_scores
    from .loading import load_field
    from .regrowing import regrown_field, whole_evidence

_HOMES = {
    "building": ("AT_ONCE", "RowCoder", "build_field"),
    "carrying": ("Assignment", "assign", "carry_field", "carry_label"),
    "language_field": ("LanguageField", "Negatives", "WordList", "relevancy_from_scores"),
    "loading": ("load_field",),
    "regrowing": ("regrown_field", "whole_evidence"),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "AT_ONCE", "Assignment", "LanguageField", "Negatives", "RowCoder", "WordList", "assign", "build_field",
    "carry_field", "carry_label", "load_field", "regrown_field", "relevancy_from_scores", "whole_evidence",
]  # fmt: skip


def __getattr__(name: str) -> object:
    if name not in _HOME_OF:
        raise AttributeError(f"module 'drsplat.field' has no attribute '{name}'")
    return getattr(import_module(f".{_HOME_OF[name]}", __name__), name)
