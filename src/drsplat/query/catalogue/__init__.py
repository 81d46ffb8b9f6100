"""Catalogue: the objects of many scenes in one table, searched in words.

Only `table` uses LanceDB and Arrow, both of the extra `catalogue`; they are imported when a catalogue is used.
"""

from .catalogue import Catalogue
from .entries import CatalogueAnswer, Conditions, Entry, SceneEntry

__all__ = ["Catalogue", "CatalogueAnswer", "Conditions", "Entry", "SceneEntry"]
