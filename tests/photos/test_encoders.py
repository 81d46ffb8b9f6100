"""Encoders of transformers on tiny random models, against the models called by hand."""

import json
import re
import shutil
import sys
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from drsplat.errors import DrSplatError, FormatError, InputError, MissingExtraError, pip_install
from drsplat.field.codes.codebook import encoder_from_json
from drsplat.photos.models import devices, libraries, pretrained, sam, torch_encoder
from drsplat.photos.models.loading import DEFAULT_ENCODER, load_encoder
from drsplat.photos.models.preprocessing import Preprocessing, read_preprocessing
from drsplat.photos.models.words import WordEncoder
from drsplat.scene.encoders import Encoder, EncoderIdentity, ImageEncoder, identity_json
from refusing import malformed, refused
from tiny_encoders import PATCH, SIDE, TOKENS, write_model

torch = pytest.importorskip("torch", reason="needs torch")
transformers = pytest.importorskip("transformers", reason="needs transformers")
torch.set_num_threads(1)
hub = pytest.importorskip("huggingface_hub", reason="comes with transformers")

WITH_TEXTS = ("clip", "metaclip_2", "siglip", "siglip2")
IMAGES_ONLY = ("dinov2", "dinov3_vit")
KINDS = (*WITH_TEXTS, *IMAGES_ONLY)
_OPENAI = [0.48145466, 0.4578275, 0.40821073], [0.26862954, 0.26130258, 0.27577711]
_IMAGENET = [0.485, 0.456, 0.406], [0.229, 0.224, 0.225]
COLORS = {"clip": _OPENAI, "metaclip_2": _OPENAI, "dinov2": _IMAGENET, "dinov3_vit": _IMAGENET}
SIZES = ((20, 20), (1, 1), (50, 50), (32, 32), (3, 3))
IMAGES = [np.random.default_rng(seed).integers(0, 256, (*size, 3), np.uint8) for seed, size in enumerate(SIZES)]
TEXTS = ["a red mug", "the table", "mug", "a blue mug on the table"]


@pytest.fixture(scope="session")
def folders(tmp_path_factory) -> dict[str, Path]:
    base = tmp_path_factory.mktemp("models")
    return {kind: write_model(base / f"tiny-{kind}", kind) for kind in KINDS}


@pytest.fixture
def copied(folders, tmp_path) -> Path:
    """A CLIP to damage."""
    return Path(shutil.copytree(folders["clip"], tmp_path / "copied"))


def tiny(folder: Path, dtype: str = "float32") -> Any:
    return load_encoder(str(folder), "cpu", dtype)


@lru_cache
def by_transformers(folder: Path) -> Any:
    return transformers.AutoModel.from_pretrained(folder).float().eval()


def unit(rows: Any) -> np.ndarray:
    rows = getattr(rows, "pooler_output", rows).detach().double().numpy()
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def pixels_by_hand(kind: str, image: np.ndarray, side: int) -> np.ndarray:
    """Of a square image; written out."""
    how = Image.Resampling.BILINEAR if kind in ("siglip2", "dinov3_vit") else Image.Resampling.BICUBIC
    scaled = np.asarray(Image.fromarray(image).resize((side, side), how))
    mean, std = COLORS.get(kind, ([0.5] * 3, [0.5] * 3))
    return ((scaled / 255 - mean) / std).transpose(2, 0, 1).astype(np.float32)


def rows_by_hand(kind: str, folder: Path, images: Sequence[np.ndarray]) -> np.ndarray:
    """One image at a time."""
    model, side, rows = by_transformers(folder), 28 if kind in IMAGES_ONLY else SIDE, []
    for image in images:
        values = torch.from_numpy(pixels_by_hand(kind, image, side))[None]
        with torch.no_grad():
            if kind in IMAGES_ONLY:
                rows.append(model(pixel_values=values).last_hidden_state[:, 0])
            elif kind == "siglip2":
                n = SIDE // PATCH
                rows.append(
                    model.get_image_features(
                        patches_by_hand(values[0]), torch.ones(1, n * n), torch.tensor([[n, n]])
                    ).pooler_output
                )
            else:
                rows.append(model.get_image_features(values).pooler_output)
    return unit(torch.cat(rows))


