"""Language features by photo, in LangSplat's form or in our compact one.

LangSplat's are `<photo>_s.npy`, mask maps, and `<photo>_f.npy`, embeddings; ours is
`<photo>.features.safetensors`, which holds the same.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from ..base.arrays import Array, Embeddings, Indices, Int64, LevelMaskIds
from ..base.terminal import counted
from ..errors import DrSplatError, FormatError, InputError, MismatchError
from ..scene.encoders import EncoderIdentity
from ..scene.masks.features import ViewFeatures
from ..scene.masks.masks import LEVELS
from .compact_features import read_compact, write_compact
from .embedding_record import COMPACT, EMBEDDINGS, MAPS, Form, check_finished, read_record, stems
from .npy import map_npy, write_npy
from .photo_files import by_folded, folded, listed, safe_name
from .scenes import Kind, mistaken


@runtime_checkable
class FeatureFile(Protocol):
    """Features of a photo: embeddings (N, D), and at each level the row of each pixel, -1 for none.

    path: the file that errors name.
    """

    @property
    def path(self) -> Path: ...
    @property
    def embeddings(self) -> Array: ...
    def count_levels(self) -> int: ...
    def ids(self, level: int) -> Int64[Array, "h w"]: ...


class _Pair(NamedTuple):
    """LangSplat's two files of a photo."""

    path: Path
    maps: Path
    embeddings: Array

    def ids(self, level: int) -> Int64[Array, "h w"]:
        return _level_ids(self.maps, level, len(self.embeddings))

    def count_levels(self) -> int:
        return len(LEVELS) if map_npy(self.maps).ndim == 3 else 1


@dataclass(frozen=True, eq=False, repr=False)
class LevelFeatures(ViewFeatures):
    """The masks of one level of one photo, numbered 0..S-1.

    file_rows: the row of `_f.npy` that each mask has, ascending; its id in `_s.npy`.
    """

    file_rows: Indices


class FeatureFolder(Mapping[str, ViewFeatures]):
    """Photos' features by name, read when asked for. Made by `read_features`.

    Keys are paths of photos relative to the folder, without suffix. Looking up takes the name of a view as well:
    "cam0/0001.jpg" finds "cam0/0001", else "0001" (LangSplat writes all features into one folder, where photos of one
    name in several folders cannot be told apart; `key` says what is found).

    level: index into LEVELS. encoder: who made the embeddings, where the folder or the caller knows. dim: their D.
    record: what `embed` noted; None for files of other programs.
    """

    def __init__(
        self, directory: Path, level: int, encoder: EncoderIdentity | str | None = None,
        fallback: EncoderIdentity | None = None,
    ) -> None:  # fmt: skip
        self.directory, self.level, self.record = directory, level, read_record(directory)
        self._keys, self._finished = _listed_keys(directory), {} if self.record is None else self.record.finished
        self.dim = int(self._files(next(iter(self._keys))).embeddings.shape[1])
        named = EncoderIdentity(encoder, self.dim) if isinstance(encoder, str) else encoder
        self.encoder = encoder = named or fallback if self.record is None else self.record.embedded_by(named)
        if encoder is not None and encoder.dim != self.dim:
            raise MismatchError(
                f"{directory}: its embeddings have {self.dim} dimensions, those of {encoder.name} have {encoder.dim}: "
                "name the encoder that made them"
            )

    def __repr__(self) -> str:
        by = "unknown" if self.encoder is None else self.encoder.name
        level, photos = LEVELS[self.level], counted(len(self), "photo")
        return f"FeatureFolder('{self.directory}', {photos}, {level}, {self.dim}-d by {by})"

    def key(self, name: str) -> str | None:
        """Return the key that the name of a view finds, or None."""
        path = PurePosixPath(name)
        candidates = (name, (path.parent / path.stem).as_posix(), path.stem)
        exact = next((candidate for candidate in candidates if candidate in self._keys), None)
        return next(filter(None, map(self._by_folded.get, map(folded, candidates))), None) if exact is None else exact

    @cached_property
    def _by_folded(self) -> dict[str, str]:
        return by_folded(self._keys)

    def __getitem__(self, name: str) -> LevelFeatures:
        """Read the features of a photo.

        Raises: KeyError: no such photo. FormatError: a damaged file, or those of another photo; the error names file
        and row.
        """
        files = self._files(self._known(name))
        rows, ids = files.embeddings, files.ids(self.level)
        used = np.zeros(len(rows) + 1, bool)  # the last is that of -1
        used[ids] = True
        file_rows = np.flatnonzero(used[:-1])
        compact = np.full(len(rows) + 1, -1, np.int32)
        compact[file_rows] = np.arange(len(file_rows), dtype=np.int32)
        features = LevelFeatures(compact[ids], unit_rows(rows, file_rows, files.path), file_rows)
        if features.embeddings.shape[1] != self.dim:
            raise FormatError(
                f"{files.path}: has {features.embeddings.shape[1]} dimensions, the folder's first has {self.dim}"
            )
        return features

    def stored(self, name: str) -> tuple[LevelMaskIds, Embeddings]:
        """Return all levels of a photo and its embeddings as they are in its files: what `write_features` takes.

        Raises: as indexing does.
        """
        key = self._known(name)
        return stored_features(self.directory, key, self._keys[key])

    def files(self, name: str) -> list[Path]:
        """Return the files with the features of a photo, first that of its masks. Raises: KeyError: no such photo."""
        key = self._known(name)
        return [self.directory / f"{key}{ending}" for ending in FORMS[self._keys[key]][0]]

    def can_read(self, name: str) -> bool:
        """Return True if the features of a photo are there and whole; while they are written they are not."""
        try:
            _ = self[name]
        except (DrSplatError, KeyError, OSError):
            return False
        return True

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and self.key(name) is not None

    def __iter__(self) -> Iterator[str]:
        return iter(self._keys)

    def __len__(self) -> int:
        return len(self._keys)

    def _known(self, name: str) -> str:
        key = self.key(name)
        if key is None:
            raise KeyError(f"{self.directory} has no features of '{name}'")
        return key

    def _files(self, key: str) -> FeatureFile:
        files = FORMS[self._keys[key]][1](self.directory, key)
        if key in self._finished:
            check_finished(self._finished[key], self.directory, key)
        return files


