"""Adding views to a registered scene and removing them: only these are read, and the field is that of all at once."""

from .changing import Change, add_views, remove_views
from .folder import change_field
from .swapping import with_weights_of

__all__ = ["Change", "add_views", "change_field", "remove_views", "with_weights_of"]