def patches_by_hand(values: Any) -> Any:
    squares = []
    for y in range(0, SIDE, PATCH):
        for x in range(0, SIDE, PATCH):
            square = values[:, y : y + PATCH, x : x + PATCH]
            squares.append(square.permute(1, 2, 0).reshape(-1))
    return torch.stack(squares)[None]


def write_small_preprocessing(folder: Path, kind: str) -> None:
    cut = {"do_center_crop": True, "crop_size": 28, "size": {"shortest_edge": 32}}
    settings = cut if kind == "dinov2" else {"size": {"height": 28, "width": 28}}
    (folder / "preprocessor_config.json").write_text(json.dumps(settings))


# --- images -----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_images_are_those_of_the_model_called_by_hand(kind, folders):
    if kind in IMAGES_ONLY:
        write_small_preprocessing(folders[kind], kind)
    encoder = tiny(folders[kind])
    rows = encoder.encode_images(IMAGES)
    assert (rows.dtype, rows.shape) == (np.float32, (len(IMAGES), encoder.identity.dim))
    assert_allclose(rows, rows_by_hand(kind, folders[kind], IMAGES), atol=2e-6)
    assert_allclose(np.linalg.norm(rows, axis=1), 1, atol=1e-6)
    assert np.abs(rows[0] - rows[2]).max() > 1e-3  # different images, different rows


def test_batches_are_bounded_by_bytes(folders):
    encoder = tiny(folders["clip"])
    assert encoder.batch == (5 << 20) // (3 * 4 * SIDE**2)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_half_precision_is_close_to_single(kind, folders):
    encoder, single = tiny(folders[kind], "bfloat16"), tiny(folders[kind])
    exact, rows = single.encode_images(IMAGES), encoder.encode_images(IMAGES)
    assert rows.dtype == np.float32
    assert 0 < np.abs(rows - exact).max() < 0.03
    if kind in WITH_TEXTS:
        assert_array_equal(encoder.encode_texts(TEXTS), single.encode_texts(TEXTS))


