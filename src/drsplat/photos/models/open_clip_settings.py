"""open_clip_config.json: the settings of a CLIP and its preprocessing, in the words of transformers.

OpenCLIP's `save_for_hf` writes this and no config.json, so many models of the hub have only this.

Source: OpenCLIP 3.3, model.py (settings and their defaults), transformer.py (pooling), transform.py,
push_to_hf_hub.py; read for these facts.
"""

from pathlib import Path
from typing import Any

from ...errors import FormatError, InputError
from ...formats.json_files import as_count, as_number, as_object, excerpt, read_json
from .preprocessing import Preprocessing, preprocessing_of
from .pretrained import OPEN_CLIP_CONFIG

_MODEL = {"quick_gelu": False}
_VISION = {"image_size": 224, "layers": 12, "width": 768, "head_width": 64, "patch_size": 16}
_TEXT = {"context_length": 77, "vocab_size": 49408, "width": 512, "heads": 8, "layers": 12}
_BOTH = {"mlp_ratio": 4.0}
_WITHOUT_EFFECT = {
    "embed_dim", "vision_cfg", "text_cfg", "custom_text", "init_logit_scale", "hf_tokenizer_name",
    "patch_dropout", "attn_pooler_queries", "attn_pooler_heads", "pad_id", "eos_id",
    "timm_model_pretrained", "timm_pool", "timm_proj", "timm_drop", "hf_model_pretrained",
}  # fmt: skip
"""Settings that do not change the result: read elsewhere, for training, or of parts that others switch on."""
_PLAIN = ("pool_type", "tok"), ("pool_type", "argmax"), ("pos_embed_type", "learnable"),\
    ("proj_type", "linear"), ("block_type", "default")  # fmt: skip


def config_arguments(path: Path) -> dict[str, Any]:
    """Return open_clip_config.json as the arguments of CLIPConfig.

    OpenCLIP takes the text's vector at the highest number among its tokens; transformers does so
    for the eos_token_id 2, whatever the vocabulary.
    """
    where = f"{path}: model_cfg"
    settings = _part(path, "model_cfg")
    model = _with_defaults(settings, _MODEL, where)
    vision = _sizes(settings, "vision_cfg", _VISION, where)
    text = _sizes(settings, "text_cfg", _TEXT, where)
    width = vision["hidden_size"]
    heads = _positive(width // vision.pop("head_width"), f"{where}.vision_cfg: width / head_width")
    act = {"hidden_act": "quick_gelu" if model["quick_gelu"] else "gelu"}
    dim = _positive(settings.get("embed_dim"), f"{where}.embed_dim")
    legacy = {"bos_token_id": 0, "pad_token_id": 1, "eos_token_id": 2}
    return {
        "projection_dim": dim,
        "vision_config": {**vision, **act, "num_attention_heads": heads, "projection_dim": dim},
        "text_config": {**text, **act, **legacy, "projection_dim": dim},
    }


def embedding_size(path: Path) -> int:
    """Return the dimension of embeddings, from open_clip_config.json. Raises: FormatError."""
    model = _part(path, "model_cfg")
    return _positive(model.get("embed_dim"), f"{path}: model_cfg.embed_dim")


def _sizes(model: dict[str, Any], part: str, defaults: dict[str, int], where: str) -> dict[str, int]:
    """Return the sizes of one tower under the names of transformers."""
    where = f"{where}.{part}"
    settings = _with_defaults(as_object(model.get(part) or {}, f"{where}: {part}"), defaults | _BOTH, where)
    ratio = as_number(settings.pop("mlp_ratio"), f"{where}.mlp_ratio")
    names = {"width": "hidden_size", "layers": "num_hidden_layers", "heads": "num_attention_heads",
             "context_length": "max_position_embeddings"}  # fmt: skip
    sizes = {names.get(name, name): _positive(_side(settings[name]), f"{where}.{name}") for name in defaults}
    return {**sizes, "intermediate_size": int(sizes["hidden_size"] * ratio)}


def _with_defaults(settings: dict[str, Any], defaults: dict[str, Any], where: str) -> dict[str, Any]:
    """Return the known settings, with defaults. Raises: InputError: one that changes the result in an unknown way."""
    for name, value in settings.items():
        harmless = name in _WITHOUT_EFFECT or not value or (name, value) in _PLAIN
        if name not in defaults and not harmless:
            raise InputError(
                f"{where}.{name}: {excerpt(value)} makes a model that transformers' CLIP is not: put open_clip: before "
                "its name, which loads it by open_clip's own library, or choose a plain CLIP with a ViT"
            )
    return defaults | {name: settings[name] for name in defaults if name in settings}


def open_clip_preprocessing(folder: Path, default: Preprocessing) -> Preprocessing:
    """Return the preprocessing of open_clip_config.json, completed by the default; the default without the file.

    Raises: InputError: a way to scale images that is not ours. FormatError: it is damaged.
    """
    path = folder / OPEN_CLIP_CONFIG
    if not path.is_file():
        return default
    settings = _part(path, "preprocess_cfg")
    fit, interpolation = settings.get("resize_mode", "shortest"), settings.get("interpolation", "bicubic")
    if fit not in ("shortest", "squash") or interpolation not in ("bicubic", "bilinear"):
        raise InputError(
            f"{path}: images are scaled by resize_mode {excerpt(fit)}, interpolation {excerpt(interpolation)}; "
            "drsplat knows shortest and squash, bicubic and bilinear"
        )
    names = {"mean": "image_mean", "std": "image_std"}
    renamed = {new: settings[old] for old, new in names.items() if settings.get(old) is not None}
    side = _side(settings.get("size") or default.side)
    renamed |= {"size": side, "resample": interpolation, "do_center_crop": fit == "shortest"}
    return preprocessing_of(renamed, path, default)


def _part(path: Path, name: str) -> dict[str, Any]:
    """Return one of the objects in open_clip_config.json, {} without it."""
    return as_object(as_object(read_json(path), str(path)).get(name) or {}, f"{path}: {name}")


def _side(value: object) -> object:
    """Return the one number of a list that repeats it for height and width; other values as they are."""
    twice = isinstance(value, list) and len(value) in (1, 2) and value[0] == value[-1]
    return value[0] if twice else value  # type: ignore[index]


def _positive(value: object, where: str) -> int:
    count = as_count(value, where)
    if count < 1:
        raise FormatError(f"{where}: expected a positive number, got {count}")
    return count
