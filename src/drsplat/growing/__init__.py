"""Adding views to a registered scene and removing them: only these are read, and the field equals one of all at once.

Imports `codes`, `encoders`, `evidence`, `field`, `formats`, `kernels`, `masks`, `objects`, `registration` and `scene`.
"""

from .changing import Change, add_views, remove_views
from .folder import change_field
from .swapping import with_weights_of

__all__ = ["Change", "add_views", "change_field", "remove_views", "with_weights_of"]
