"""Captures of a folder of photos or a video: posed photos in COLMAP's layout, in an upright world.

Another scale for an existing capture: its poses stay, and no features are computed.
"""

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path, PurePosixPath
from typing import Any

from ...errors import InputError
from ...formats.captures import read_sparse_points, read_views
from ...formats.colmap import read_colmap
from ...formats.georeference import write_georeference
from ...formats.json_files import read_json, write_json
from ...formats.mask_files import FOLDER as MASKS
from ...formats.mask_files import SUFFIX as MASK_SUFFIX
from ...formats.photo_files import listed
from ...formats.replacing import claimed_folder
from ..models.people import without_people
from .finding import Source, find_photos
from .measuring import units_between
from .photos import ExifFacts, Photo, bring
from .posing import Model, Posed, Posing, Progress
from .program import ask_colmap, require_colmap
from .settings import KNOWN_DISTANCE, SCALE, UNDISTORTED, CaptureSettings
from .turning import WALK_ROUND, Reasons
from .videos import is_video, take_frames, video_source
from .work import FORMAT, MODEL, RECORD, VERSION, Work, is_ready, publish, refuse_overlap, refuse_strangers
from .world import World, with_scale, world_of

MIN_PHOTOS = 3


def capture(
    photos: str | Path,
    output: str | Path,
    settings: CaptureSettings | None = None,
    *,
    overwrite: bool = False,
    threads: int = 0,
    progress: Progress = lambda stage, done, total: None,
) -> dict[str, Any]:
    """Find where photos were taken, write the capture as a folder, and return its record (capture.json).

    Photos are only read. A stopped run continues when it is called again. The random seed of COLMAP is fixed.

    Args:
        photos: folder of JPEG, PNG, HEIC, WebP, TIFF or BMP files, also in folders below it; or a video.
        output: folder to write: images/, sparse/0, capture.json and, where photos have GPS, georeference.json.
        overwrite: replace an existing capture, which stays until the new one is complete. Where only `scale` or
            `known_distance` differ from before, poses stay, and only lengths are made anew.
        threads: of COLMAP, 0 for all cores.
        settings: lens, scale and masks; None: the defaults.
        progress: called with each stage.

    Raises:
        InputError: no photos, too few that overlap, a camera that only turned, an output in the way, a full disk.
        MissingExtraError: pycolmap is not installed, or pi-heif for HEIC photos.

    Warns:
        DrSplatWarning: the camera may only have turned.
    """
    require_colmap()
    source, target, settings = Path(photos), Path(output), settings or CaptureSettings()
    refuse_overlap(source, target)
    with claimed_folder(target):
        refuse_strangers(target, overwrite)
        unchanged_parts: tuple[str, ...] = ()
        if not is_ready(target):
            sources = [video_source(source)] if is_video(source) else find_photos(source)
            if differs_in_scale(sources, target, settings):
                rescale(sources, target, settings)
                unchanged_parts = STAYING
            else:
                _make(sources, target, settings, threads, progress)
        publish(target, unchanged_parts)
    return json.loads((target / RECORD).read_text(encoding="utf-8"))


def _make(sources: Sequence[Source], output: Path, settings: CaptureSettings, threads: int, progress: Progress) -> None:
    """Make all parts of the capture where `publish` expects them."""
    work, film = Work(output), None
    key = sources_key(sources)
    if is_video(sources[0].path):
        film = take_frames(sources[0], work, progress)
        sources = find_photos(work.frames)
    photos = _bring_all(sources, work, progress, settings.invert_masks)
    taken = list({photo.file: photo for photo in reversed(photos) if photo.fault is None}.values())[::-1]
    if len(taken) < MIN_PHOTOS:
        raise InputError(_too_few(photos, len(taken)))
    posed = Posing(work, taken, settings.lens, threads, progress).run()
    if not posed.models:
        raise InputError(_nothing_fits(taken, posed))
    progress("world", 0, 1)
    model = posed.models[0]
    registered = set(model.files)
    by_file = {photo.file: photo for photo in taken if photo.file in registered}
    names = capture_names(list(by_file.values()))
    world = _placed(model, by_file, names, work, settings)
    photos_folder, masks_folder = work.photos, work.masks
    if settings.lens in UNDISTORTED:
        photos_folder, masks_folder = work.undistorted / "images", work.undistorted / "masks"
    for file, name in names.items():
        photo, mask = work.new / "images" / name, work.new / MASKS / (name + MASK_SUFFIX)
        for old, new in ((photos_folder / file, photo), (masks_folder / (file + MASK_SUFFIX), mask)):
            if old.exists():  # else there is none, or an earlier run has moved it
                new.parent.mkdir(parents=True, exist_ok=True)
                old.replace(new)
    if world.georeference is not None:
        write_georeference(work.new, world.georeference)
    with_people = None
    if not settings.keep_people and all(source.mask is None for source in sources):
        with_people = _leave_people_out(work, threads, progress)
    record = _record(photos, posed, world, settings)
    record |= {"sources": key, "video": film, "num_with_people": with_people}
    write_json(work.new / RECORD, record, overwrite=True, end="")