@pytest.mark.parametrize("kind", ["clip", "siglip", "siglip2"])
def test_published_preprocessing_of_square_images(kind, folders):
    """Against the processors of transformers that need no torchvision."""
    name = {"clip": "CLIP", "siglip": "Siglip", "siglip2": "Siglip2"}[kind]
    module = __import__(f"transformers.models.{kind}.image_processing_pil_{kind}", fromlist=["_"])
    sizes = {
        "clip": {"size": {"shortest_edge": SIDE}, "crop_size": SIDE},
        "siglip": {"size": {"height": SIDE, "width": SIDE}},
        "siglip2": {"patch_size": PATCH, "max_num_patches": (SIDE // PATCH) ** 2},
    }
    processor = getattr(module, f"{name}ImageProcessorPil")(**sizes[kind])
    encoder = tiny(folders[kind])
    for image in IMAGES:
        theirs = processor(images=image, return_tensors="pt", input_data_format="channels_last")
        ours = encoder.preprocessing.pixel_values(image)
        if kind == "siglip2":
            ours = patches_by_hand(torch.from_numpy(ours))[0].numpy()
        assert_allclose(ours, theirs["pixel_values"][0], atol=2e-6)


def test_images_that_are_not_square(folders):
    wide = np.zeros((20, 60, 3), np.uint8)
    wide[:, 20:40] = 255
    cut = Preprocessing(10, "bicubic", (0.0,) * 3, (1.0,) * 3).pixel_values(wide)
    assert_allclose(cut[:, :, 2:8], 1, atol=1e-2)  # the middle third is all that is left
    stretched = Preprocessing(9, "box", (0.0,) * 3, (1.0,) * 3, stretch=True).pixel_values(wide)
    assert_allclose(stretched[0, 0], [0, 0, 0, 1, 1, 1, 0, 0, 0], atol=1e-6)


def test_no_images_no_rows(folders):
    assert tiny(folders["clip"]).encode_images([]).shape == (0, 8)
    with refused("0x3 pixels"):
        tiny(folders["clip"]).encode_images([np.zeros((3, 0, 3), np.uint8)])


# --- texts ------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", WITH_TEXTS)
def test_texts_are_those_of_the_model_called_by_hand(kind, folders):
    model, rows = by_transformers(folders[kind]), []
    tokenizer = transformers.AutoTokenizer.from_pretrained(folders[kind])
    for text in TEXTS:  # one by one, so CLIP needs no padding
        ids = tokenizer(text)["input_ids"]
        if kind.startswith("siglip"):
            ids = ids + [tokenizer.pad_token_id] * (TOKENS - len(ids))
            if tokenizer.padding_side == "left":
                ids = tokenizer(text, padding="max_length", max_length=TOKENS)["input_ids"]
        with torch.no_grad():
            rows.append(model.get_text_features(torch.tensor([ids])).pooler_output)
    encoder = tiny(folders[kind])
    found = encoder.encode_texts(TEXTS)
    assert_allclose(found, unit(torch.cat(rows)), atol=2e-6)
    assert_allclose(encoder.encode_texts(TEXTS[::-1]), found[::-1], atol=1e-6)
    assert np.abs(found[0] - found[1]).max() > 1e-3


@pytest.mark.parametrize("kind", ["clip", "siglip"])
def test_case_makes_no_difference(kind, folders):
    upper, lower = tiny(folders[kind]).encode_texts(["A Red MUG", "a red mug"])
    assert_allclose(upper, lower, atol=1e-6)


def test_texts_are_embedded_once(folders, monkeypatch):
    encoder, asked = tiny(folders["clip"]), []
    inner = encoder._text_rows
    monkeypatch.setattr(encoder, "_text_rows", lambda texts: asked.extend(texts) or inner(texts))
    first = encoder.encode_texts(["a", "mug", "a"])
    assert asked == ["a", "mug"]
    assert_array_equal(first[0], first[2])
    assert_array_equal(encoder.encode_texts(["mug", "a"]), first[[1, 0]])
    assert asked == ["a", "mug"]
    monkeypatch.setattr(torch_encoder, "MAX_CACHED_TEXTS", 2)
    assert_array_equal(encoder.encode_texts(["the", "a", "on"])[1], first[0])
    encoder.encode_texts(["a", "on"])
    assert asked == ["a", "mug", "the", "on"]
    encoder.encode_texts(["mug"])  # was forgotten
    assert asked[-1] == "mug"


def test_texts_that_cannot_be_embedded(folders, copied):
    encoder = tiny(folders["clip"])
    assert encoder.encode_texts([]).shape == (0, 8)
    with refused("expected a list"):
        encoder.encode_texts("mug")
    with refused("is empty: name"):
        encoder.encode_texts(["mug", " "])
    with refused(f"15 tokens, tiny-clip reads {TOKENS}: shorten"):
        encoder.encode_texts(["mug", "mug " * 13])
    (copied / "vocab.json").unlink()
    (copied / "merges.txt").unlink()
    encoder = tiny(copied)
    assert encoder.encode_images(IMAGES[:1]).shape == (1, 8)  # needs no tokenizer
    with refused("has no tokenizer"):
        encoder.encode_texts(["mug"])


@pytest.mark.parametrize("kind", IMAGES_ONLY)
def test_models_of_images_alone_know_no_words(kind, folders):
    with refused("self-referencing"):
        tiny(folders[kind]).encode_texts(["mug"])


# --- identities -------------------------------------------------------------------------------


def test_identity_is_of_name_weights_and_preprocessing(folders, copied, tmp_path):
    given = tiny(folders["clip"]).identity
    assert (given.name, given.dim, len(given.weights)) == ("tiny-clip", 8, 32)
    assert given.preprocessing.startswith("32 px bicubic cut")
    same = tiny(copied).identity
    assert (same.name, same.weights) == ("copied", given.weights)
    assert same.matches(given)  # another name of the folder is no other model
    (copied / "preprocessor_config.json").write_text(json.dumps({"image_mean": [0.5, 0.5, 0.5]}))
    assert not tiny(copied).identity.matches(given)
    other = tiny(write_model(tmp_path / "tiny-clip", "clip", seed=1)).identity
    assert other.name == given.name
    assert not other.matches(given)


def test_unknown_parts_of_identities_match_all():
    full = EncoderIdentity("a", 8, "w", "224 px")
    for known in (EncoderIdentity("a", 8), EncoderIdentity("a", 8, "w"), full):
        assert known.matches(full)
        assert full.matches(known)
    for other in (
        EncoderIdentity("b", 8),
        EncoderIdentity("a", 9, "w", "224 px"),
        EncoderIdentity("a", 8, "v", "224 px"),
        EncoderIdentity("a", 8, "w", "336 px"),
    ):
        assert not other.matches(full)
        assert not full.matches(other)


def test_identities_in_files():
    full = EncoderIdentity("a", 8, "w", "224 px")
    assert encoder_from_json(identity_json(full), "here") == full
    old = {"name": "a", "dim": 8, "weights": "w"}
    assert identity_json(EncoderIdentity("a", 8, "w")) == old
    assert encoder_from_json(old, "here") == EncoderIdentity("a", 8, "w")
    with malformed("here"):
        encoder_from_json({**old, "preprocessing": 3}, "here")


def test_they_are_encoders(folders):
    encoder = tiny(folders["clip"])
    assert isinstance(encoder, Encoder)
    assert isinstance(encoder, ImageEncoder)
    assert isinstance(load_encoder("drsplat-words"), WordEncoder)


# --- preprocessing files ----------------------------------------------------------------------

PUBLISHED = Preprocessing(224, "bicubic", (0.5, 0.5, 0.5), (0.5, 0.5, 0.5))


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({}, "224 px bicubic cut"),
        ({"size": 224, "crop_size": 336, "do_center_crop": True}, "336 px bicubic cut"),
        ({"size": {"shortest_edge": 256}, "crop_size": {"height": 224, "width": 224}}, "224 px"),
        ({"size": {"height": 384, "width": 384}, "do_center_crop": False}, "384 px bicubic stre"),
        ({"size": {"shortest_edge": 384}, "do_center_crop": False}, "384 px bicubic cut"),
        ({"resample": 2, "size": None}, "224 px bilinear cut"),
        ({"do_normalize": False}, "224 px bicubic cut, x0.00392157, mean 0 0 0, std 1 1 1"),
    ],
)
def test_settings_of_processors(settings, expected, tmp_path):
    for name, document in (
        ("processor_config.json", {"image_processor": settings}),
        ("preprocessor_config.json", settings),
    ):
        (tmp_path / name).write_text(json.dumps(document))
        assert str(read_preprocessing(tmp_path, PUBLISHED)).startswith(expected)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"do_rescale": False}, "do_rescale is off"),
        ({"size": {"height": 224, "width": 112}, "crop_size": None}, "one side of a square"),
        ({"size": {}}, "one side"),
        ({"size": 0}, "1 to 4096"),
        ({"size": "big"}, "expected a number"),
        ({"resample": 77}, "no filter 77"),
        ({"image_std": [0.5, 0, 0.5]}, "positive"),
        ({"image_mean": [0.5]}, "expected 3 numbers"),
        ([], "expected an object"),
    ],
)
def test_settings_that_are_refused(settings, message, tmp_path):
    (tmp_path / "preprocessor_config.json").write_text(json.dumps(settings))
    with malformed(message):
        read_preprocessing(tmp_path, PUBLISHED)


