"""Compute the language features of photos: masks, and an embedding of each mask's crop.

An `embedding.json` beside the features records the settings of the folder and its finished files. Features count as
finished only with an entry there that matches them and their photo.
"""

import os
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np

from ...base.arrays import Embeddings, LevelMaskIds, Pixels
from ...errors import InputError, warn
from ...field.codes import Track, untracked
from ...formats.embedding_record import EmbeddingRecord, Form, open_record, read_record
from ...formats.langsplat import FeatureFolder, stored_features, write_features
from ...formats.photo_files import listed
from ...formats.replacing import claimed_folder
from ...formats.tensors import hash_file
from ...formats.vocabulary import VocabularyEncoder, write_vocabulary
from ...scene.encoders import Encoder, ImageEncoder, identity_json
from ...scene.masks.masks import LEVELS, Masks, Segmenter, kept_masks
from ...scene.masks.selection import mask_maps
from ...scene.photo_masks import load_mask, views_with_something
from ...scene.photos import load_image
from ...scene.views import View, scenes_rendered
from ..models.word_list import broad_list, known_words
from .keeping import embedded_again, kept_identity, kept_maps, level_counts, mask_rows, masks_hash

ALGORITHM = "1"  # version of all rules that shape the files; a new one embeds all photos again
WORD_LIST = "word_list.safetensors"  # beside the features: words that queries are contrasted with
MAX_HEIGHT_PIXELS = 1080
"""Height in pixels that taller photos are scaled down to. Source: LangSplat preprocess.py."""
MAX_PHOTOS_AT_ONCE = 8  # each takes memory

Item = TypeVar("Item")
Result = TypeVar("Result")
Model = TypeVar("Model")


@dataclass(frozen=True)
class EmbeddingReport:
    """Counts of a run of `embed`.

    photos: photos that now have features. reused: those finished in earlier runs. redone: those whose older files were
    replaced. masks: masks by level. crops: crops embedded. empty_masks: masks left out because they had no pixels.
    changes: settings that differ from those of the older files.
    """

    photos: int
    reused: int
    redone: int
    masks: Mapping[str, int]
    crops: int
    empty_masks: int
    changes: tuple[str, ...]


def embed(
    views: Sequence[View],
    output_dir: str | Path,
    segmenter: Segmenter | FeatureFolder,
    encoder: ImageEncoder,
    *,
    max_height: int | None = MAX_HEIGHT_PIXELS,
    overwrite: bool = False,
    form: Form = "compact",
    track: Track = untracked,
) -> EmbeddingReport:
    """Write the language features of every view's photo, each in its own file.

    Photos are segmented as stored, without undistortion, because `register` expects maps on that raster. Pixels that a
    photo's own mask excludes belong to no mask of the features: a mask that lies mostly there is dropped, others lose
    these pixels, and photos that are excluded as a whole get no files.

    Finished photos are not touched: a killed run loses at most the photo it was at. If a setting differs from the
    folder's, all photos are embedded again, and each file is replaced once its successor is complete. Memory holds one
    photo at a time; the built-in models take as many at once as they have threads, up to 8, and a kill loses all those.

    Args:
        views: the views; those without a photo are left out.
        output_dir: folder of the features.
        segmenter: cuts photos into masks. Or features of the same photos, whose masks are kept, with their ids and on
            their raster, for another encoder (`register` with weights of another field).
        encoder: embeds the crops of masks.
        max_height: height in pixels that taller photos are scaled down to; None for no limit.
        overwrite: embed all photos again, even over features of other programs.
        form: "compact" for `<photo>.features.safetensors`, "langsplat" for `<photo>_f.npy` and `<photo>_s.npy`. Files
            finished in the other form are converted, not computed again.
        track: shows the progress.

    Warns: DrSplatWarning: views without a photo, or with one that its mask excludes as a whole; changed settings; files
    left from other settings.
    Raises: InputError: no photo, photos that would share a file, features of another program in the folder, another
    process that embeds into it. FormatError: a damaged photo or embedding.json.
    Source: LangSplat preprocess.py; Dr. Splat Sec. A.

    >>> views = ds.read_views("capture")
    >>> report = ds.embed(views, "capture/mini", ds.load_segmenter("graph"), ds.MiniEncoder())
    >>> report.photos
    4
    """
    if max_height is not None and max_height < 1:
        raise InputError(f"max_height: expected at least 1 pixel, got {max_height}")
    rasters = {stem: _raster(view, max_height) for stem, view in photos_by_stem(views_with_something(views)).items()}
    if isinstance(segmenter, FeatureFolder):
        rasters, max_height = _with_masks(rasters, segmenter), None
    settings = settings_of(segmenter, encoder, max_height) | pictures_setting(views)
    with claimed_folder(output_dir), closing(open_record(Path(output_dir), settings, overwrite)) as record:
        if record.changes:
            changes = "; ".join(record.changes)
            warn(f"{record.folder} was made with other settings, so all photos are embedded again: {changes}", 2)
        photos = {stem: _identity(view, stem, segmenter) for stem, view in rasters.items()}
        pending = [stem for stem, photo in photos.items() if not record.is_finished(stem, photo)]
        redone = sum(record.has_files(stem) for stem in pending)
        for stem in sorted(photos.keys() - pending):
            entry = record.finished[stem]
            if entry.form != form:
                stored = stored_features(record.folder, stem, entry.form)
                _store(record, stem, entry.photo, _Embedded(*stored, entry.masks, entry.empty_masks), form)
        with closing(_all_embedded(rasters, pending, segmenter, encoder)) as embedded:
            for stem, features in zip(track(pending, "embedding photos"), embedded, strict=True):
                _store(record, stem, photos[stem], features, form)
        finish_folder(record, encoder)
    return report_of(record, list(photos), len(pending), redone)