def _leave_people_out(work: Work, threads: int, progress: Progress) -> int:
    """Write the masks of photos with people; return how many they are."""

    def tracked(items: Sequence[Any], _: str) -> Iterator[Any]:
        for done, item in enumerate(items, 1):
            yield item
            progress("people", done, len(items))

    views, points = read_views(work.new), read_sparse_points(work.new)
    found = without_people(views, points, work.new / MASKS, track=tracked, threads=threads)
    return sum(view.mask_path is not None for view in found)


def _bring_all(sources: Sequence[Source], work: Work, progress: Progress, invert_masks: bool = False) -> list[Photo]:
    """Return all photos, copied into the work folder; those copied by an earlier run are not read again."""
    brought = _records(work.record)
    photos = []
    with work.record.open("a", encoding="utf-8") as record:
        for done, source in enumerate(sources, 1):
            key = f"{source.name} {source.num_bytes} {source.changed_ns} {source.mask is not None and invert_masks}"
            photo = brought.get(key)
            if photo is None or (photo.fault is None and not (work.photos / photo.file).is_file()):
                photo = bring(source, work.photos, invert_masks)
                record.write(json.dumps([key, asdict(photo)]) + "\n")
                record.flush()
            photos.append(photo)
            progress("photos", done, len(sources))
    return photos


def _records(path: Path) -> dict[str, Photo]:
    """Return the photos that an earlier run has copied; a line that was cut off is skipped."""
    photos: dict[str, Photo] = {}
    for line in path.read_text(encoding="utf-8").splitlines() if path.is_file() else []:
        try:
            key, document = json.loads(line)
        except ValueError:  # the last one, cut off
            continue
        exif: dict[str, Any] = document.pop("exif")
        for name, part in exif.items():
            exif[name] = tuple(part) if isinstance(part, list) else part
        photos[key] = Photo(**document, exif=ExifFacts(**exif))
    return photos


def _too_few(photos: Sequence[Photo], num_taken: int) -> str:
    faults = [f"{photo.name} ({photo.fault})" for photo in photos if photo.fault is not None]
    twins = len(photos) - num_taken - len(faults)
    why = f"; {len(faults)} cannot be used: {listed(faults, 3)}" if faults else ""
    why += f"; {twins} are copies of others" if twins else ""
    return (
        f"expected at least {MIN_PHOTOS} different photos, got {num_taken} of {len(photos)}{why}. Take 20 or "
        "more from different places, each a step to the side"
    )


def capture_names(photos: Sequence[Photo]) -> dict[str, str]:
    """Return the name in the capture of each photo's file: its own name, with the suffix of its new format.

    Features are looked up by names without suffix, so where two photos differ only in it, it becomes part of the name.
    """
    names: dict[str, str] = {}
    stems: set[str] = set()
    for photo in photos:
        path = PurePosixPath(photo.name)
        old_suffix, suffix = path.suffix[1:], PurePosixPath(photo.file).suffix
        same_kind = {"jpeg": "jpg"}.get(old_suffix.lower(), old_suffix.lower()) == suffix[1:]
        stem = str(path.with_suffix(""))
        while stem.lower() in stems:
            stem += f"_{old_suffix}"
        stems.add(stem.lower())
        names[photo.file] = stem + (path.suffix if same_kind else suffix)
    return names


def _placed(
    model: Model, photos: dict[str, Photo], names: dict[str, str], work: Work, settings: CaptureSettings
) -> World:
    """Write the model in the capture's world, and return the world."""
    folder = model.folder
    if settings.lens in UNDISTORTED:
        ask_colmap(
            "undistort", work.log, model=str(folder), images=str(work.photos), output=str(work.undistorted), threads=-1
        )
        masks = work.undistorted / "masks"
        masks.mkdir(parents=True, exist_ok=True)
        ask_colmap("undistort_masks", work.log, model=str(folder), masks=str(work.masks), output=str(masks))
        folder = work.undistorted / MODEL
    views = read_colmap(folder)
    facts = {file: photo.exif for file, photo in photos.items()}
    world = world_of(views, facts, model.depth)
    if settings.scale is not None:
        world = with_scale(world, settings.scale, SCALE)
    elif settings.known_distance is not None:
        by_name = {photo.name: photo.file for photo in photos.values()}
        units = world.similarity.scale * units_between(settings.known_distance, model.folder, work.log, by_name)
        world = with_scale(world, settings.known_distance.metres / units, KNOWN_DISTANCE)
    similarity = world.similarity
    ask_colmap(
        "place", work.log, model=str(folder), output=str(work.new / MODEL / "0"), names=names,
        scale=similarity.scale, rotation=similarity.rotation.tolist(), translation=similarity.translation.tolist(),
    )  # fmt: skip
    return world


