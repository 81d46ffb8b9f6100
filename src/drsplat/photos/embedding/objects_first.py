"""Language features of photos of a known scene: masks, W, objects, then a few crops of each object.

The masks and the vectors of the chosen crops are folders of features of their own, so each photo is kept once finished.

W needs masks and no embeddings, and objects need W alone. So masks of many photos that show the same part, thing or
group need not be embedded one by one: a few of each object represent the others.
"""

import hashlib
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array

from ...base.arrays import DoubleRows, Doubles, Embeddings, Indices, Int64, OtherEmbeddings, OtherIndices, Points
from ...errors import InputError
from ...field.codes import Track, untracked
from ...field.evidence.aggregation.entries import entry_rows
from ...field.evidence.evidence import Evidence
from ...field.objects.describing import node_weights, shown_in_photos
from ...field.objects.finding import find_tree
from ...field.registration import register
from ...formats.embedding_record import Form, open_record, read_record
from ...formats.langsplat import FeatureFolder, read_features
from ...formats.replacing import claimed_folder
from ...scene.encoders import ImageEncoder, identity_json
from ...scene.gaussians import Gaussians
from ...scene.masks.masks import Segmenter
from ...scene.views import View
from .embed import MAX_HEIGHT_PIXELS, EmbeddingReport, embed, finish_folder, finish_photo, pictures_setting, report_of
from .keeping import ChosenMasks, WithoutEmbedding, kept_identity, masks_hash

ALGORITHM = "1"
"""Version of everything here that decides what is written."""
MASKS, WEIGHTS, CROPS = "masks", "weights", "crops"
MAX_CROPS_PER_OBJECT = 12
MIN_FIT = 0.5
"""IoU, by weight, above which a mask shows a node; of disjoint nodes at most one has more."""
NEAREST_SHARE = 0.5
"""Weight of the crop whose camera is nearest; all crops of the node share the rest."""


