"""A field's folder with other views: one writer at a time, replaced as a whole, and what was found in it follows."""

import os
from collections.abc import Callable, Collection
from dataclasses import replace
from pathlib import Path

from ..evidence.columns import part_name
from ..field import LanguageField, load_field
from ..formats.claiming import claimed_output
from ..formats.replacing import sweep
from ..objects.finding import find_objects
from ..progress import Stopwatch
from ..scene.gaussians import Gaussians
from ..scene.moving import Moving, canonical_of
from .changing import Change


def parts_beside(path: str | os.PathLike[str]) -> Path:
    """The folder of the finished views of an unfinished run."""
    return Path(f"{os.path.realpath(path)}.parts")


def change_field(
    path: str | os.PathLike[str],
    scene: Gaussians | Moving,
    change: Callable[[LanguageField], Change],
    *,
    threads: int = 0,
) -> Change:
    """Change the field in a folder, as `add_views` or `remove_views` do; where it has objects they are found again.

    Killed at any moment it leaves the field as it was or as it is then, and the same command can be given again. Names
    that people gave to objects are beside the field and stay.

    Raises: InputError: another process writes this field, there is none, the disk is full; as `change`.
    """
    path = Path(os.path.realpath(path))
    with claimed_output(path):
        watch = Stopwatch()
        field = load_field(path)
        watch.lap("load")
        done = change(field)
        seconds = {**watch.seconds, **done.seconds}
        if not done.is_none:
            watch = Stopwatch()
            new = done.field
            if field.objects is not None:
                new = new.with_objects(find_objects(new, canonical_of(scene), threads=threads))
                watch.lap("objects")
            new.save(path, overwrite=True)
            watch.lap("save")
            done, seconds = replace(done, field=new), {**seconds, **watch.seconds}
        return replace(done, seconds=seconds)


def remove_parts(parts: Path, names: Collection[str]) -> None:
    """Remove the parts of views that are in the field now; the folder too, if nothing else is in it."""
    for name in names:
        (parts / part_name(name)).unlink(missing_ok=True)
    if parts.is_dir():
        sweep(parts)
    if parts.is_dir() and not any(parts.iterdir()):
        parts.rmdir()
