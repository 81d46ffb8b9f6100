"""The artefact of the method: a language field, built from evidence, saved, loaded and searched.

Imports `encoders`, `scene`, `formats`, `kernels`, `codes` and `evidence`.
"""

from .building import build_field
from .language_field import LanguageField, Negatives, WordList, relevancy_from_scores
from .loading import load_field

__all__ = ["LanguageField", "Negatives", "WordList", "build_field", "load_field", "relevancy_from_scores"]