def test_preprocessing_and_model_must_fit(copied):
    (copied / "preprocessor_config.json").write_text(json.dumps({"crop_size": 40}))
    with malformed("scaled to 40 pixels, the model expects 32"):
        tiny(copied)


# --- what is wrong with a folder --------------------------------------------------------------


def test_names_that_are_no_model(tmp_path):
    for name in (str(tmp_path / "absent"), "a/b/c", "", "../x"):
        with refused("expected a folder"):
            load_encoder(name)
    with refused(r"no config\.json"):
        load_encoder(str(tmp_path))


def test_architectures_that_are_no_encoder(copied):
    for document, kind in (({"model_type": "bert"}, InputError), ({}, FormatError), ([], FormatError)):
        (copied / "config.json").write_text(json.dumps(document))
        with pytest.raises(kind, match=r"bert|model_type"):
            tiny(copied)


def test_weights_that_are_missing_or_pickles(copied):
    (copied / "model.safetensors").unlink()
    with refused(r"has no model\.safetensors"):
        tiny(copied)
    (copied / "pytorch_model.bin").write_bytes(b"pickle")
    with refused("Convert it once"):
        tiny(copied)


def test_damaged_weights(copied):
    path = copied / "model.safetensors"
    whole = path.read_bytes()
    for damaged in (whole[:-1], whole[:100], b"", b"<html>not found</html>"):
        path.write_bytes(damaged)
        with malformed("damaged or incomplete"):
            tiny(copied)


