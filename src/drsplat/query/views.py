"""Views by the names that people use."""

from collections.abc import Sequence
from pathlib import Path

from ..errors import InputError, did_you_mean
from ..scene.views import View


def view_named(views: Sequence[View], name: str) -> View:
    """Return the view of a file name, with or without suffix.

    Raises: InputError: there is none; the message has the nearest names.
    """
    if not views:
        raise InputError(
            f"there is no view '{name}': this scene has none: pass views=CAPTURE, the photos and their poses"
        )
    for view in views:
        path = Path(view.name)
        if name in (view.name, str(path.with_suffix("")), path.name, path.stem):
            return view
    near = did_you_mean(name, [view.name if Path(name).suffix else Path(view.name).stem for view in views])
    raise InputError(
        f"there is no view '{name}': this capture has {len(views)}, from '{views[0].name}' to '{views[-1].name}'.{near}"
    )