def read_features(
    directory: str | Path,
    level: str | int = "large",
    encoder: EncoderIdentity | str | None = None,
    fallback: EncoderIdentity | None = None,
) -> FeatureFolder:
    """Open one level of a folder of features, in LangSplat's form or the compact one; photos are read on demand.

    level: "default", "small", "medium" or "large", or 0..3 in this order. A trap: Dr. Splat's own
    preprocessing stores its *large* masks in all four levels and its README trains with
    `--feature_level 1`; in features that LangSplat made, level 1 is *small*, and the same command
    gives a much worse field. Naming "large" is right for both. A map without levels, (H, W), serves
    any.
    encoder: who made the embeddings, or its name, where the folder has no note of it, as `drsplat embed` leaves.
    fallback: who made them where nothing else says.

    `_s.npy` is (4, H, W), integers or whole floats, -1 for no mask; ids are rows of `_f.npy`,
    which is (N, D) in half or single precision. Rows are brought to unit length on reading.

    Raises: InputError: no such folder or level, no features in it. FormatError: maps without
    embeddings. MismatchError: the encoder has another D, or the folder is noted to be of another.
    Source: LangSplat preprocess.py.

    >>> len(ds.read_features("capture/language_features"))
    4
    """
    number = level_index(level)
    return FeatureFolder(Path(directory), number, encoder, fallback)


def level_index(level: str | int) -> int:
    """Return 0..3 of a level's name or number."""
    if isinstance(level, str) and level in LEVELS:
        return LEVELS.index(level)
    if isinstance(level, int) and 0 <= level < len(LEVELS):
        return int(level)
    raise InputError(f"level: expected one of {', '.join(LEVELS)} or 0..3, got {level!r}")


def write_features(
    directory: str | Path,
    stem: str,
    mask_ids: LevelMaskIds,
    embeddings: Embeddings,
    overwrite: bool = False,
    form: Form = "langsplat",
) -> None:
    """Write one photo's features as LangSplat does: `<stem>_f.npy`, then `<stem>_s.npy`.

    The maps come last, so a photo that is listed is complete. mask_ids: (4, H, W) in the order of LEVELS, or one (H,
    W). Folders in the stem are made. form: "compact" writes the same as one file `<stem>.features.safetensors`, which
    only drsplat reads, some hundredth of the size. Files of the other form are replaced as well.

    Raises: InputError: wrong shapes, an id without a row, a stem that leaves the folder, existing files, another form.
    """
    if form not in FORMS:
        raise InputError(f"form: expected {' or '.join(map(repr, FORMS))}, got {form!r}")
    if mask_ids.ndim not in (2, 3) or (mask_ids.ndim == 3 and len(mask_ids) != len(LEVELS)):
        raise InputError(f"mask_ids: expected (4, H, W) or (H, W), got {mask_ids.shape}")
    if mask_ids.min(initial=0) < -1 or mask_ids.max(initial=-1) >= len(embeddings):
        raise InputError(f"mask_ids: expected -1 or a row of the {len(embeddings)} embeddings")
    try:
        path = Path(directory) / safe_name(stem, "stem")
    except FormatError as error:
        raise InputError(str(error)) from None
    path.parent.mkdir(parents=True, exist_ok=True)
    compact, maps, rows = (path.with_name(path.name + ending) for ending in (COMPACT, MAPS, EMBEDDINGS))
    others = (maps, rows) if form == "compact" else (compact,)
    if not overwrite and any(other.exists() for other in others):
        raise InputError(f"{path} has features of another form: pass overwrite=True to replace them")
    for other in others:
        other.unlink(missing_ok=True)
    if form == "compact":
        write_compact(compact, mask_ids, embeddings, overwrite)
    else:
        write_npy(rows, embeddings, overwrite)
        write_npy(maps, mask_ids, overwrite)