def test_weights_of_another_model(copied, folders):
    shutil.copy(folders["siglip"] / "model.safetensors", copied / "model.safetensors")
    with malformed("CLIPModel"):
        tiny(copied)


def test_missing_tensors_are_never_made_up(copied):
    from safetensors.numpy import load_file, save_file

    path = copied / "model.safetensors"
    tensors = load_file(path)
    del tensors["visual_projection.weight"]
    save_file(tensors, path, {"format": "pt"})
    with malformed(r"lack 1 tensors.*visual_projection"):
        tiny(copied)


def test_weights_in_shards(copied, folders):
    by_transformers(folders["clip"]).save_pretrained(copied, max_shard_size="8KB")
    (copied / "model.safetensors").unlink(missing_ok=True)
    assert_array_equal(tiny(copied).encode_images(IMAGES), tiny(folders["clip"]).encode_images(IMAGES))
    last = max(copied.glob("model-*.safetensors"))
    last.unlink()
    with malformed("is not there"):
        tiny(copied)
    index = copied / "model.safetensors.index.json"
    index.write_text(index.read_text().replace(last.name, "../away.safetensors"))
    with malformed("is not there"):
        tiny(copied)


@pytest.mark.parametrize("value", [np.nan, 0.0])
def test_vectors_without_direction(copied, value):
    from safetensors.numpy import load_file, save_file

    path = copied / "model.safetensors"
    tensors = load_file(path)
    for name in ("visual_projection.weight", "text_projection.weight"):
        tensors[name] = np.full_like(tensors[name], value)
    save_file(tensors, path, {"format": "pt"})
    encoder = tiny(copied)
    with malformed("vector of image 0 of 5 has no direction"):
        encoder.encode_images(IMAGES)
    with malformed("vector of text 0 of 1 has no direction"):
        encoder.encode_texts(["mug"])


# --- the hub ----------------------------------------------------------------------------------


@pytest.fixture
def empty_cache(tmp_path, monkeypatch) -> Path:
    monkeypatch.setattr(hub.constants, "HF_HUB_CACHE", str(tmp_path))
    monkeypatch.setattr(hub.constants, "HF_HUB_OFFLINE", True)
    return tmp_path


def test_no_network(empty_cache):
    with pytest.raises(DrSplatError, match=r"cannot be reached.*HF_HUB_OFFLINE"):
        load_encoder(DEFAULT_ENCODER)


def test_a_cached_model_needs_no_network(empty_cache, folders):
    assert not pretrained.cached_in_full(DEFAULT_ENCODER)
    cache = empty_cache / f"models--{DEFAULT_ENCODER.replace('/', '--')}"
    shutil.copytree(folders["clip"], cache / "snapshots" / ("0" * 40))
    (cache / "refs").mkdir()
    (cache / "refs" / "main").write_text("0" * 40)
    assert pretrained.cached_in_full(DEFAULT_ENCODER)
    for name in (DEFAULT_ENCODER, "ViT-B-16/laion2b_s34b_b88k"):
        assert load_encoder(name, "cpu").identity.name == name


@pytest.mark.parametrize(
    ("kind", "expected", "message"),
    [
        ("RepositoryNotFoundError", InputError, "no such model on the Hugging Face hub"),
        ("LocalEntryNotFoundError", DrSplatError, "cannot be reached"),
        ("OfflineModeIsEnabled", DrSplatError, "cannot be reached"),
        ("HfHubHTTPError", DrSplatError, "cannot be reached"),
    ],
)
def test_what_the_hub_refuses(kind, expected, message, monkeypatch):
    def refuse(*_, **__):
        error_type = getattr(hub.errors, kind)
        raise error_type.__new__(error_type, "no")

    monkeypatch.setattr(hub, "snapshot_download", refuse)
    with pytest.raises(expected, match=message) as caught:
        load_encoder("some/model")
    assert str(caught.value).startswith("some/model: ")


