"""Names, stems and patterns of views as people type them."""

from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import PurePosixPath

from ...errors import InputError
from ...formats.photo_files import listed


def views_named(wanted: Sequence[str], names: Sequence[str]) -> tuple[str, ...]:
    """Return the views that names, stems or patterns mean, in the order of `names`.

    A name means the view of that name, else those of that name but for the suffix, or but for the folder.

    Raises: InputError: something means no view.
    """
    views_by_text = {text: _meant(text, names) for text in wanted}
    unknown = [text for text, views in views_by_text.items() if not views]
    if unknown:
        example = f"views are named like '{names[0]}'" if names else "there are none"
        raise InputError(f"views: nothing here is named {listed(unknown)}: {example}")
    chosen = set().union(*views_by_text.values())
    return tuple(name for name in names if name in chosen)


def _meant(text: str, names: Sequence[str]) -> set[str]:
    if text in names:
        return {text}
    paths = [PurePosixPath(name) for name in names]
    full, without_suffix = [path.as_posix() for path in paths], [path.with_suffix("").as_posix() for path in paths]
    for spelled in (full, without_suffix, [path.stem for path in paths]):
        matches = {name for name, way in zip(names, spelled, strict=True) if fnmatchcase(way, text)}
        if matches:
            return matches
    return set()
