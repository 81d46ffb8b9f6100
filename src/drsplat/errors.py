"""Everything that can go wrong, as one tree: catch `DrSplatError` to catch all of it.

A message says what was given, what was expected and what to do.
"""


class DrSplatError(Exception):
    """Root of every error that drsplat raises on purpose."""


class InputError(DrSplatError, ValueError):
    """An argument is out of its range or has the wrong shape."""


class FormatError(DrSplatError, ValueError):
    """A file is damaged, truncated or not what its name says."""


class MismatchError(DrSplatError):
    """Two things that are each fine do not belong together (scene, encoder, codebook)."""


class MissingExtraError(DrSplatError, ImportError):
    """An optional dependency is not installed; the message has the pip line."""


class DrSplatWarning(UserWarning):
    """Something was left out and the caller should know which and how many."""
