"""Encoders of open_clip's own library: our side of it with a stand-in, and the library itself where it is installed.

The stand-in has the four things of the library that drsplat uses, and a model of a few numbers. What the library
computes is tested in a process of its own (timm_models.py), which needs open_clip_torch and timm.
"""

import json
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from test_sam import run_alone

from drsplat.errors import MissingExtraError
from drsplat.photos.models import open_clip_encoder, pretrained
from drsplat.photos.models.loading import load_encoder
from refusing import malformed, refused

torch = pytest.importorskip("torch", reason="needs torch")
pytest.importorskip("transformers", reason="needs transformers")
torch.set_num_threads(1)

SIDE, DIM, TOKENS = 8, 4, 5
IMAGES = [np.random.default_rng(seed).integers(0, 256, (SIDE, SIDE, 3), np.uint8) for seed in range(3)]
SETTINGS = {
    "model_cfg": {"embed_dim": DIM, "vision_cfg": {"timm_model_name": "any"}, "text_cfg": {}},
    "preprocess_cfg": {"size": 224, "mean": [0.5] * 3, "std": [0.25] * 3, "resize_mode": "squash"},
}


class Model(torch.nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.visual, self.words = torch.nn.Linear(3 * SIDE**2, DIM), torch.nn.Embedding(64, DIM)
        self.visual.image_size = (SIDE, SIDE)

    def encode_image(self, pixels: Any) -> Any:
        return self.visual(pixels.flatten(1))

    def encode_text(self, tokens: Any) -> Any:
        return self.words(tokens).sum(1)


class Tokenizer:
    """A token for each word by its length, between a first and a last; what is too long is cut, as theirs does."""

    context_length = TOKENS

    def __call__(self, texts: Sequence[str], context_length: int = TOKENS) -> Any:
        result = torch.zeros(len(texts), context_length, dtype=torch.long)
        for row, text in enumerate(texts):
            tokens = [1, *(3 + len(word) for word in text.split()), 2][:context_length]
            tokens[-1] = 2
            result[row, : len(tokens)] = torch.tensor(tokens)
        return result


@pytest.fixture
def library(monkeypatch) -> ModuleType:
    module = ModuleType("open_clip")

    def create_model(name, *, require_pretrained, pretrained_text, weights_only):
        from safetensors.torch import load_file

        assert (require_pretrained, pretrained_text, weights_only) == (True, False, True)
        model = Model()
        model.load_state_dict(load_file(Path(name.removeprefix("local-dir:")) / "open_clip_model.safetensors"))
        return model

    module.create_model, module.get_tokenizer = create_model, lambda name: Tokenizer()
    monkeypatch.setitem(sys.modules, "open_clip", module)
    monkeypatch.setattr(open_clip_encoder, "find_spec", lambda name: object())
    return module


@pytest.fixture
def folder(tmp_path) -> Path:
    from safetensors.torch import save_file

    torch.manual_seed(0)
    place = tmp_path / "tiny"
    place.mkdir()
    (place / "open_clip_config.json").write_text(json.dumps(SETTINGS))
    save_file(Model().state_dict(), place / "open_clip_model.safetensors")
    return place


def tiny(folder: Path, prefix: str = "open_clip:") -> Any:
    return load_encoder(f"{prefix}{folder}", "cpu", "float32")


def unit(rows: Any) -> np.ndarray:
    rows = rows.detach().double().numpy()
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


@pytest.mark.parametrize("prefix", ["open_clip:", "hf-hub:"])
def test_images_and_texts_go_through_the_library(library, folder, prefix):
    encoder, model = (
        tiny(folder, prefix),
        library.create_model(f"local-dir:{folder}", require_pretrained=True, pretrained_text=False, weights_only=True),
    )
    pixels = torch.tensor((np.stack(IMAGES).transpose(0, 3, 1, 2) / 255 - 0.5) / 0.25).float()
    assert_allclose(encoder.encode_images(IMAGES), unit(model.encode_image(pixels)), atol=2e-6)
    texts = ["a red mug", "the table"]
    assert_allclose(encoder.encode_texts(texts), unit(model.encode_text(Tokenizer()(texts))), atol=2e-6)


def test_identity_is_of_weights_and_the_size_that_the_model_takes(library, folder):
    identity = tiny(folder).identity
    assert (identity.name, identity.dim, len(identity.weights)) == ("tiny", DIM, 32)
    assert identity.preprocessing.startswith("8 px bicubic stretched, x0.00392157, mean 0.5 0.5 0.5, std 0.25")


def test_texts_that_are_too_long(library, folder):
    encoder = tiny(folder)
    assert encoder.encode_texts(["one red mug"]).shape == (1, DIM)  # with both ends as many as it reads
    with refused("'one very red mug' has more than the 5 tokens"):
        encoder.encode_texts(["mug", "one very red mug"])
    with refused("is empty"):
        encoder.encode_texts([" "])


def test_the_hub_is_asked_for_the_librarys_files_alone(library, folder, monkeypatch):
    asked = []

    def download(name, allow_patterns):
        asked.append((name, allow_patterns))
        return str(folder)

    monkeypatch.setattr(pretrained.import_module("huggingface_hub"), "snapshot_download", download)
    assert load_encoder("hf-hub:timm/PE-Core-B-16", "cpu").identity.name == "hf-hub:timm/PE-Core-B-16"
    assert [name for name, _ in asked] == ["timm/PE-Core-B-16"]
    assert [file for file in asked[0][1] if "safetensors" in file] == ["open_clip_model.safetensors"]
    assert not any(file.endswith((".bin", ".pt")) for file in asked[0][1])


def test_folders_that_are_not_the_librarys(library, folder):
    weights = folder / "open_clip_model.safetensors"
    whole = weights.read_bytes()
    weights.write_bytes(whole[:-1])
    with malformed("damaged or incomplete"):
        tiny(folder)
    weights.unlink()
    (folder / "open_clip_pytorch_model.bin").write_bytes(b"pickle")
    with refused("Convert it once"):
        tiny(folder)
    (folder / "open_clip_config.json").write_text(json.dumps({"model_cfg": {}}))
    weights.write_bytes(whole)
    with malformed("embed_dim"):
        tiny(folder)
    (folder / "open_clip_config.json").unlink()
    with refused(r"no open_clip_config\.json"):
        tiny(folder)


def test_weights_of_another_model(library, folder):
    from safetensors.torch import save_file

    save_file({"other": torch.zeros(3)}, folder / "open_clip_model.safetensors")
    with malformed("do not make a model of open_clip"):
        tiny(folder)


def test_without_the_library_nothing_is_downloaded(monkeypatch):
    def download(*_, **__):
        raise AssertionError

    monkeypatch.setattr(open_clip_encoder, "find_spec", lambda name: None)
    monkeypatch.setattr(pretrained.import_module("huggingface_hub"), "snapshot_download", download)
    with pytest.raises(MissingExtraError, match=r'open_clip_torch, not installed: pip install .*\[open-clip\]"'):
        load_encoder("hf-hub:timm/PE-Core-B-16")


def test_a_library_that_cannot_be_imported(monkeypatch):
    monkeypatch.setattr(open_clip_encoder, "find_spec", lambda name: object())
    monkeypatch.setitem(sys.modules, "open_clip", None)
    with pytest.raises(MissingExtraError, match=r"cannot be imported.*torchvision"):
        load_encoder("open_clip:anywhere")


@pytest.mark.oracle
def test_embeddings_are_those_of_the_library_itself():
    if find_spec("open_clip") is None or find_spec("timm") is None:
        pytest.skip("needs open_clip_torch and timm")
    run_alone("timm_models.py", "open_clip")
