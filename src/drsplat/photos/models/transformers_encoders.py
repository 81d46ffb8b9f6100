"""CLIP, MetaCLIP 2, SigLIP, SigLIP 2, DINOv2, DINOv3 and TIPSv2 of transformers as encoders."""

from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from math import isqrt
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...errors import FormatError, InputError
from ...scene.encoders import EncoderIdentity
from .devices import chosen_device, chosen_dtype
from .libraries import models_library
from .open_clip import load_open_clip
from .open_clip_settings import open_clip_preprocessing
from .preprocessing import Preprocessing, read_preprocessing
from .pretrained import load_model, load_tokenizer, model_type, weight_files, weights_hash
from .torch_encoder import TorchEncoder, as_rows
from .weight_names import OPEN_CLIP

_HALF = ((0.5,) * 3, (0.5,) * 3)
_OPENAI = (0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711)
_IMAGENET = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
_UNCHANGED = ((0.0,) * 3, (1.0,) * 3)
_UNUSED = ("mask_token", "logit_scale", "logit_bias", "temperature")


class Family(NamedTuple):
    """Properties of an architecture.

    colors, filter, stretch: of published preprocessing, see Preprocessing. fixed_length: texts are padded to the
    longest that the model reads and lower-cased, both as in its training, and there is no attention mask.
    patches: the model takes a list of patches instead of an image (NaFlex). dense: see DensePatchEncoder.
    """

    class_name: str
    colors: tuple[tuple[float, ...], tuple[float, ...]]
    filter: str = "bicubic"
    stretch: bool = False
    texts: bool = True
    fixed_length: bool = False
    patches: bool = False
    dense: bool = False


FAMILIES = {
    "clip": Family("CLIPModel", _OPENAI),
    "metaclip_2": Family("MetaClip2Model", _OPENAI),
    "siglip": Family("SiglipModel", _HALF, stretch=True, fixed_length=True),
    "siglip2": Family("Siglip2Model", _HALF, "bilinear", fixed_length=True, patches=True),
    "dinov2": Family("Dinov2Model", _IMAGENET, texts=False),
    "dinov3_vit": Family("DINOv3ViTModel", _IMAGENET, "bilinear", stretch=True, texts=False),
    "tipsv2": Family("Tipsv2Model", _UNCHANGED, "bilinear", stretch=True, dense=True),
}
"""Families by model_type of config.json. SigLIP 2 at a fixed resolution is "siglip", its NaFlex "siglip2".

Source: Radford et al. 2021; Chuang et al. 2025 (MetaCLIP 2); Zhai et al. 2023; Tschannen et al. 2025 (text lower-cased,
64 tokens); Oquab et al. 2024; Siméoni et al. 2025 (DINOv3); Cao et al. 2026 (TIPSv2); the preprocessor_config.json that
each was published with.
"""


