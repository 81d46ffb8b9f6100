"""CLIP from weights under OpenCLIP's names, as the CLIPModel of transformers.

Source: OpenCLIP 3.3, transformer.py and model.py (names and shapes), push_to_hf_hub.py (names of
files); read for these facts.
"""

from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from ...errors import FormatError, InputError
from ...formats.json_files import excerpt
from .libraries import model_class
from .open_clip_settings import config_arguments
from .pretrained import load_model, model_errors, model_type
from .weight_names import OPEN_CLIP, OPEN_CLIP_CONFIG


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
    config = _config(folder)
    weights = import_module("safetensors.torch").load_file(folder / OPEN_CLIP)
    state = renamed(weights, config, str(folder / OPEN_CLIP))
    return load_model("CLIPModel", folder, config=config, state_dict=state)


def renamed(weights: dict[str, Any], config: Any, where: str) -> dict[str, Any]:
    """Rename tensors for transformers. Raises: FormatError: as `load_open_clip`."""
    left = _without_prefix(weights)
    state: dict[str, Any] = {}
    for wanted in tensors(config):
        tensor = left.pop(wanted.name, None)
        _check(tensor, wanted, where)
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


def _config(folder: Path) -> Any:
    kind = model_class("CLIPConfig")
    if (folder / "config.json").is_file():
        with model_errors(folder, "CLIPConfig"):
            return kind.from_pretrained(str(folder), local_files_only=True)
    settings = config_arguments(folder / OPEN_CLIP_CONFIG)
    with model_errors(folder, "CLIPConfig"):
        return kind(**settings)


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


def _without_prefix(weights: dict[str, Any]) -> dict[str, Any]:
    """Remove the prefix "text." of models whose text tower is a part of its own (custom_text)."""
    plain = {name: name.removeprefix("text.") for name in weights}
    return {
        name if plain[name] != name and plain[name] in weights else plain[name]: tensor
        for name, tensor in weights.items()
    }


def _check(tensor: Any, wanted: Tensor, where: str) -> None:
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