@pytest.mark.parametrize(
    ("load", "name"),
    [(sam.load_segmenter, "facebook/sam3"), (load_encoder, "facebook/dinov3-vitb16-pretrain-lvd1689m")],
)
def test_gated_models_say_how_to_get_them(load, name, monkeypatch):
    def refuse(*_, **__):
        raise hub.errors.GatedRepoError.__new__(hub.errors.GatedRepoError, "403")

    monkeypatch.setattr(hub, "snapshot_download", refuse)
    message = rf"^{name}: gated\. Accept its licence at https://huggingface\.co/{name}, .*`hf auth login`"
    with refused(message):
        load(name)


# --- what is absent ---------------------------------------------------------------------------


def test_absent_libraries(monkeypatch, folders):
    monkeypatch.setattr(libraries, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=re.escape(pip_install("models"))):
        tiny(folders["clip"])
    assert isinstance(load_encoder("drsplat-words"), WordEncoder)


def test_a_batch_that_does_not_fit_into_memory_is_made_smaller(folders, monkeypatch):
    encoder, images = tiny(folders["clip"]), IMAGES * 4
    expected, whole, asked = encoder.encode_images(images), encoder._image_rows, []

    def narrow(some):
        asked.append(len(some))
        if len(some) > 6:
            raise torch.cuda.OutOfMemoryError("tried to allocate 3 GiB")
        return whole(some)

    monkeypatch.setattr(encoder, "_image_rows", narrow)
    assert_allclose(encoder.encode_images(images), expected, atol=1e-6)
    assert asked == [20, 10, 5, 5, 10, 5, 5]
    assert encoder.batch < tiny(folders["clip"]).batch


def test_a_memory_that_holds_not_one_image_is_told(folders, monkeypatch):
    encoder = tiny(folders["clip"])

    def full(some):
        raise torch.cuda.OutOfMemoryError("tried to allocate 3 GiB")

    monkeypatch.setattr(encoder, "_image_rows", full)
    with pytest.raises(DrSplatError, match=r"images do not fit even one at a time.*device 'cpu'.*3 GiB"):
        encoder.encode_images(IMAGES)


def test_a_broken_torchvision_is_named(tmp_path, monkeypatch):
    (tmp_path / "torchvision").mkdir()
    broken = "raise RuntimeError('operator torchvision::nms does not exist')"
    (tmp_path / "torchvision" / "__init__.py").write_text(broken)
    monkeypatch.syspath_prepend(tmp_path)
    for name in [name for name in sys.modules if name.split(".")[0] == "torchvision"]:
        monkeypatch.delitem(sys.modules, name)
    assert "torchvision::nms does not exist" in str(libraries.torchvision_fault())

    class Stumbling:
        def __getattr__(self, name):
            raise ModuleNotFoundError(f"Could not import module '{name}'")

    monkeypatch.setattr(libraries, "models_library", Stumbling)
    with pytest.raises(MissingExtraError, match="pip uninstall torchvision"):
        libraries.model_class("CLIPModel")


def test_old_libraries_and_other_faults(monkeypatch):
    with pytest.raises(MissingExtraError, match="has no NotThere: pip install --upgrade"):
        libraries.model_class("NotThere")
    monkeypatch.setattr(libraries, "torchvision_fault", lambda: None)
    assert "Install them anew" in str(libraries._unusable(ImportError("x")))


def test_devices(folders, monkeypatch):
    with refused("expected one of auto, cpu, cuda, mps, got 'gpu'"):
        load_encoder(str(folders["clip"]), "gpu")
    with refused("expected one of auto, float32"):
        load_encoder(str(folders["clip"]), "cpu", "int8")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(torch.backends.mps, "is_available", lambda: False)
    for device in ("cuda", "mps"):
        with pytest.raises(MissingExtraError, match="finds none"):
            devices.chosen_device(device)
    assert devices.chosen_device() == "cpu"
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert devices.chosen_device() == devices.chosen_device("cuda") == "cuda"


def test_precisions(monkeypatch):
    for fast, expected in ((True, "bfloat16"), (False, "float32")):
        monkeypatch.setattr(devices, "has_fast_bfloat16", lambda fast=fast: fast)
        assert devices.chosen_dtype("auto", "cpu") == expected
    assert devices.chosen_dtype("auto", "cuda") == "float16"
    assert devices.chosen_dtype("auto", "mps") == "float32"
    assert devices.chosen_dtype("float16", "cpu") == "float16"