def settings_of(
    segmenter: Segmenter | FeatureFolder, encoder: ImageEncoder, max_height: int | None
) -> dict[str, object]:
    """Return the record's entry on what makes the features of photos."""
    return {
        "segmenter": kept_identity(segmenter) if isinstance(segmenter, FeatureFolder) else dict(segmenter.identity),
        "encoder": identity_json(encoder.identity),
        "max_height": max_height,
        "algorithm": ALGORITHM,
    }


def pictures_setting(views: Sequence[View]) -> dict[str, list[str]]:
    """Return the record's entry on renderings, the scenes they show; {} if all pictures are photos."""
    scenes = scenes_rendered(view.rendered_from for view in views)
    return {"rendered_from": scenes} if scenes else {}


def recorded_renderings(folder: str | Path) -> list[str]:
    """Return the scenes that a folder's pictures were rendered from; none for photos, or if unknown.

    Raises: FormatError: a damaged embedding.json. MismatchError: features of several settings are in it.
    """
    record = read_record(Path(folder))
    scenes = [] if record is None else record.whole().settings.get("rendered_from", [])
    return [str(scene) for scene in scenes] if isinstance(scenes, list) else []


def finish_folder(record: EmbeddingRecord, encoder: ImageEncoder) -> None:
    """Write the words that queries are contrasted with, and warn of files with other settings."""
    if isinstance(encoder, Encoder) and not hasattr(encoder, "nouns"):  # built-in ones can be loaded at any time
        names, vectors = known_words(encoder, broad_list())
        words = VocabularyEncoder(encoder.identity, names, vectors)
        write_vocabulary(record.folder / WORD_LIST, words, overwrite=True)
    leftovers = record.unfinished()
    if leftovers:
        warn(
            f"{record.folder} still has files of {len(leftovers)} photos that are not among these "
            f"views and were made otherwise: remove them, or registering mixes them in: {listed(leftovers)}",
            2,
        )


def report_of(record: EmbeddingRecord, stems: Sequence[str], num_embedded: int, redone: int) -> EmbeddingReport:
    """Return the report of a folder, and warn if no photo has a mask. num_embedded: photos of this run."""
    finished = [record.finished[stem] for stem in stems]
    counts = {level: sum(photo.masks.get(level, 0) for photo in finished) for level in LEVELS}
    masks = {level: count for level, count in counts.items() if count}
    if not masks:
        warn(f"no mask was found in any of {len(stems)} photos: there is nothing to register", 3)
    empty_masks = sum(photo.empty_masks for photo in finished)
    crops = sum(masks.values())
    return EmbeddingReport(len(stems), len(stems) - num_embedded, redone, masks, crops, empty_masks, record.changes)


def photos_by_stem(views: Sequence[View]) -> dict[str, View]:
    """Return the views with a photo, sorted, by the stem of their feature files.

    Raises: InputError: no photo at all; two photos whose names differ only in the suffix.
    """
    by_stem: dict[str, View] = {}
    for view in sorted(views, key=lambda view: view.name):
        if view.image_path is not None:
            stem = PurePosixPath(view.name).with_suffix("").as_posix()
            if stem in by_stem:
                raise InputError(
                    f"'{by_stem[stem].name}' and '{view.name}' would share the features '{stem}': "
                    "rename one of the photos"
                )
            by_stem[stem] = view
    without = [view.name for view in views if view.image_path is None]
    if not by_stem:
        raise InputError(f"none of {len(views)} views has a photo: read them with images=FOLDER")
    if without:
        warn(f"{len(without)} of {len(views)} views have no photo to embed: {listed(without)}", 3)
    return by_stem