def _nothing_fits(photos: Sequence[Photo], posed: Posed) -> str:
    """Return why there is no model, with the worst photos."""
    why = Reasons(photos, posed.features, posed.pairs, [])
    reasons = [f"{photo.name} ({why.of(photo)})" for photo in photos]
    fitting = f"no {MIN_PHOTOS} of {len(photos)} photos fit together" if posed.pairs else "no two photos overlap"
    return f"{fitting}: {listed(reasons, 3)}. {WALK_ROUND}"


def _record(photos: Sequence[Photo], posed: Posed, world: World, settings: CaptureSettings) -> dict[str, Any]:
    """Return the record, capture.json."""
    model = posed.models[0]
    first = {photo.file: photo for photo in reversed(photos) if photo.fault is None}
    registered = set(model.files)
    out = [photo for photo in photos if photo.file not in registered or first[photo.file] is not photo]
    why = Reasons(photos, posed.features, posed.pairs, [each.files for each in posed.models])
    return {
        "format": FORMAT,
        "version": VERSION,
        "num_photos": len(photos),
        "num_registered": len(model.files),
        "num_points": model.num_points,
        "reprojection_error_px": model.error_px,
        "mapper": model.mapper,
        "unit": world.unit,
        "scale_from": world.scale_from,
        "up": "+z" if world.up_from else None,
        "up_from": world.up_from,
        "georeferenced": world.georeference is not None,
        "gps_residual_m": world.residual_m,
        "left_out": [{"name": photo.name, "reason": why.of(photo)} for photo in out],
        "scale_factor": world.scale_factor,
        "settings": asdict(settings),
        "made_by": {name: version(name) for name in ("drsplat", "pycolmap")},
    }


STAYING = ("images", "masks", "georeference.json")
_OF_LENGTHS = ("scale", "known_distance")


def sources_key(sources: Sequence[Source]) -> str:
    """Return a text that changes with the photos, by their names, sizes and times."""
    photos = [(source.name, source.num_bytes, source.changed_ns) for source in sources]
    return hashlib.blake2b(json.dumps(photos).encode(), digest_size=16).hexdigest()


def differs_in_scale(sources: Sequence[Source], output: Path, settings: CaptureSettings) -> bool:
    """Return whether the output is of the same photos and settings, except for a new scale or known distance."""
    if not ((output / RECORD).is_file() and (output / MODEL / "0").is_dir()):
        return False
    record = read_json(output / RECORD)
    before = record.get("settings") if isinstance(record, dict) and record.get("sources") == sources_key(sources) else 0
    if not isinstance(before, dict):
        return False
    now: dict[str, Any] = json.loads(json.dumps(asdict(settings)))
    rest = [{key: value for key, value in each.items() if key not in _OF_LENGTHS} for each in (before, now)]
    return rest[0] == rest[1] and any(now[key] not in (None, before.get(key)) for key in _OF_LENGTHS)


def rescale(sources: Sequence[Source], output: Path, settings: CaptureSettings) -> None:
    """Write a capture's model and record at another scale, where `work.publish` expects them."""
    work = Work(output)
    model = output / MODEL / "0"
    record: dict[str, Any] = json.loads((output / RECORD).read_text(encoding="utf-8"))
    if settings.known_distance is None:
        factor = (settings.scale or 1.0) / record["scale_factor"]
    else:
        # names in the capture by the same name and by the photo's name before it got another suffix
        names = {view.name: view.name for view in read_colmap(model)}
        by_stem = {PurePosixPath(name).with_suffix(""): name for name in names}
        before = {source.name: by_stem.get(PurePosixPath(source.name).with_suffix("")) for source in sources}
        names = {name: posed for name, posed in before.items() if posed} | names
        factor = settings.known_distance.metres / units_between(settings.known_distance, model, work.log, names)
    ask_colmap("place", work.log, model=str(model), output=str(work.new / MODEL / "0"), scale=factor)
    record |= {
        "unit": "m",
        "scale_from": SCALE if settings.known_distance is None else KNOWN_DISTANCE,
        "scale_factor": record["scale_factor"] * factor,
        "settings": asdict(settings),
    }
    write_json(work.new / RECORD, record, overwrite=True, end="")
