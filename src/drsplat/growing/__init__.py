"""Views that come to a registered scene and go from it: only they are looked at, and the field is as of all at once.

Imports `codes`, `encoders`, `evidence`, `field`, `formats`, `kernels`, `masks`, `objects`, `registration` and `scene`.
"""

from .changing import Change, add_views, remove_views
from .folder import change_field
from .swapping import with_weights_of

__all__ = ["Change", "add_views", "change_field", "remove_views", "with_weights_of"]
