"""Catalogue: the objects of many scenes in one table, searched in words.

Only `table` uses LanceDB and Arrow, both of the extra `catalogue`; they are imported when a catalogue is used.
"""

from .catalogue import Catalogue
from .conditions import Conditions
from .entries import CatalogueAnswer, Entry, SceneEntry

__all__ = ["Catalogue", "CatalogueAnswer", "Conditions", "Entry", "SceneEntry"]
