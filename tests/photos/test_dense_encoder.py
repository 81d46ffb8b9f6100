"""Masks embedded by the patches that they cover, on a tiny TIPSv2, against the model called by hand."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose
from PIL import Image

from drsplat.errors import FormatError
from drsplat.photos.embedding.keeping import MaskEncoder, mask_rows
from drsplat.photos.models.dense_encoder import coverage
from drsplat.photos.models.loading import load_encoder
from drsplat.scene.masks.crops import crops
from drsplat.scene.masks.masks import Masks, cut_masks
from tiny_encoders import PATCH, SIDE, write_model

ALONG = SIDE // PATCH
PHOTO = default_rng(0).integers(0, 256, (24, 40, 3), np.uint8)
TEXTS = ["a red mug", "the table", "mug"]


def some_masks(height: int = 24, width: int = 40, seed: int = 1) -> Masks:
    """All of the image, a part of it, a single pixel, and any pixels."""
    full = np.zeros((4, height, width), bool)
    full[0], full[1, 3:11, 5:19], full[2, height - 1, width - 1] = True, True, True
    full[3] = default_rng(seed).random((height, width)) < 0.3
    return cut_masks(full, np.ones(4, np.float32))


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    pytest.importorskip("torch", reason="needs torch").set_num_threads(1)
    pytest.importorskip("transformers", reason="needs transformers")
    return write_model(tmp_path_factory.mktemp("models") / "tiny-tipsv2", "tipsv2")


def tiny(folder: Path, dtype: str = "float32") -> Any:
    return load_encoder(str(folder), "cpu", dtype)


def patches_by_hand(folder: Path, image: np.ndarray) -> np.ndarray:
    """Unit vectors, (row, column, number); the first token is the image's, the second a register."""
    import torch
    import transformers

    model = transformers.AutoModel.from_pretrained(folder).float().eval()
    scaled = np.asarray(Image.fromarray(image).resize((SIDE, SIDE), Image.Resampling.BILINEAR), np.float32) / 255
    with torch.no_grad():
        tokens = model.vision_model(torch.from_numpy(scaled.transpose(2, 0, 1))[None]).last_hidden_state[0, 2:]
    rows = tokens.double().numpy().reshape(ALONG, ALONG, -1)
    return rows / np.linalg.norm(rows, axis=2, keepdims=True)


def shares_by_hand(mask: np.ndarray) -> np.ndarray:
    """How much of each cell a mask covers: every pixel is an area that cells share."""
    height, width = mask.shape
    shares = np.zeros((ALONG, ALONG))
    for y, x in np.argwhere(mask):
        for row in range(ALONG):
            for column in range(ALONG):
                tall = min((y + 1) * ALONG / height, row + 1) - max(y * ALONG / height, row)
                wide = min((x + 1) * ALONG / width, column + 1) - max(x * ALONG / width, column)
                shares[row, column] += max(tall, 0) * max(wide, 0)
    return shares


def unit(rows: np.ndarray) -> np.ndarray:
    return rows / np.linalg.norm(rows, axis=-1, keepdims=True)


def test_masks_are_means_of_the_patches_that_they_cover(folder):
    masks, patches = some_masks(), patches_by_hand(folder, PHOTO)
    rows = tiny(folder).encode_masks(PHOTO, masks)
    expected = [np.einsum("rc,rcd->d", shares_by_hand(masks.full(row)), patches) for row in range(len(masks))]
    assert rows.dtype == np.float32
    assert_allclose(rows, unit(np.array(expected)), atol=5e-6)
    assert np.abs(rows[1] - rows[2]).max() > 1e-3  # other places, other rows


def test_an_image_is_the_mask_of_all_of_it(folder):
    encoder = tiny(folder)
    assert_allclose(encoder.encode_images([PHOTO])[0], encoder.encode_masks(PHOTO, some_masks())[0], atol=2e-6)


