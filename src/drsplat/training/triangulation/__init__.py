"""Points triangulated from posed photos: where several photos show the same place.

A capture of a phone has poses and no points. SIFT finds places that look alike, the poses say which of them can
be one place, and rays through the same place meet in a point.
"""

from .structure import Triangulation, triangulate

__all__ = ["Triangulation", "triangulate"]
