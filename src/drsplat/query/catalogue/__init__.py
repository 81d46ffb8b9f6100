"""Catalogue: the objects of many scenes in one table, searched in words.

Only `table` uses LanceDB and Arrow, both of the extra `catalogue`; they are imported when a catalogue is used.
"""

from .catalogue import Catalogue
from .conditions import Where
from .entries import CatalogueAnswer, Entry, Listed

__all__ = ["Catalogue", "CatalogueAnswer", "Entry", "Listed", "Where"]
