"""CLIP, SigLIP, SigLIP 2 and DINOv2 of transformers as encoders."""

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from math import isqrt
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float32, UInt8

from ..encoders import EncoderIdentity
from ..errors import FormatError, InputError
from .devices import chosen_device, chosen_dtype
from .libraries import models_library
from .memory import fitting
from .open_clip import load_open_clip
from .open_clip_settings import open_clip_preprocessing
from .preprocessing import Preprocessing, read_preprocessing
from .pretrained import load_model, load_tokenizer, model_type, weight_files, weights_hash
from .weight_names import OPEN_CLIP

BATCH_BYTES = {"cpu": 5 << 20, "mps": 20 << 20, "cuda": 80 << 20}
"""Of input numbers in one pass: 8 images of 224 pixels on a CPU, where more leave its caches."""
TEXT_BATCH, TEXTS_KEPT = 64, 4096
_HALF = ((0.5,) * 3, (0.5,) * 3)
_OPENAI = (0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711)
_IMAGENET = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


class Family(NamedTuple):
    """What differs between architectures.

    colors: mean and std of published preprocessing. fixed_length: texts are padded to the longest
    that the model reads and lower-cased, both as in its training, and there is no attention mask.
    patches: the model takes a list of patches instead of an image (NaFlex).
    """

    class_name: str
    colors: tuple[tuple[float, ...], tuple[float, ...]]
    texts: bool = True
    fixed_length: bool = False
    patches: bool = False


FAMILIES = {
    "clip": Family("CLIPModel", _OPENAI),
    "siglip": Family("SiglipModel", _HALF, fixed_length=True),
    "siglip2": Family("Siglip2Model", _HALF, fixed_length=True, patches=True),
    "dinov2": Family("Dinov2Model", _IMAGENET, texts=False),
}
"""By model_type of config.json. SigLIP 2 at a fixed resolution is "siglip", its NaFlex "siglip2".

Source: Radford et al. 2021; Zhai et al. 2023; Tschannen et al. 2025 (text lower-cased, 64 tokens);
Oquab et al. 2024; the preprocessor_config.json that each was published with.
"""


