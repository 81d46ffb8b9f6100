"""Masks of an existing folder of features: another encoder embeds them, and their ids stay."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from scipy.ndimage import find_objects

from ...base.arrays import Embeddings, Float32, LevelMaskIds, OtherPixels, Pixels, WholeNumbers
from ...errors import MismatchError
from ...formats.langsplat import FeatureFolder
from ...formats.tensors import hash_file
from ...scene.encoders import EncoderIdentity, ImageEncoder
from ...scene.masks.crops import crops
from ...scene.masks.masks import LEVELS, Masks
from ...scene.photos import load_image
from ...scene.views import View, same_aspect


class WithoutEmbedding:
    """Encoder that gives every mask the vector (1): enough to make W."""

    identity = EncoderIdentity("none", 1)
    threads = 0

    def on_one_thread(self) -> "WithoutEmbedding":
        """Return the same encoder: any number of threads may ask it."""
        return self

    def encode_images(self, images: Sequence[OtherPixels]) -> Float32[np.ndarray, "n 1"]:
        return np.ones((len(images), 1), np.float32)


class ChosenMasks(FeatureFolder):
    """Masks of a folder without those whose crops are not embedded. chosen: mask ids by photo."""

    def __init__(self, directory: Path, chosen: Mapping[str, WholeNumbers]) -> None:
        super().__init__(directory, LEVELS.index("large"))
        self.chosen = chosen

    def stored(self, name: str) -> tuple[LevelMaskIds, Embeddings]:
        """Return the maps of a photo, -1 where a mask is left out, and its vectors."""
        mask_ids, embeddings = super().stored(name)
        is_chosen = np.zeros(len(embeddings) + 1, np.bool_)  # the last is that of -1
        is_chosen[self.chosen[name]] = True
        return np.where(is_chosen[mask_ids], mask_ids, np.int32(-1)), embeddings


def kept_identity(folder: FeatureFolder) -> dict[str, object]:
    """Return the segmenter of a folder's masks, as `embed` records it."""
    return {"kept": None if folder.record is None else folder.record.whole().settings.get("segmenter")}


def masks_hash(folder: FeatureFolder, stem: str) -> str:
    """Return a hash of the file that holds a photo's masks, and of which of them are chosen."""
    digest = hash_file(folder.files(stem)[0])
    if isinstance(folder, ChosenMasks):
        return f"{digest} {','.join(map(str, folder.chosen[stem].tolist()))}"
    return digest


def kept_maps(folder: FeatureFolder, view: View, stem: str) -> tuple[LevelMaskIds, View]:
    """Return a photo's stored maps, and the view on their raster. Raises: MismatchError: another shape."""
    mask_ids = folder.stored(stem)[0]
    height, width = mask_ids.shape[-2:]
    if not same_aspect((width, height), view.size):
        raise MismatchError(
            f"the masks of '{view.name}' are {width}x{height}, its photo {view.width}x{view.height}: another aspect "
            "ratio, so they are of another photo"
        )
    return mask_ids, view.resized(width, height)


def embedded_again(mask_ids: LevelMaskIds, view: View, encoder: ImageEncoder) -> Embeddings:
    """Embed existing masks: one row per mask id, zero where a mask has no pixel, which nothing reads."""
    levels = mask_ids if mask_ids.ndim == 3 else mask_ids[None]
    # each mask is cut out of the largest level that has it: what is below has parts of it
    cutouts: dict[int, tuple[tuple[int, ...], np.ndarray]] = {}
    for ids in levels[::-1]:
        for number, place in enumerate(find_objects(ids + 1)):
            if place is not None and number not in cutouts:
                y, x = place
                cutouts[number] = ((x.start, y.start, x.stop, y.stop), ids[place] == number)
    embeddings = np.zeros((int(mask_ids.max(initial=-1)) + 1, encoder.identity.dim), np.float32)
    if cutouts:
        rows = sorted(cutouts)
        boxes, parts = zip(*(cutouts[row] for row in rows), strict=True)
        _, height, width = levels.shape
        masks = Masks(height, width, np.array(boxes, np.int32), parts, np.ones(len(rows), np.float32))
        embeddings[rows] = mask_rows(load_image(view), masks, encoder)
    return embeddings


def level_counts(mask_ids: LevelMaskIds, levels: Collection[str] = LEVELS) -> dict[str, int]:
    """Count the masks of these levels; a map without levels is `large`."""
    if mask_ids.ndim == 2:
        return {LEVELS[-1]: len(np.unique(mask_ids[mask_ids >= 0]))}
    wanted = [(level, ids) for level, ids in zip(LEVELS, mask_ids, strict=True) if level in levels]
    return {level: len(np.unique(ids[ids >= 0])) for level, ids in wanted}


@runtime_checkable
class MaskEncoder(Protocol):
    """Encoder that embeds masks from one pass over the image, without crops of them."""

    def encode_masks(self, image: Pixels, masks: Masks) -> Embeddings: ...


def mask_rows(image: Pixels, masks: Masks, encoder: ImageEncoder) -> Embeddings:
    """Return unit vectors of the masks of an image, each with a pixel or more, in their order."""
    if isinstance(encoder, MaskEncoder):
        return encoder.encode_masks(image, masks)
    return encoder.encode_images(crops(image, masks))
