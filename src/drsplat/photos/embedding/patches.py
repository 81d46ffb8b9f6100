"""Patches for a codebook: outlined objects of a data set, embedded as masks of a scene are.

A codebook that is trained once on many things of all kinds fits every scene of the same encoder.
Source: Dr. Splat Sec. B (LVIS).
"""

import hashlib
import json
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import numpy as np

from ...base.arrays import Embeddings, Pixels
from ...errors import InputError, MismatchError, warn
from ...field.codes import Track, untracked
from ...formats.json_files import read_json, write_json
from ...formats.lvis import AnnotatedPhoto, Annotations, Instance
from ...formats.photo_files import listed
from ...scene.encoders import EncoderIdentity, ImageEncoder, identity_json
from ...scene.masks.masks import Masks, cut_masks
from ...scene.photos import load_image, photo_size
from ...scene.views import View
from .keeping import mask_rows

ALGORITHM = "1"  # version of everything here that decides a patch
MIN_AREA_PIXELS = 100
"""Pixels of the smallest patch: segmenters drop smaller masks, so no scene has any.
Source: SAM's min_mask_region_area as LangSplat sets it."""


class PhotoPatches(NamedTuple):
    """Wanted instances of one photo, and the photo's path."""

    photo: AnnotatedPhoto
    path: Path
    instances: tuple[Instance, ...]


@dataclass(frozen=True)
class PatchSource:
    """Photos with their wanted instances, in the order of the file; see `find_patches`.

    missing: names of photos that are not in the folder. left_out: instances that are crowds, smaller
    than MIN_AREA_PIXELS by the file's own area, or of missing photos.
    """

    annotations: Annotations
    photos: tuple[PhotoPatches, ...]
    missing: tuple[str, ...]
    left_out: int

    @property
    def num_wanted(self) -> int:
        return sum(len(photo.instances) for photo in self.photos)


class EmbeddedPatches(NamedTuple):
    """Embedded patches. embeddings: a row each, on disk. too_small: instances whose mask is below MIN_AREA_PIXELS."""

    embeddings: Embeddings
    too_small: int


def find_patches(annotations: Annotations, images: str | Path, limit: int | None = None, seed: int = 0) -> PatchSource:
    """Choose the instances to cut out, at most `limit`, drawn by `seed`; no photo is opened yet.

    images: folder; photos are looked for by their name there, then by the last part of their name.

    Warns: DrSplatWarning: photos that are missing.
    Raises: InputError: all photos are missing, or no instance is large enough.
    """
    paths, missing = _find_photos(annotations, Path(images))
    usable = [
        place
        for place, instance in enumerate(annotations.instances)
        if instance.photo in paths and instance.area >= MIN_AREA_PIXELS and not instance.crowd
    ]
    if not usable:
        raise InputError(
            f"{annotations.path}: none of {len(annotations.instances)} instances in these photos has "
            f"{MIN_AREA_PIXELS} pixels or more"
        )
    left_out = len(annotations.instances) - len(usable)
    if limit is not None and limit < len(usable):
        drawn = np.random.default_rng(seed).choice(len(usable), limit, replace=False)
        usable = [usable[index] for index in np.sort(drawn)]
    by_photo: dict[int, list[Instance]] = defaultdict(list)
    for place in usable:
        by_photo[annotations.instances[place].photo].append(annotations.instances[place])
    photos = tuple(
        PhotoPatches(annotations.photos[number], paths[number], tuple(instances))
        for number, instances in by_photo.items()
    )
    return PatchSource(annotations, photos, missing, left_out)