def has_features(directory: Path) -> bool:
    """Return True if a folder holds features of any form, it or its subfolders."""
    return any(next(directory.rglob(f"*{ending}"), None) for (ending, *_), _ in FORMS.values())


def _listed_keys(directory: Path) -> dict[str, Form]:
    """Return the form of each photo's features. Raises: FormatError: a file is missing, or there are two forms."""
    forms: dict[str, Form] = {}
    for name, ((first, *others), _) in FORMS.items():
        keys = stems(directory, first)
        for ending in others:
            if bare := [key for key in keys if not (directory / f"{key}{ending}").is_file()]:
                raise FormatError(
                    f"{directory}: {len(bare)} of {len(keys)} photos have {first} but no {ending}: {listed(bare)}"
                )
        if twice := [key for key in keys if key in forms]:
            two = f"{first} and {FORMS[forms[twice[0]]][0][0]}"
            raise FormatError(
                f"{directory}: {len(twice)} photos have features in two forms, {two}: remove one: {listed(twice)}"
            )
        forms |= dict.fromkeys(keys, name)
    if not forms:
        raise mistaken(directory, Kind.FEATURES)
    return dict(sorted(forms.items()))


def stored_features(directory: Path, stem: str, form: Form) -> tuple[LevelMaskIds, Embeddings]:
    """See `FeatureFolder.stored`."""
    files = FORMS[form][1](directory, stem)
    maps = np.stack([files.ids(level).astype(np.int32) for level in range(files.count_levels())])
    with np.errstate(over="ignore", under="ignore"):
        return maps if len(maps) > 1 else maps[0], np.array(files.embeddings, np.float32)


def _open_pair(directory: Path, stem: str) -> _Pair:
    maps, embeddings = (directory / f"{stem}{ending}" for ending in (MAPS, EMBEDDINGS))
    rows = map_npy(embeddings)
    if rows.ndim != 2 or rows.shape[1] < 1 or rows.dtype.kind != "f":
        raise FormatError(f"{embeddings}: expected floats (N, D), got {rows.dtype} {rows.shape}")
    return _Pair(embeddings, maps, rows)


FORMS: Mapping[Form, tuple[tuple[str, ...], Callable[[Path, str], FeatureFile]]] = {
    "langsplat": ((MAPS, EMBEDDINGS), _open_pair),
    "compact": ((COMPACT,), lambda directory, stem: read_compact(directory / f"{stem}{COMPACT}")),
}
"""Endings of a photo's files, of which the first holds its masks, and how they are opened."""


def _level_ids(path: Path, level: int, num_rows: int) -> Int64[Array, "h w"]:
    maps = map_npy(path)
    if 0 in maps.shape or not (maps.ndim == 2 or (maps.ndim == 3 and len(maps) == len(LEVELS))):
        raise FormatError(f"{path}: expected (4, H, W) or (H, W), got {maps.shape}")
    stored = np.ascontiguousarray(maps[level] if maps.ndim == 3 else maps)
    # in the file's own type: a cast would wrap or hide what is wrong
    wrong = ~((stored >= -1) & (stored < num_rows)) if stored.dtype.kind != "u" else stored >= num_rows
    if stored.dtype.kind == "f":
        wrong |= stored != np.floor(stored)
    if wrong.any():
        y, x = np.argwhere(wrong)[0]
        raise FormatError(
            f"{path}: level {LEVELS[level]}, pixel ({x}, {y}) has mask {stored[y, x]}: expected -1 or one of the "
            f"{num_rows} rows of {path.name.removesuffix(MAPS)}{EMBEDDINGS}"
        )
    return stored.astype(np.int64)


def unit_rows(rows: Array, wanted: Indices, path: Path) -> Embeddings:
    """Return some rows of a file, brought to unit length. Raises: FormatError: one has no direction."""
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        taken = rows[wanted].astype(np.float64)
        norms = np.sqrt((taken**2).sum(1))
    bad = wanted[~(np.isfinite(norms) & (norms > 0))]
    if len(bad):
        raise FormatError(
            f"{path}: row {bad[0]} has no direction (zero or not finite); {len(bad)} such rows are in use"
        )
    return (taken / norms[:, None]).astype(np.float32)