def _raster(view: View, max_height: int | None) -> View:
    """Return the view on the raster that is segmented, without distortion: maps lie on the photo as stored."""
    stored = replace(view, distortion=None)
    if max_height is None or view.height <= max_height:
        return stored
    return stored.resized(max(1, view.width * max_height // view.height), max_height)


def _identity(view: View, stem: str, segmenter: Segmenter | FeatureFolder) -> str:
    """Return the hashes of a photo and of its mask, or of the masks that are kept, and the raster it is read at."""
    assert view.image_path is not None
    photo = f"{hash_file(view.image_path)} {view.width}x{view.height}"
    if isinstance(segmenter, FeatureFolder):
        return f"{photo} {masks_hash(segmenter, stem)}"
    if view.mask_path is None:
        return photo
    return f"{photo} {hash_file(view.mask_path)}{' inverted' if view.mask_inverted else ''}"


class _Embedded(NamedTuple):
    """Masks and embeddings of one photo. counts: masks by level. empty: number of masks left out for lack of pixels."""

    mask_ids: LevelMaskIds
    embeddings: Embeddings
    counts: Mapping[str, int]
    empty: int


def _with_masks(rasters: Mapping[str, View], folder: FeatureFolder) -> dict[str, View]:
    """Return the views whose photos have masks in a folder; warn of the others. Raises: InputError: none has."""
    with_masks = {stem: view for stem, view in rasters.items() if stem in folder}
    missing = [stem for stem in rasters if stem not in with_masks]
    if not with_masks:
        raise InputError(f"{folder.directory}: no photo has masks there: photos are named like '{missing[0]}'")
    if missing:
        warn(f"{len(missing)} of {len(rasters)} photos have no masks in {folder.directory}: {listed(missing)}", 3)
    return with_masks


def _all_embedded(
    rasters: Mapping[str, View], stems: Sequence[str], segmenter: Segmenter | FeatureFolder, encoder: ImageEncoder
) -> Generator[_Embedded]:
    """Yield photos' features in order, several at a time where both models are built in."""
    at_once = min(photos_at_once([segmenter, encoder]), max(len(stems), 1))
    if at_once > 1 and isinstance(segmenter, Threaded) and isinstance(encoder, Threaded):
        segmenter, encoder = segmenter.on_one_thread(), encoder.on_one_thread()
    yield from side_by_side(lambda stem: _features(rasters[stem], stem, segmenter, encoder), stems, at_once)


def _features(view: View, stem: str, segmenter: Segmenter | FeatureFolder, encoder: ImageEncoder) -> _Embedded:
    if isinstance(segmenter, FeatureFolder):
        mask_ids, raster = kept_maps(segmenter, view, stem)
        return _Embedded(mask_ids, embedded_again(mask_ids, raster, encoder), level_counts(mask_ids), 0)
    image = load_image(view)
    levels = segmenter.segment(image)
    used = load_mask(view)
    if used is not None:
        levels = kept_masks(levels, used)
    maps = mask_maps(levels)
    empty = sum(not part.any() for masks in levels.values() for part in masks.parts)
    rows = _embeddings(image, maps.masks, encoder, view.name)
    return _Embedded(maps.mask_ids, rows, level_counts(maps.mask_ids, levels), empty)


def finish_photo(
    record: EmbeddingRecord, stem: str, photo: str, mask_ids: LevelMaskIds, rows: Embeddings, form: Form
) -> None:
    """Write the features of a photo, and record them; of equal levels the masks count once.

    photo: hash of everything that decides them.
    """
    counted = mask_ids[-1] if mask_ids.ndim == 3 and (mask_ids == mask_ids[-1]).all() else mask_ids
    _store(record, stem, photo, _Embedded(mask_ids, rows, level_counts(counted), 0), form)


def _store(record: EmbeddingRecord, stem: str, photo: str, features: _Embedded, form: Form) -> None:
    record.make_room(stem)
    write_features(record.folder, stem, features.mask_ids, features.embeddings, overwrite=True, form=form)
    record.add(stem, photo, features.counts, features.empty, form)


def _embeddings(image: Pixels, masks: Masks, encoder: ImageEncoder, name: str) -> Embeddings:
    dim = encoder.identity.dim
    if len(masks) == 0:
        return np.zeros((0, dim), np.float32)
    rows = mask_rows(image, masks, encoder)
    if rows.shape != (len(masks), dim) or not np.allclose(np.linalg.norm(rows, axis=1), 1, 0, 1e-3):
        raise InputError(
            f"{name}: the encoder {encoder.identity.name} gave {rows.shape} for {len(masks)} masks: "
            f"expected as many finite unit vectors of {dim} numbers"
        )
    return rows


@runtime_checkable
class Threaded(Protocol):
    """Model with the same answers on any number of threads: on `threads` of its own, 0 for all cores, or on one."""

    threads: int

    def on_one_thread(self: Model) -> Model:
        """Return the same model on one thread, for several threads to call at once."""
        ...


def photos_at_once(models: Iterable[object]) -> int:
    """Return the number of photos to process at the same time: 1 unless all models are `Threaded`."""
    threads = [model.threads or os.cpu_count() or 1 if isinstance(model, Threaded) else 1 for model in models]
    return min(MAX_PHOTOS_AT_ONCE, *threads)


def side_by_side(work: Callable[[Item], Result], items: Iterable[Item], at_once: int) -> Iterator[Result]:
    """Yield the result of each item, in order; at most `at_once` are started and not yet taken."""
    if at_once == 1:
        yield from map(work, items)
        return
    with ThreadPoolExecutor(at_once) as pool:
        started: deque[Future[Result]] = deque()
        for item in items:
            started.append(pool.submit(work, item))
            if len(started) == at_once:
                yield started.popleft().result()
        while started:
            yield started.popleft().result()
