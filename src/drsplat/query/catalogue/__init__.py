"""Catalogue: the objects of many scenes in one folder, searched in words."""

from .catalogue import Catalogue
from .entries import CatalogueAnswer, Conditions, Entry, SceneEntry

__all__ = ["Catalogue", "CatalogueAnswer", "Conditions", "Entry", "SceneEntry"]