class TransformersEncoder(TorchEncoder):
    """Model of transformers; see TorchEncoder. An image's vector is the model's own (pooled) output."""

    def __init__(self, name: str, folder: Path, device: str = "auto", dtype: str = "auto") -> None:
        """Load the model. Raises: as `load_encoder`, except for the hub's errors."""
        self._family, self._folder, files = family_of(name, folder), folder, weight_files(folder)
        models_library()
        device = chosen_device(device)
        dtype = chosen_dtype(dtype, device)
        self._model = _model(self._family.class_name, folder, files).to(device)
        self._cast_vision(dtype)
        preprocessing = self._read_preprocessing()
        dim = getattr(self._model.config, "projection_dim", None) or self._vision.hidden_size
        super().__init__(
            EncoderIdentity(name, dim, weights_hash(files), str(preprocessing)), preprocessing, device, dtype
        )
        self._tokenizer: Any = None

    @property
    def _vision(self) -> Any:
        return getattr(self._model.config, "vision_config", self._model.config)

    def _read_preprocessing(self) -> Preprocessing:
        """Return the preprocessing. Raises: FormatError: the model does not take images of that size."""
        published = _published(self._family, self._vision)
        if self._family.class_name == "CLIPModel":
            published = open_clip_preprocessing(self._folder, published)
        preprocessing = read_preprocessing(self._folder, published)
        if self._family.dense:  # its patches lie on all of the photo
            preprocessing = replace(preprocessing, stretch=True)
        side, patch, kind = preprocessing.side, self._vision.patch_size, self._family
        fixed = self._vision.image_size if kind.texts and not (kind.patches or kind.dense) else None
        if side % patch or fixed not in (None, side):
            raise FormatError(
                f"{self._folder}: its images are scaled to {side} pixels, the model expects "
                f"{fixed or f'a multiple of {patch}'}: take config and preprocessing of one model"
            )
        return preprocessing

    def _features(self, values: Any) -> np.ndarray:
        inputs = self._patches(values) if self._family.patches else {"pixel_values": values}
        output = (self._model.get_image_features if self._family.texts else self._model)(**inputs)
        return as_rows(output.pooler_output)

    def _cast_vision(self, dtype: str) -> None:
        """Cast the vision weights once: autocast would do it for every batch, a tenth of the time."""
        parts = ("vision_model", "visual_projection") if self._family.texts else ()
        for part in [getattr(self._model, name, None) for name in parts] or [self._model]:
            if part is not None:
                part.to(getattr(import_module("torch"), dtype))

    def _patches(self, values: Any) -> dict[str, Any]:
        """Cut (b, 3, s, s) into squares, row by row; within a square by row, column, channel."""
        torch, size = import_module("torch"), self._vision.patch_size
        count, along = len(values), values.shape[-1] // size
        cut = values.reshape(count, 3, along, size, along, size).permute(0, 2, 4, 3, 5, 1)
        return {
            "pixel_values": cut.reshape(count, along * along, -1),
            "pixel_attention_mask": torch.ones(count, along * along, dtype=torch.int32, device=values.device),
            "spatial_shapes": torch.full((count, 2), along, device=values.device),
        }

    def _check_texts(self, texts: Sequence[str]) -> None:
        if not self._family.texts:
            raise InputError(
                f"{self.identity.name} sees images only and knows no words: query with an image of what you look for, "
                "or with the embedding of a mask of the scene (a self-referencing query)"
            )
        super()._check_texts(texts)

    def _text_rows(self, texts: Sequence[str]) -> np.ndarray:
        inputs = {name: value.to(self.device) for name, value in self._tokens(texts).items()}
        with import_module("torch").inference_mode():
            return as_rows(self._model.get_text_features(**inputs).pooler_output)

    def _tokens(self, texts: Sequence[str]) -> dict[str, Any]:
        """Return the model's text inputs. Raises: InputError: a text has more tokens than it reads."""
        self._tokenizer = self._tokenizer or load_tokenizer(self._folder)
        fixed, most = (self._family.fixed_length, self._model.config.text_config.max_position_embeddings)
        texts = [text.lower() for text in texts] if fixed else list(texts)
        self._check_lengths(texts, [len(ids) for ids in self._tokenizer(texts)["input_ids"]], most)
        padded = self._tokenizer(
            texts, padding="max_length" if fixed else True, max_length=most if fixed else None, return_tensors="pt"
        )
        names = ["input_ids"] if fixed else ["input_ids", "attention_mask"]
        return {name: padded[name] for name in names}


def family_of(name: str, folder: Path) -> Family:
    """Return the family of the folder's architecture. Raises: InputError: it is no encoder."""
    kind = model_type(folder)
    if kind not in FAMILIES:
        raise InputError(
            f"{name}: its architecture is '{kind}', not an encoder that drsplat knows ({', '.join(FAMILIES)})"
        )
    return FAMILIES[kind]


def _model(class_name: str, folder: Path, files: list[Path]) -> Any:
    if files[0].name == OPEN_CLIP:
        return load_open_clip(folder)
    return load_model(class_name, folder, _UNUSED)


def _published(family: Family, vision: Any) -> Preprocessing:
    """Return the published preprocessing, for folders without a file of it."""
    side = vision.patch_size * isqrt(vision.num_patches) if family.patches else vision.image_size
    side = side if family.texts else 224  # DINOv2's config has the side of its last training, 518
    mean, std = family.colors
    return Preprocessing(side, family.filter, tuple(mean), tuple(std), stretch=family.stretch)  # type: ignore[arg-type]