class TransformersEncoder:
    """Images and texts to unit vectors. Made by `loading.load_encoder`.

    identity: name as asked for, hash of the weights, preprocessing. device, dtype: where and in what precision images
    are computed; texts always in float32. batch: images in one pass, fewer from when the device's memory was full on.
    The last TEXTS_KEPT texts are remembered.
    """

    def __init__(self, name: str, folder: Path, device: str = "auto", dtype: str = "auto") -> None:
        """Raises: as `load_encoder`, except for what concerns the hub."""
        kind = model_type(folder)
        if kind not in FAMILIES:
            raise InputError(
                f"{name}: its architecture is '{kind}', not an encoder that drsplat knows ({', '.join(FAMILIES)})"
            )
        self._family, self._folder, files = FAMILIES[kind], folder, weight_files(folder)
        models_library()
        self.device = chosen_device(device)
        self.dtype = chosen_dtype(dtype, self.device)
        self._model = _model(self._family.class_name, folder, files).to(self.device)
        self._cast_vision()
        published = _published(self._family, self._vision)
        if kind == "clip":
            published = open_clip_preprocessing(folder, published)
        self.preprocessing = read_preprocessing(folder, published)
        self._check_side()
        self.batch = max(1, BATCH_BYTES[self.device] // (12 * self.preprocessing.side**2))
        dim = self._model.config.projection_dim if kind == "clip" else self._vision.hidden_size
        self.identity = EncoderIdentity(name, dim, weights_hash(files), str(self.preprocessing))
        self._tokenizer: Any = None
        self._texts: OrderedDict[str, np.ndarray] = OrderedDict()

    def encode_images(self, images: Sequence[UInt8[np.ndarray, "_ _ 3"]]) -> Float32[np.ndarray, "n d"]:
        """Unit vectors of images of any size, in their order; a batch at a time is in memory.

        Raises: InputError: an image without pixels. FormatError: a vector without direction. DrSplatError: not even
        one image fits into the device's memory.
        """
        rows: list[np.ndarray] = []
        done = 0
        while done < len(images):
            fits = fitting(self._image_rows, images[done : done + self.batch], "images")
            done += sum(map(len, fits))
            rows += fits
            self.batch = max(1, self.batch // len(fits))
        return self._unit(rows, "image")

    def encode_texts(self, texts: Sequence[str]) -> Float32[np.ndarray, "t d"]:
        """Unit vectors of the texts as they are: no prompt is put around them.

        Raises: InputError: a model without texts, a text that is empty or too long, no tokenizer.
        FormatError: a vector without direction.
        """
        self._check_texts(texts)
        new = [text for text in dict.fromkeys(texts) if text not in self._texts]
        for block in _blocks(len(new), TEXT_BATCH):
            rows = self._unit([self._text_rows(new[block])], "text")
            self._texts.update(zip(new[block], rows, strict=True))
        for text in texts:
            self._texts.move_to_end(text)
        vectors = [self._texts[text] for text in texts]
        while len(self._texts) > TEXTS_KEPT:
            self._texts.popitem(last=False)
        return np.stack(vectors) if vectors else np.empty((0, self.identity.dim), np.float32)

    @property
    def _vision(self) -> Any:
        return getattr(self._model.config, "vision_config", self._model.config)

    def _check_side(self) -> None:
        side, patch, kind = self.preprocessing.side, self._vision.patch_size, self._family
        fixed = self._vision.image_size if kind.texts and not kind.patches else None
        if side % patch or fixed not in (None, side):
            raise FormatError(
                f"{self._folder}: its images are scaled to {side} pixels, the model expects "
                f"{fixed or f'a multiple of {patch}'}: take config and preprocessing of one model"
            )

    def _image_rows(self, images: Sequence[np.ndarray]) -> np.ndarray:
        torch = import_module("torch")
        with ThreadPoolExecutor(torch.get_num_threads()) as pool:  # a GPU would wait for one core's scaling
            scaled = list(pool.map(self.preprocessing.pixel_values, images))
        values = torch.from_numpy(np.stack(scaled))
        inputs = self._patches(values) if self._family.patches else {"pixel_values": values}
        inputs["pixel_values"] = inputs["pixel_values"].to(getattr(torch, self.dtype))
        inputs = {name: value.to(self.device) for name, value in inputs.items()}
        images_to_output = self._model.get_image_features if self._family.texts else self._model
        with torch.inference_mode():
            return _rows(images_to_output(**inputs))

    def _cast_vision(self) -> None:
        """Once: autocast would cast every weight again for every batch, a tenth of the time."""
        parts = ("vision_model", "visual_projection") if self._family.texts else ()
        dtype = getattr(import_module("torch"), self.dtype)
        for part in [getattr(self._model, name, None) for name in parts] or [self._model]:
            if part is not None:
                part.to(dtype)

    def _patches(self, values: Any) -> dict[str, Any]:
        """(b, 3, s, s) cut into squares, row by row; within one by row, column, channel."""
        torch, size = import_module("torch"), self._vision.patch_size
        count, along = len(values), values.shape[-1] // size
        cut = values.reshape(count, 3, along, size, along, size).permute(0, 2, 4, 3, 5, 1)
        return {
            "pixel_values": cut.reshape(count, along * along, -1),
            "pixel_attention_mask": torch.ones(count, along * along, dtype=torch.int32),
            "spatial_shapes": torch.full((count, 2), along),
        }

    def _check_texts(self, texts: Sequence[str]) -> None:
        if not self._family.texts:
            raise InputError(
                f"{self.identity.name} sees images only and knows no words: query with an image of what you look for, "
                "or with the embedding of a mask of the scene (a self-referencing query)"
            )
        if isinstance(texts, str):
            raise InputError(f"texts: expected a list of texts, got the single text {texts!r}")
        empty = [text for text in texts if not text.strip()]
        if empty:
            raise InputError(f"{empty[0]!r} is empty: name an object, e.g. 'a red mug'")

    def _text_rows(self, texts: Sequence[str]) -> np.ndarray:
        torch = import_module("torch")
        inputs = {name: value.to(self.device) for name, value in self._tokens(texts).items()}
        with torch.inference_mode():
            return _rows(self._model.get_text_features(**inputs))

    def _tokens(self, texts: Sequence[str]) -> dict[str, Any]:
        """Raises: InputError: a text has more tokens than the model reads."""
        self._tokenizer = self._tokenizer or load_tokenizer(self._folder)
        fixed, most = (self._family.fixed_length, self._model.config.text_config.max_position_embeddings)
        texts = [text.lower() for text in texts] if fixed else list(texts)
        lengths = [len(ids) for ids in self._tokenizer(texts)["input_ids"]]
        if max(lengths) > most:
            text = texts[int(np.argmax(lengths))]
            raise InputError(f"{text[:60]!r} has {max(lengths)} tokens, {self.identity.name} reads {most}: shorten it")
        padded = self._tokenizer(
            texts, padding="max_length" if fixed else True, max_length=most if fixed else None, return_tensors="pt"
        )
        names = ["input_ids"] if fixed else ["input_ids", "attention_mask"]
        return {name: padded[name] for name in names}

    def _unit(self, blocks: Sequence[np.ndarray], what: str) -> Float32[np.ndarray, "n d"]:
        rows = np.concatenate([np.empty((0, self.identity.dim), np.float32), *blocks])
        norms = np.linalg.norm(rows.astype(np.float64), axis=1, keepdims=True)
        bad = np.flatnonzero(~(np.isfinite(norms) & (norms > 0)))
        if len(bad):
            raise FormatError(
                f"{self.identity.name}: the vector of {what} {bad[0]} of {len(rows)} has no direction (zero or not "
                f"finite): the weights are damaged, or {self.dtype} is too coarse for them: try dtype 'float32'"
            )
        return np.asarray(rows / norms, np.float32)


def _model(class_name: str, folder: Path, files: list[Path]) -> Any:
    if files[0].name == OPEN_CLIP:
        return load_open_clip(folder)
    return load_model(class_name, folder, ("mask_token", "logit_scale", "logit_bias"))


def _published(family: Family, vision: Any) -> Preprocessing:
    """What the folder has without a file of it."""
    side = vision.patch_size * isqrt(vision.num_patches) if family.patches else vision.image_size
    side = side if family.texts else 224  # DINOv2's config has the side of its last training, 518
    name = "bilinear" if family.patches else "bicubic"
    mean, std = family.colors
    stretch = family.fixed_length and not family.patches
    return Preprocessing(side, name, tuple(mean), tuple(std), stretch=stretch)  # type: ignore[arg-type]


def _blocks(count: int, size: int) -> Iterator[slice]:
    return (slice(start, start + size) for start in range(0, count, size))


def _rows(output: Any) -> np.ndarray:
    """transformers from 5 on returns an object where it returned a tensor."""
    tensor = getattr(output, "pooler_output", output)
    rows: np.ndarray = tensor.float().cpu().numpy()
    return rows
