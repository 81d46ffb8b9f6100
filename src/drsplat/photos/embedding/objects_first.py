"""Language features of photos of a known scene: masks, W, objects, then a few crops of each object.

The masks and the vectors of the chosen crops are folders of features of their own, so each photo is kept once finished.
"""

import hashlib
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...base.arrays import Float32
from ...errors import InputError
from ...field.codes import Track, untracked
from ...field.evidence.evidence import Evidence
from ...field.registration import register
from ...formats.claiming import claimed_folder
from ...formats.embedding_record import finished_photos, open_record
from ...formats.feature_files import Form
from ...formats.langsplat import FeatureFolder, read_features
from ...scene.encoders import ImageEncoder, identity_json
from ...scene.gaussians import Gaussians
from ...scene.masks.masks import Segmenter
from ...scene.views import View
from .embed import MAX_HEIGHT_PIXELS, EmbeddingReport, embed, finish_folder, finish_photo, pictures_setting, report_of
from .keeping import ChosenMasks, WithoutEmbedding, masks_hash
from .shared_crops import MAX_CROPS_PER_OBJECT, MIN_FIT, NEAREST_SHARE, share_crops

ALGORITHM = "1"
"""Version of everything here that decides what is written."""
MASKS, WEIGHTS, CROPS = "masks", "weights", "crops"


def embed_objects(
    views: Sequence[View],
    output_dir: str | Path,
    segmenter: Segmenter,
    encoder: ImageEncoder,
    gaussians: Gaussians,
    *,
    parts: str | Path,
    max_height: int | None = MAX_HEIGHT_PIXELS,
    overwrite: bool = False,
    form: Form = "compact",
    threads: int = 0,
    track: Track = untracked,
) -> EmbeddingReport:
    """Write the features of every view as `embed` does, but embed only a few crops of each object of the scene.

    A mask that shows a part, thing or group of the scene takes the vectors of up to MAX_CROPS_PER_OBJECT of its masks,
    half of it that of the nearest camera. A mask that shows none is embedded itself.

    Args:
        views: with photos.
        output_dir: folder for the features.
        segmenter: one that gives masks of one level, `large`.
        encoder: makes the vectors of crops.
        gaussians: the scene, which stands still.
        parts: folder for masks, weights and crops, which later runs go on from.
        max_height: see `embed`.
        overwrite: see `embed`.
        form: see `embed`.
        track: see `embed`.
        threads: 0 for all cores; the result does not depend on it.

    Raises:
        InputError: as `embed`; masks of several levels.
    """
    parts = Path(parts)
    embed(
        views, parts / MASKS, segmenter, WithoutEmbedding(), max_height=max_height, overwrite=overwrite, track=track
    )  # fmt: skip
    masks = read_features(parts / MASKS)
    _check_level(masks)
    by_stem = {stem: view for view in views if (stem := masks.key(view.name)) is not None}
    settings = {
        "segmenter": dict(segmenter.identity),
        "encoder": identity_json(encoder.identity),
        "max_height": max_height,
        "algorithm": ALGORITHM,
        "crops": [MAX_CROPS_PER_OBJECT, MIN_FIT, NEAREST_SHARE],
        "scene": gaussians.fingerprint,
        **pictures_setting(views),
    }
    digest = _digest(masks, by_stem)
    with claimed_folder(output_dir), closing(open_record(Path(output_dir), settings, overwrite)) as record:
        pending = [stem for stem in by_stem if not record.is_finished(stem, digest)]
        redone = sum(record.has_files(stem) for stem in pending)
        if pending:
            rows = _vectors(
                by_stem, masks, encoder, gaussians, parts, overwrite=overwrite, threads=threads, track=track
            )
            for stem in pending:
                finish_photo(record, stem, digest, masks.stored(stem)[0], rows[stem], form)
        finish_folder(record, encoder)
    crops = sum(photo.masks.get("large", 0) for photo in finished_photos(parts / CROPS).values())
    return replace(report_of(record, list(by_stem), len(pending), redone), crops=crops)


def _check_level(masks: FeatureFolder) -> None:
    """Check the masks. Raises: InputError: several levels, of which only one is registered."""
    for name in masks:
        mask_ids = masks.stored(name)[0]
        if mask_ids.ndim == 3 and (mask_ids != mask_ids[-1]).any():
            raise InputError(
                "crops of objects are of one level of masks, and these have four: take a segmenter that gives the "
                "large ones alone, or embed each mask"
            )


def _digest(masks: FeatureFolder, by_stem: Mapping[str, View]) -> str:
    """Return a hash of all masks and cameras: what any photo's vectors depend on."""
    digest = hashlib.blake2b(digest_size=16)
    for stem, view in sorted(by_stem.items()):
        digest.update(f"{stem} {masks_hash(masks, stem)} ".encode())
        digest.update(view.K.tobytes() + view.cam_from_world.tobytes())
    return digest.hexdigest()


def _vectors(
    by_stem: Mapping[str, View],
    masks: FeatureFolder,
    encoder: ImageEncoder,
    gaussians: Gaussians,
    parts: Path,
    *,
    overwrite: bool,
    threads: int,
    track: Track,
) -> dict[str, Float32[np.ndarray, "n d"]]:
    """Return a vector for each mask of each photo."""
    views = list(by_stem.values())
    evidence = register(gaussians, views, masks, parts=parts / WEIGHTS, threads=threads, track=track).evidence
    shared = share_crops(evidence, gaussians, views, threads=threads)
    columns = _columns_by_stem(evidence, masks)
    is_chosen = np.zeros(len(evidence.masks), np.bool_)
    is_chosen[shared.chosen] = True
    chosen = {stem: evidence.masks.ids[numbers[is_chosen[numbers]]] for stem, numbers in columns.items()}
    embed(
        views, parts / CROPS, ChosenMasks(masks.directory, chosen), encoder, max_height=None, overwrite=overwrite,
        track=track,
    )  # fmt: skip
    crops = read_features(parts / CROPS)
    crop_rows = np.zeros((len(is_chosen), encoder.identity.dim), np.float32)
    for stem, numbers in columns.items():
        own = numbers[is_chosen[numbers]]
        crop_rows[own] = crops.stored(stem)[1][evidence.masks.ids[own]]
    rows = shared.embeddings(crop_rows[shared.chosen])
    return {stem: rows[numbers] for stem, numbers in columns.items()}


def _columns_by_stem(evidence: Evidence, masks: FeatureFolder) -> dict[str, np.ndarray]:
    """Return the columns of each photo, in the order of its mask ids."""
    keys = [str(masks.key(name)) for name in evidence.masks.view_names]
    return {key: np.flatnonzero(evidence.masks.views == number) for number, key in enumerate(keys)}