def patches(source: PatchSource, photos: Sequence[PhotoPatches]) -> Iterator[tuple[Pixels, Masks]]:
    """Yield each photo with the masks of its instances; each photo is opened once.

    Instances whose mask has fewer than MIN_AREA_PIXELS pixels are left out.

    Raises: MismatchError: a photo of another size than annotated. FormatError: a damaged photo, a mask
    that does not fit its photo.
    """
    for photo, path, instances in photos:
        width, height = photo_size(path)
        if (width, height) != (photo.width, photo.height):
            raise MismatchError(
                f"{path}: the photo is {width}x{height}, annotated at {photo.width}x{photo.height}: use "
                "the photos that the annotations were made on"
            )
        image = load_image(View(photo.name, np.eye(3), np.eye(4), width, height, path))
        full = [source.annotations.mask(instance) for instance in instances]
        large = [mask for mask in full if np.count_nonzero(mask) >= MIN_AREA_PIXELS]
        stacked = np.stack(large) if large else np.empty((0, height, width), bool)
        yield image, cut_masks(stacked, np.ones(len(large), np.float32))


def embed_patches(
    source: PatchSource, encoder: ImageEncoder, folder: Path, track: Track = untracked
) -> EmbeddedPatches:
    """Embed the patches photo by photo into a file in `folder`, which is mapped, not loaded.

    A run continues after the photos that an earlier one with the same patches and encoder has done there.

    Raises: as `patches`. InputError: no patch is large enough.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rows_path, progress_path = folder / "embeddings.npy", folder / "progress.json"
    key, shape = _key(source, encoder.identity), (source.num_wanted, encoder.identity.dim)
    earlier = read_json(progress_path) if progress_path.is_file() and rows_path.is_file() else None
    resumes = isinstance(earlier, dict) and earlier.get("key") == key
    done, filled = (int(earlier[name]) for name in ("photos", "rows")) if resumes else (0, 0)  # type: ignore[index]
    rows = np.lib.format.open_memmap(rows_path, "r+" if resumes else "w+", np.float32, shape)
    following = source.photos[done:]
    steps = track(range(len(following)), "embedding patches")
    for _, (image, masks) in zip(steps, patches(source, following), strict=True):
        if len(masks):
            rows[filled : filled + len(masks)] = mask_rows(image, masks, encoder)
        done, filled = done + 1, filled + len(masks)
        write_json(progress_path, {"key": key, "photos": done, "rows": filled}, overwrite=True)
    if not filled:
        raise InputError(f"none of {source.num_wanted} patches has {MIN_AREA_PIXELS} pixels or more: give larger ones")
    return EmbeddedPatches(rows[:filled], source.num_wanted - filled)


def _find_photos(annotations: Annotations, folder: Path) -> tuple[dict[int, Path], tuple[str, ...]]:
    """Return the paths of existing photos that have instances, by id, and the names of those that are missing."""
    if not folder.is_dir():
        raise InputError(f"images: there is no folder '{folder}'")
    paths: dict[int, Path] = {}
    missing: list[str] = []
    for number in dict.fromkeys(instance.photo for instance in annotations.instances):
        name = annotations.photos[number].name
        candidates = (folder / name, folder / PurePosixPath(name).name)
        photo = next((path for path in candidates if path.is_file()), None)
        if photo is not None:
            paths[number] = photo
        else:
            missing.append(name)
    if missing and not paths:
        raise InputError(
            f"{folder}: none of the {len(missing)} annotated photos is there, e.g. "
            f"{listed(missing, 3)}: give the folder that they lie in, or that above the split's"
        )
    if missing:
        count = len(missing) + len(paths)
        warn(f"{folder}: {len(missing)} of {count} annotated photos are missing: {listed(missing)}", 3)
    return paths, tuple(missing)


def _key(source: PatchSource, encoder: EncoderIdentity) -> str:
    """Return a hash of all that decides the rows: the outlines, the photos by size and time, the encoder."""
    stats = [wanted.path.stat() for wanted in source.photos]
    file = source.annotations.path.stat()
    facts = [
        ALGORITHM,
        identity_json(encoder),
        [file.st_size, file.st_mtime_ns],
        [[instance.id for instance in wanted.instances] for wanted in source.photos],
        [[stat.st_size, stat.st_mtime_ns] for stat in stats],
    ]
    return hashlib.blake2b(json.dumps(facts).encode(), digest_size=16).hexdigest()