def embed_objects(
    views: Sequence[View],
    output_dir: str | Path,
    segmenter: Segmenter | FeatureFolder,
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
        segmenter: one that gives masks of one level, `large`; or features of the same photos, whose masks are kept.
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
    for name in masks:
        mask_ids = masks.stored(name)[0]
        if mask_ids.ndim == 3 and (mask_ids != mask_ids[-1]).any():
            raise InputError(
                "crops of objects are of one level of masks, and these have four: take a segmenter that gives the "
                "large ones alone, or embed each mask"
            )
    by_stem = {stem: view for view in views if (stem := masks.key(view.name)) is not None}
    settings = {
        "segmenter": kept_identity(masks)["kept"],
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
    finished = read_record(parts / CROPS)
    crops = sum(photo.masks.get("large", 0) for photo in finished.finished.values()) if finished else 0
    return replace(report_of(record, list(by_stem), len(pending), redone), crops=crops)


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
) -> dict[str, Embeddings]:
    """Return a vector for each mask of each photo."""
    views = list(by_stem.values())
    evidence = register(gaussians, views, masks, parts=parts / WEIGHTS, threads=threads, track=track).evidence
    shared = share_crops(evidence, gaussians, views, threads=threads)
    columns = {
        str(masks.key(name)): np.flatnonzero(evidence.masks.views == number)
        for number, name in enumerate(evidence.masks.view_names)
    }
    ids = {stem: masks[stem].file_rows[evidence.masks.ids[numbers]] for stem, numbers in columns.items()}
    is_chosen = np.zeros(len(evidence.masks), np.bool_)
    is_chosen[shared.chosen] = True
    chosen = {stem: ids[stem][is_chosen[numbers]] for stem, numbers in columns.items()}
    embed(
        views, parts / CROPS, ChosenMasks(masks.directory, chosen), encoder, max_height=None, overwrite=overwrite,
        track=track,
    )  # fmt: skip
    crops = read_features(parts / CROPS)
    crop_rows = np.zeros((len(is_chosen), encoder.identity.dim), np.float32)
    for stem, numbers in columns.items():
        crop_rows[numbers[is_chosen[numbers]]] = crops.stored(stem)[1][chosen[stem]]
    rows = shared.embeddings(crop_rows[shared.chosen])
    vectors = {stem: np.zeros((len(masks.stored(stem)[1]), rows.shape[1]), np.float32) for stem in columns}
    for stem, numbers in columns.items():
        vectors[stem][ids[stem]] = rows[numbers]
    return vectors


@dataclass(frozen=True, eq=False)
class SharedCrops:
    """Columns of W whose crops are embedded, and their shares in all columns.

    Attributes:
        chosen: columns that are embedded, ascending.
        shares: (M, C) weights of the chosen columns for each column; each row sums to 1.
    """

    chosen: Indices
    shares: csr_array

    def embeddings(self, rows: Embeddings) -> OtherEmbeddings:
        """Return a unit vector for each column from the vectors of the chosen ones."""
        mixed = self.shares @ rows.astype(np.float64)
        return np.asarray(mixed / np.linalg.norm(mixed, axis=1, keepdims=True), np.float32)


def share_crops(
    evidence: Evidence,
    gaussians: Gaussians,
    views: Sequence[View],
    *,
    most: int = MAX_CROPS_PER_OBJECT,
    threads: int = 0,
) -> SharedCrops:
    """Choose the crops to embed. A mask that shows no object represents itself alone.

    Args:
        evidence: W, a row for each Gaussian. Its embeddings are not looked at if all are equal.
        gaussians: the scene.
        views: the cameras of all photos in the evidence.
        most: crops of a node.
        threads: 0 for all cores; the result does not depend on it.
    """
    ids = np.flatnonzero(np.diff(evidence.weights.indptr))
    with_weight = evidence.rows(ids)
    tree = find_tree(with_weight, gaussians, ids.astype(np.uint32), views, threads=threads)
    fits = node_fits(node_weights(with_weight, tree), with_weight)
    # the node that each mask fits best, -1 where none by more than MIN_FIT
    nodes = entry_rows(fits)
    order = np.lexsort((nodes, -fits.data, fits.indices))
    masks_with_fit, first = np.unique(fits.indices[order], return_index=True)
    node_of, fit = np.full(fits.shape[1], -1), np.zeros(fits.shape[1])
    node_of[masks_with_fit], fit[masks_with_fit] = nodes[order[first]], fits.data[order[first]]
    node_of[fit <= MIN_FIT] = -1
    worth, by_name = fit * _column_sums(with_weight), {view.name: view.center for view in views}
    centers = np.array([by_name[name] for name in evidence.masks.view_names]).reshape(-1, 3)[evidence.masks.views]
    (alone,) = np.nonzero(node_of < 0)
    rows, columns, data = [alone], [alone], [np.ones(len(alone))]
    for masks in _groups(node_of):
        picks, distances = _spread(worth[masks], centers[masks], most)
        shares = np.full(distances.shape, (1 - NEAREST_SHARE) / len(picks))
        shares[np.arange(len(masks)), distances.argmin(1)] += NEAREST_SHARE
        rows.append(np.repeat(masks, len(picks)))
        columns.append(np.tile(masks[picks], len(masks)))
        data.append(shares.ravel())
    chosen, numbers = np.unique(np.concatenate(columns), return_inverse=True)
    places = np.concatenate(rows), numbers
    return SharedCrops(chosen, csr_array((np.concatenate(data), places), shape=(len(node_of), len(chosen))))


def node_fits(inside: csr_array, evidence: Evidence) -> csr_array:
    """Return the IoU of each node with each mask, by weight in the mask's photo, (T, M).

    Args:
        inside: (T, M) weight of each node in each mask.
        evidence: W of the same columns.
    """
    nodes = entry_rows(inside)
    in_photos = shown_in_photos(inside, evidence.masks.views)[nodes, evidence.masks.views[inside.indices]]
    either = in_photos + _column_sums(evidence)[inside.indices] - inside.data
    return csr_array((inside.data / np.maximum(either, 1e-12), inside.indices, inside.indptr), shape=inside.shape)


def _column_sums(evidence: Evidence) -> Doubles:
    weights = evidence.weights
    return np.bincount(weights.indices, weights.data, weights.shape[1])


def _groups(node_of: OtherIndices) -> list[Indices]:
    """Return the masks of each node that has any, ascending."""
    order = np.argsort(node_of, kind="stable")
    order = order[np.searchsorted(node_of[order], 0) :]
    return np.split(order, np.flatnonzero(np.diff(node_of[order])) + 1) if len(order) else []


def _spread(worth: Doubles, centers: Points, most: int) -> tuple[Int64[np.ndarray, " k"], DoubleRows]:
    """Pick the mask of most worth, then masks of high worth whose cameras are far from all picked before.

    Returns:
        The picks, and the distance of each mask's camera from theirs.
    """
    picks: list[int] = []
    distances: list[Doubles] = []
    gain = worth
    while len(picks) < min(most, len(worth)) and gain.max() > 0:  # 0: the rest are of picked cameras
        picks.append(int(gain.argmax()))
        distances.append(np.linalg.norm(centers - centers[picks[-1]], axis=1))
        gain = np.sqrt(worth) * np.min(distances, axis=0)
    return np.array(picks), np.stack(distances, 1)
