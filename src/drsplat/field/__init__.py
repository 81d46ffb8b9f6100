"""The artefact of the method: a language field, built from evidence, saved, loaded and searched.

Imports `encoders`, `scene`, `formats`, `kernels`, `codes` and `evidence`.
"""

from .building import AT_ONCE, RowCoder, build_field
from .carrying import Assignment, assign, carry_field, carry_label
from .language_field import LanguageField, Negatives, WordList, relevancy_from_scores
from .loading import load_field
from .regrowing import regrown_field, whole_evidence

__all__ = [
    "AT_ONCE", "Assignment", "LanguageField", "Negatives", "RowCoder", "WordList", "assign", "build_field",
    "carry_field", "carry_label", "load_field", "regrown_field", "relevancy_from_scores", "whole_evidence",
]  # fmt: skip
