"""Choice of the edits that a call applies: those kept beside the scene, or its own alone."""

from typing import Literal

from ...errors import InputError

KeptEdits = Literal["kept", "none"]


def without_kept(choice: KeptEdits | None, *, changes: bool, saves: bool) -> bool:
    """Return whether a call leaves out the edits that are kept beside the scene, and keeps none of its own.

    What only shows a scene, or saves it, applies the kept edits. A change that is saved is done to the scene's own
    file: the output has what this call asked for, and the kept list stays as it was.

    Args:
        choice: what was asked for; None where nothing was.
        changes: whether the call makes edits.
        saves: whether it writes the edited scene.

    Raises: InputError: edits that would go nowhere.
    """
    if choice == "none" and changes and not saves:
        raise InputError("edits: 'none' keeps no change beside the scene, and no output is named: pass save=OUT.ply")
    return choice == "none" or (choice is None and changes and saves)
