"""`mini`: an image-text encoder of a megabyte that knows household things of the small world, and no more.

It is learned from renderings (`world/` in the repository) and runs on NumPy. It shows the whole road
from photos to answers without any download; it is no CLIP.
"""

from .encoder import MiniEncoder

__all__ = ["MiniEncoder"]
