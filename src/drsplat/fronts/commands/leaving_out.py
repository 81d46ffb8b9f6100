"""--without: photos that are kept for measuring, and so may not be learnt from; and people, who walk through."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from ...errors import FormatError, InputError
from .declaring import flag, option, whole, words

if TYPE_CHECKING:
    from ...scene.views import View

EVERY_PREFIX = "every:"


def without() -> Any:
    return option(
        "photos to leave out: a file with a name per line, or every Nth by name, starting with the first, as `drsplat "
        "train` holds them out (default: none)", "FILE|every:N", words,
    )  # fmt: skip


def keep_people(title: str = "", what: str = "people, and what moves,") -> Any:
    return flag(f"keep {what} in photos that come without masks (default: they are left out)", title=title)


def people_text(count: int, of: int) -> str:
    return f"people in {count:,} of {of:,} photos are left out"


def transients_text(count: int, of: int) -> str:
    return f"what moves is left out of {count:,} of {of:,} photos"


@contextmanager
def without_people(options: Any, views: list[View], transforms: str | None) -> Iterator[list[View]]:
    """Yield the views, with masks that leave people out while the block runs.

    Nobody is looked for where the user keeps people, the photos have masks, or `drsplat capture` has looked already.
    transforms: the file that says in which frame the views are.
    """
    from ... import read_sparse_points
    from ...photos.capture.work import RECORD
    from ...photos.models.people import without_people as masked

    record = Path(options.capture, RECORD)
    has_looked = record.is_file() and b"num_with_people" in record.read_bytes()
    if options.keep_people or has_looked or any(view.mask_path for view in views):
        yield views
        return
    points = read_sparse_points(options.capture, dataparser_transforms=transforms)
    with TemporaryDirectory(prefix="drsplat-") as folder:
        found = masked(views, points, Path(folder), track=options.track, threads=options.threads)
        count = sum(view.mask_path is not None for view in found)
        if count and not options.json:
            print(f"drsplat: {people_text(count, len(views))}", file=sys.stderr)
        yield found


def left_out(names: Sequence[str], without: str | None) -> set[str]:
    """Return those of the photos' names that --without means.

    Raises: InputError: no such file, names that no photo has, all photos, or none.
    """

    if without is None:
        return set()
    chosen = _every(names, without) if without.startswith(EVERY_PREFIX) else _listed(names, without)
    if not chosen or len(chosen) == len(set(names)):
        raise InputError(
            f"--without {without}: leaves out {len(chosen)} of {len(set(names))} photos: name some, not all"
        )
    return chosen


def _every(names: Sequence[str], without: str) -> set[str]:

    try:
        step = whole(without.removeprefix(EVERY_PREFIX), least=2)
    except argparse.ArgumentTypeError as error:
        raise InputError(f"--without {without}: {error}") from None
    return set(sorted(names)[::step])


def _listed(names: Sequence[str], path: str) -> set[str]:
    from ...formats.photo_files import listed

    by_name = {Path(name).with_suffix("").as_posix(): name for name in names}
    by_name |= {name: name for name in names}
    if not Path(path).is_file():
        raise InputError(
            f"--without {path}: there is no such file: expected one with a photo's name on each line, or every:N"
        )
    wanted = lines_of(path, "a photo's name")
    unknown = [name for name in wanted if name not in by_name]
    if unknown:
        raise InputError(
            f"--without {path}: no photo has these names: {listed(unknown)}. Photos are named like {min(names)}"
        )
    return {by_name[name] for name in wanted}


def lines_of(path: str, what: str) -> list[str]:
    """Return the lines of a text file, without empty ones.

    Raises: InputError: there is no such file. FormatError: it is not in UTF-8.
    """
    from ...base.contents import file_text

    if not Path(path).is_file():
        raise InputError(f"{path}: there is no such file")
    try:
        text = file_text(path)
    except UnicodeDecodeError as error:
        raise FormatError(f"{path}: expected text in UTF-8, {what} on a line: {error}") from None
    return [line.strip() for line in text.splitlines() if line.strip()]
