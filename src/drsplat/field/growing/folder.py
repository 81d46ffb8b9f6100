"""Changing the views of a field on disk: one writer at a time, the folder replaced as a whole, objects found again."""

import os
from collections.abc import Callable, Collection
from dataclasses import replace
from pathlib import Path
from warnings import warn

from ...base.progress import Stopwatch
from ...errors import DrSplatWarning
from ...formats.replacing import claimed_output, sweep
from ...scene.gaussians import Gaussians
from ...scene.moving import Moving, canonical_of
from .. import LanguageField, load_field
from ..evidence.columns import part_name
from ..forest import JOINED, Objects
from ..objects.describing import joined
from ..objects.finding import find_objects
from .changing import Change


def parts_beside(path: str | os.PathLike[str]) -> Path:
    """Return the folder of the finished views of an unfinished run."""
    return Path(f"{os.path.realpath(path)}.parts")


def change_field(
    path: str | os.PathLike[str],
    scene: Gaussians | Moving,
    change: Callable[[LanguageField], Change],
    *,
    vote: Callable[[LanguageField], Objects] | None = None,
    threads: int = 0,
) -> Change:
    """Change the field in a folder by `change`, such as `add_views`; find its objects again where it has any.

    A run that is killed leaves the old field or the new one, and the same command can be given again. Labels of
    objects are beside the field and stay.

    vote: finds objects where photos voted for those there are (`photos.embedding.voting.vote_for_objects`). Photos
    that are added join the old ones first, which can be asked for while they are made again; the seconds of both are in
    the result.

    Warns: DrSplatWarning: photos voted for the objects, and there is no `vote`.
    Raises: InputError: another process writes this field, there is none, the disk is full; as `change`.
    """
    path = Path(os.path.realpath(path))
    with claimed_output(path):
        watch = Stopwatch()
        field = load_field(path)
        watch.lap("load")
        done = change(field)
        seconds = {**watch.seconds, **done.seconds}
        objects = field.objects
        if not done.is_empty or (objects is not None and objects.votes == JOINED):
            watch = Stopwatch()
            new = done.field
            if objects is not None:
                gaussians = canonical_of(scene)
                if objects.votes and vote is None:
                    text = "photos voted for the objects, which are found again without votes: let them vote again"
                    warn(text, DrSplatWarning, stacklevel=2)
                elif objects.votes and done.added and not done.replaced:
                    new = new.with_objects(joined(field, new, gaussians, threads=threads))
                    new.save(path, overwrite=True)
                    watch.lap("joined")
                votes = vote if objects.votes else None
                new = new.with_objects(votes(new) if votes else find_objects(new, gaussians, threads=threads))
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