def test_one_look_at_the_photo_and_no_crops(folder, monkeypatch):
    encoder, looks = tiny(folder), []
    inner = encoder._patch_rows
    monkeypatch.setattr(encoder, "_patch_rows", lambda values: looks.append(len(values)) or inner(values))
    masks = some_masks()
    assert isinstance(encoder, MaskEncoder)
    assert_allclose(mask_rows(PHOTO, masks, encoder), encoder.encode_masks(PHOTO, masks))
    assert looks == [1, 1]
    assert encoder.encode_masks(PHOTO, masks.subset([])).shape == (0, encoder.identity.dim)


def test_other_encoders_get_crops(tmp_path):
    pytest.importorskip("transformers", reason="needs transformers")
    encoder, masks = tiny(write_model(tmp_path / "clip", "clip")), some_masks()
    assert not isinstance(encoder, MaskEncoder)
    assert_allclose(mask_rows(PHOTO, masks, encoder), encoder.encode_images(crops(PHOTO, masks)))


@pytest.mark.slow
def test_texts_are_those_of_the_model_called_by_hand(folder):
    """One by one without padding; in a batch the shorter ones are padded and masked."""
    import torch
    import transformers

    model = transformers.AutoModel.from_pretrained(folder).float().eval()
    tokenizer = transformers.AutoTokenizer.from_pretrained(folder)
    with torch.no_grad():
        rows = [model.get_text_features(torch.tensor([tokenizer(t)["input_ids"]])).pooler_output[0] for t in TEXTS]
    assert_allclose(tiny(folder).encode_texts(TEXTS), unit(np.stack([row.double().numpy() for row in rows])), atol=2e-6)


def test_finer_patches_by_larger_images(folder, tmp_path):
    """The model interpolates its places; a photo is always stretched, whatever the file says of cutting."""
    from shutil import copytree

    larger = Path(copytree(folder, tmp_path / "larger"))
    settings = {"do_normalize": False, "do_center_crop": True, "crop_size": 2 * SIDE}
    (larger / "preprocessor_config.json").write_text(json.dumps(settings))
    encoder = tiny(larger)
    assert str(encoder.preprocessing).startswith(f"{2 * SIDE} px bilinear stretched, x0.00392157, mean 0 0 0")
    assert encoder.encode_masks(PHOTO, some_masks()).shape == (4, encoder.identity.dim)
    (larger / "preprocessor_config.json").write_text(json.dumps({"size": {"height": 30, "width": 30}}))
    with pytest.raises(FormatError, match="expects a multiple of 8"):
        tiny(larger)


@given(st.integers(1, 30), st.integers(1, 30), st.integers(0, 2**32 - 1), st.integers(1, 9))
def test_coverage_keeps_the_area_of_larger_images(rows, columns, seed, along):
    height, width = rows * along, columns * along
    mask = default_rng(seed).random((height, width)) < 0.5
    shares = coverage(cut_masks(mask[None], np.ones(1, np.float32)), 0, along)
    expected = mask.reshape(along, rows, along, columns).mean((1, 3))
    assert_allclose(shares, expected, atol=1e-5)


def test_a_pixel_on_the_border_of_two_cells_counts():
    """Its middle, 6.5, is where the third of six cells over 13 pixels ends."""
    mask = np.zeros((1, 1, 13), bool)
    mask[0, 0, 6] = True
    assert coverage(cut_masks(mask, np.ones(1, np.float32)), 0, 6).sum() > 0


@given(st.integers(1, 20), st.integers(1, 20), st.integers(1, 20), st.data())
def test_every_pixel_counts_somewhere(height, width, along, data):
    mask = np.zeros((1, height, width), bool)
    mask[0, data.draw(st.integers(0, height - 1)), data.draw(st.integers(0, width - 1))] = True
    assert coverage(cut_masks(mask, np.ones(1, np.float32)), 0, along).sum() > 0
