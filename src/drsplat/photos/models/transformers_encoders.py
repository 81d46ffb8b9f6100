"""CLIP, MetaCLIP 2, SigLIP, SigLIP 2, DINOv2, DINOv3 and TIPSv2 of transformers as encoders.

Source: OpenCLIP 3.3, transformer.py and model.py (names and shapes), push_to_hf_hub.py (names of files); read for
these facts.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib import import_module
from math import isqrt
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...errors import FormatError, InputError
from ...formats.json_files import excerpt
from .devices import chosen_device, chosen_dtype
from .libraries import model_class
from .open_clip_settings import config_arguments, open_clip_preprocessing
from .preprocessing import HALF, IMAGENET, OPENAI, Colors, Preprocessing, read_preprocessing
from .pretrained import OPEN_CLIP, OPEN_CLIP_CONFIG, load_model, load_tokenizer, model_errors, model_type, weight_files
from .torch_encoder import TorchEncoder, as_rows

_UNUSED = ("mask_token", "logit_scale", "logit_bias", "temperature")


class Family(NamedTuple):
    """Properties of an architecture.

    colors, filter, stretch: of published preprocessing, see Preprocessing. fixed_length: texts are padded to the
    longest that the model reads and lower-cased, both as in its training, and there is no attention mask.
    patches: the model takes a list of patches instead of an image (NaFlex). dense: see DensePatchEncoder.
    """

    class_name: str
    colors: Colors
    filter: str = "bicubic"
    stretch: bool = False
    texts: bool = True
    fixed_length: bool = False
    patches: bool = False
    dense: bool = False


FAMILIES = {
    "clip": Family("CLIPModel", OPENAI),
    "metaclip_2": Family("MetaClip2Model", OPENAI),
    "siglip": Family("SiglipModel", HALF, stretch=True, fixed_length=True),
    "siglip2": Family("Siglip2Model", HALF, "bilinear", fixed_length=True, patches=True),
    "dinov2": Family("Dinov2Model", IMAGENET, texts=False),
    "dinov3_vit": Family("DINOv3ViTModel", IMAGENET, "bilinear", stretch=True, texts=False),
    "tipsv2": Family("Tipsv2Model", ((0.0,) * 3, (1.0,) * 3), "bilinear", stretch=True, dense=True),
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
        device = chosen_device(device)
        dtype = chosen_dtype(dtype, device)
        by_open_clip = files[0].name == OPEN_CLIP
        model = load_open_clip(folder) if by_open_clip else load_model(self._family.class_name, folder, _UNUSED)
        self._model = model.to(device)
        # cast the vision weights once: autocast would do it for every batch, a tenth of the time
        parts = ("vision_model", "visual_projection") if self._family.texts else ()
        for part in [getattr(self._model, name, None) for name in parts] or [self._model]:
            if part is not None:
                part.to(getattr(import_module("torch"), dtype))
        preprocessing = self._read_preprocessing()
        dim = getattr(self._model.config, "projection_dim", None) or self._vision.hidden_size
        super().__init__(name, dim, files, preprocessing, device, dtype)
        self._tokenizer: Any = None

    @property
    def _vision(self) -> Any:
        return getattr(self._model.config, "vision_config", self._model.config)

    def _read_preprocessing(self) -> Preprocessing:
        """Return the preprocessing. Raises: FormatError: the model does not take images of that size."""
        kind, vision = self._family, self._vision
        side = vision.patch_size * isqrt(vision.num_patches) if kind.patches else vision.image_size
        side = side if kind.texts else 224  # DINOv2's config has the side of its last training, 518
        published = Preprocessing(side, kind.filter, *kind.colors, stretch=kind.stretch)
        if kind.class_name == "CLIPModel":
            published = open_clip_preprocessing(self._folder, published)
        preprocessing = read_preprocessing(self._folder, published)
        if kind.dense:  # its patches lie on all of the photo
            preprocessing = replace(preprocessing, stretch=True)
        side, patch = preprocessing.side, vision.patch_size
        fixed = vision.image_size if kind.texts and not (kind.patches or kind.dense) else None
        if side % patch or fixed not in (None, side):
            raise FormatError(
                f"{self._folder}: its images are scaled to {side} pixels, the model expects "
                f"{fixed or f'a multiple of {patch}'}: take config and preprocessing of one model"
            )
        return preprocessing

    def _features(self, values: Any) -> np.ndarray:
        inputs, size = {"pixel_values": values}, self._vision.patch_size
        if self._family.patches:  # squares, row by row; within a square by row, column, channel
            torch, count, along = import_module("torch"), len(values), values.shape[-1] // size
            cut = values.reshape(count, 3, along, size, along, size).permute(0, 2, 4, 3, 5, 1)
            inputs = {
                "pixel_values": cut.reshape(count, along * along, -1),
                "pixel_attention_mask": torch.ones(count, along * along, dtype=torch.int32, device=values.device),
                "spatial_shapes": torch.full((count, 2), along, device=values.device),
            }
        output = (self._model.get_image_features if self._family.texts else self._model)(**inputs)
        return as_rows(output.pooler_output)

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
        lengths = [len(ids) for ids in self._tokenizer(texts)["input_ids"]]
        if max(lengths) > most:
            text = texts[int(np.argmax(lengths))]
            raise InputError(f"{text[:60]!r} has {max(lengths)} tokens, {self.identity.name} reads {most}: shorten it")
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


class Tensor(NamedTuple):
    """Tensor of OpenCLIP.

    targets: its names in transformers; several for equal parts along the first axis. transposed: in transformers.
    """

    name: str
    shape: tuple[int, ...]
    targets: tuple[str, ...]
    transposed: bool = False


def load_open_clip(folder: Path) -> Any:
    """Load open_clip_model.safetensors as the CLIPModel of transformers, in float32.

    Its settings are those of config.json, or of open_clip_config.json if there is none.

    Raises: InputError: config.json is of another architecture, or open_clip_config.json asks for
    what CLIPModel does not do. FormatError: settings that are no model, or a tensor that is missing,
    left over or of another shape; it is named.
    """
    if model_type(folder) != "clip":
        raise InputError(
            f"{folder}: {OPEN_CLIP} is read as a CLIP, and config.json says '{model_type(folder)}': "
            "give a folder with model.safetensors as transformers saves it"
        )
    kind = model_class("CLIPConfig")
    has_config = (folder / "config.json").is_file()
    settings = {} if has_config else config_arguments(folder / OPEN_CLIP_CONFIG)
    with model_errors(folder, "CLIPConfig"):
        config = kind.from_pretrained(str(folder), local_files_only=True) if has_config else kind(**settings)
    weights = import_module("safetensors.torch").load_file(folder / OPEN_CLIP)
    state = renamed(weights, config, str(folder / OPEN_CLIP))
    return load_model("CLIPModel", folder, config=config, state_dict=state)


def renamed(weights: dict[str, Any], config: Any, where: str) -> dict[str, Any]:
    """Rename tensors for transformers. Raises: FormatError: as `load_open_clip`."""
    # remove the prefix "text." of models whose text tower is a part of its own (custom_text)
    plain = {name: name.removeprefix("text.") for name in weights}
    left = {
        name if plain[name] != name and plain[name] in weights else plain[name]: tensor
        for name, tensor in weights.items()
    }
    state: dict[str, Any] = {}
    for wanted in tensors(config):
        tensor = left.pop(wanted.name, None)
        if tensor is None:
            raise FormatError(
                f"{where}: lacks the tensor '{wanted.name}' of a CLIP of these settings: the weights are of "
                "another model than the settings say, or no CLIP with a ViT"
            )
        if tuple(tensor.shape) != wanted.shape or not tensor.is_floating_point():
            raise FormatError(
                f"{where}: '{wanted.name}': expected floats of shape {wanted.shape}, got {tensor.dtype} of "
                f"shape {tuple(tensor.shape)}: the weights are of another model than the settings say"
            )
        tensor = (tensor.T if wanted.transposed else tensor).float()
        parts = tensor.chunk(len(wanted.targets)) if len(wanted.targets) > 1 else [tensor]
        state.update(zip(wanted.targets, (part.contiguous() for part in parts), strict=True))
    if left:
        raise FormatError(
            f"{where}: has {len(left)} tensors that a CLIP of these settings has not, first "
            f"'{min(left)}': the weights are of another model than the settings say"
        )
    return state


def tensors(config: Any) -> Iterator[Tensor]:
    """Yield all tensors of a CLIP of these settings, lazily: settings from strangers must not fill a list."""
    vision, text, dim = config.vision_config, config.text_config, config.projection_dim
    width, side, words = vision.hidden_size, vision.patch_size, text.hidden_size
    if not all(isinstance(n, int) and n > 0 for n in (side, vision.image_size)):
        raise FormatError(
            "vision_config: expected one number each as image_size and patch_size, got "
            f"{excerpt(vision.image_size)} and {excerpt(side)}"
        )
    vision_embeddings = "vision_model.embeddings."
    places = (vision.image_size // side) ** 2 + 1
    yield Tensor("logit_scale", (), ("logit_scale",))
    yield Tensor("visual.class_embedding", (width,), (vision_embeddings + "class_embedding",))
    yield Tensor("visual.conv1.weight", (width, 3, side, side), (vision_embeddings + "patch_embedding.weight",))
    yield Tensor("visual.positional_embedding", (places, width), (vision_embeddings + "position_embedding.weight",))
    yield from _linear("visual.ln_pre", "vision_model.pre_layrnorm", width)
    yield from _layers("visual.", "vision_model.", vision)
    yield from _linear("visual.ln_post", "vision_model.post_layernorm", width)
    yield Tensor("visual.proj", (width, dim), ("visual_projection.weight",), True)
    texts = "text_model.embeddings."
    yield Tensor("token_embedding.weight", (text.vocab_size, words), (texts + "token_embedding.weight",))
    yield Tensor("positional_embedding", (text.max_position_embeddings, words), (texts + "position_embedding.weight",))
    yield from _layers("", "text_model.", text)
    yield from _linear("ln_final", "text_model.final_layer_norm", words)
    yield Tensor("text_projection", (words, dim), ("text_projection.weight",), True)


def _layers(ours: str, theirs: str, tower: Any) -> Iterator[Tensor]:
    wide, inner = tower.hidden_size, tower.intermediate_size
    for number in range(tower.num_hidden_layers):
        a, b = f"{ours}transformer.resblocks.{number}.", f"{theirs}encoder.layers.{number}."
        yield from _linear(a + "ln_1", b + "layer_norm1", wide)
        for end, shape in (("weight", (3 * wide, wide)), ("bias", (3 * wide,))):
            parts = tuple(f"{b}self_attn.{part}_proj.{end}" for part in "qkv")
            yield Tensor(f"{a}attn.in_proj_{end}", shape, parts)
        yield from _linear(a + "attn.out_proj", b + "self_attn.out_proj", wide, wide)
        yield from _linear(a + "ln_2", b + "layer_norm2", wide)
        yield from _linear(a + "mlp.c_fc", b + "mlp.fc1", inner, wide)
        yield from _linear(a + "mlp.c_proj", b + "mlp.fc2", wide, inner)


def _linear(ours: str, theirs: str, *shape: int) -> Iterator[Tensor]:
    yield Tensor(ours + ".weight", shape, (theirs + ".weight",))
    yield Tensor(ours + ".bias", shape[:1], (theirs + ".bias",))
