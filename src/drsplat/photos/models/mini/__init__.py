"""`mini`: an image-text encoder of a megabyte that knows household objects of the small world, and no more.

It is trained on renderings (`world/` in the repository) and runs on NumPy. It allows the whole way from photos to
answers without a download; it does not replace CLIP.
"""

from .encoder import MiniEncoder

__all__ = ["MiniEncoder"]
