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
from warnings import warn

import numpy as np

from ...base.arrays import Embeddings, Pixels
from ...errors import DrSplatWarning, InputError, MismatchError
from ...field.codes import Track, untracked
from ...formats.json_files import read_json
from ...formats.lvis import AnnotatedPhoto, Annotations, Instance
from ...formats.photo_files import listed
from ...formats.replacing import replacing
from ...scene.encoders import EncoderIdentity, ImageEncoder, identity_json
from ...scene.masks.masks import Masks, cut_masks
from ...scene.photos import load_image, photo_size
from ...scene.views import View
from .keeping import mask_rows

ALGORITHM = "1"  # version of everything here that decides a patch
MIN_AREA_PIXELS = 100
"""Pixels of the smallest patch: segmenters drop smaller masks, so no scene has any.
Source: SAM's min_mask_region_area as LangSplat sets it."""


@dataclass(frozen=True)
class PhotoPatches:
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


class Patches(NamedTuple):
    """Photo with the masks of its wanted instances."""

    image: Pixels
    masks: Masks


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
    paths = _find_photos(annotations, Path(images))
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
    missing = _missing(annotations, paths)
    return PatchSource(annotations, photos, missing, left_out)


def patches(source: PatchSource, photos: Sequence[PhotoPatches]) -> Iterator[Patches]:
    """Yield each photo with the masks of its instances; each photo is opened once.

    Instances whose mask has fewer than MIN_AREA_PIXELS pixels are left out.

    Raises: MismatchError: a photo of another size than annotated. FormatError: a damaged photo, a mask
    that does not fit its photo.
    """
    return (_patches_of(source.annotations, wanted) for wanted in photos)


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
    done, filled = _progress(progress_path, key)
    resumes = done and rows_path.is_file()
    rows = np.lib.format.open_memmap(rows_path, "r+" if resumes else "w+", np.float32, shape)
    done, filled = (done, filled) if resumes else (0, 0)
    num_instances = sum(len(photo.instances) for photo in source.photos[:done])
    following = source.photos[done:]
    steps = track(range(len(following)), "embedding patches")
    for _, photo, (image, masks) in zip(steps, following, patches(source, following), strict=True):
        if len(masks):
            rows[filled : filled + len(masks)] = mask_rows(image, masks, encoder)
        done, filled, num_instances = done + 1, filled + len(masks), num_instances + len(photo.instances)
        with replacing(progress_path, overwrite=True) as file:
            file.write(json.dumps({"key": key, "photos": done, "rows": filled}).encode())
    if not filled:
        raise InputError(f"none of {num_instances} patches has {MIN_AREA_PIXELS} pixels or more: give larger ones")
    return EmbeddedPatches(rows[:filled], num_instances - filled)


def _find_photos(annotations: Annotations, folder: Path) -> dict[int, Path]:
    """Return the paths of existing photos that have instances, by id."""
    if not folder.is_dir():
        raise InputError(f"images: there is no folder '{folder}'")
    paths: dict[int, Path] = {}
    for number in dict.fromkeys(instance.photo for instance in annotations.instances):
        name = annotations.photos[number].name
        candidates = (folder / name, folder / PurePosixPath(name).name)
        photo = next((path for path in candidates if path.is_file()), None)
        if photo is not None:
            paths[number] = photo
    missing = _missing(annotations, paths)
    if missing and not paths:
        raise InputError(
            f"{folder}: none of the {len(missing)} annotated photos is there, e.g. "
            f"{listed(list(missing), 3)}: give the folder that they lie in, or that above the split's"
        )
    if missing:
        text = f"{folder}: {len(missing)} of {len(missing) + len(paths)} annotated photos are missing: "
        warn(text + listed(list(missing)), DrSplatWarning, stacklevel=4)
    return paths


def _missing(annotations: Annotations, paths: dict[int, Path]) -> tuple[str, ...]:
    wanted = dict.fromkeys(instance.photo for instance in annotations.instances)
    return tuple(annotations.photos[number].name for number in wanted if number not in paths)


def _patches_of(annotations: Annotations, wanted: PhotoPatches) -> Patches:
    photo, path = wanted.photo, wanted.path
    size = photo_size(path)
    if size != (photo.width, photo.height):
        raise MismatchError(
            f"{path}: the photo is {size[0]}x{size[1]}, annotated at {photo.width}x{photo.height}: use "
            "the photos that the annotations were made on"
        )
    image = load_image(View(photo.name, np.eye(3), np.eye(4), photo.width, photo.height, path))
    full = [annotations.mask(instance) for instance in wanted.instances]
    large = [mask for mask in full if np.count_nonzero(mask) >= MIN_AREA_PIXELS]
    stacked = np.stack(large) if large else np.empty((0, photo.height, photo.width), bool)
    return Patches(image, cut_masks(stacked, np.ones(len(large), np.float32)))


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


def _progress(path: Path, key: str) -> tuple[int, int]:
    """Return the photos done and rows filled by an earlier run with the same key."""
    document = read_json(path) if path.is_file() else None
    if not isinstance(document, dict) or document.get("key") != key:
        return 0, 0
    return int(document["photos"]), int(document["rows"])
