"""Folders of tiny models with random weights, as `save_pretrained` writes the published ones."""

import json
from pathlib import Path
from typing import Any

SIDE, PATCH, TOKENS = 32, 8, 12
WORDS = ("a", "red", "blue", "mug", "on", "the", "table")
_SIZES = {"hidden_size": 16, "intermediate_size": 32, "num_hidden_layers": 2, "num_attention_heads": 2}
_TEXT = {"vocab_size": 64, "max_position_embeddings": TOKENS, "bos_token_id": 0, "eos_token_id": 1, **_SIZES}
_VISION = {"patch_size": PATCH, "image_size": SIDE, **_SIZES}
_CLIP = {"text_config": _TEXT, "vision_config": _VISION, "projection_dim": 8}
_DINO = {"image_size": 42, "patch_size": 14, "hidden_size": 16, "num_hidden_layers": 2, "num_attention_heads": 2}
CONFIGS: dict[str, tuple[str, dict[str, Any]]] = {
    "clip": ("CLIPConfig", _CLIP), "metaclip_2": ("MetaClip2Config", _CLIP),
    "siglip": ("SiglipConfig", {"text_config": _TEXT, "vision_config": _VISION}),
    "siglip2": (
        "Siglip2Config",
        {"text_config": _TEXT, "vision_config": {"patch_size": PATCH, "num_patches": (SIDE // PATCH) ** 2, **_SIZES}},
    ),
    "dinov2": ("Dinov2Config", {**_DINO, "mlp_ratio": 2}),
    "dinov3_vit": ("DINOv3ViTConfig", {**_DINO, "intermediate_size": 32, "num_register_tokens": 2}),
    "tipsv2": (
        "Tipsv2Config",
        {
            "text_config": {name: size for name, size in _TEXT.items() if name not in ("bos_token_id", "eos_token_id")},
            "vision_config": {**_DINO, "image_size": SIDE, "patch_size": PATCH, "mlp_ratio": 2},
        },
    ),
}  # fmt: skip


def write_model(folder: Path, kind: str, seed: int = 0, dim: int | None = None, tokens: int = TOKENS) -> Path:
    """A model and its tokenizer; the preprocessing is left to the published one. dim: of a clip's vectors.

    tokens: that it reads; letters are tokens where a word is none of WORDS.
    """
    import torch
    import transformers

    torch.manual_seed(seed)
    transformers.utils.logging.disable_progress_bar()
    name, sizes = CONFIGS[kind]
    settings = getattr(transformers, name)(**sizes)
    if dim is not None:
        settings.projection_dim = dim
    texts = hasattr(settings, "text_config")
    if texts:
        settings.text_config.max_position_embeddings = tokens
    model = transformers.AutoModel.from_config(settings)
    with torch.no_grad():  # as in training: fresh ones are so small that all texts look alike
        for weight in model.parameters():
            weight.add_(0.2 * torch.randn(weight.shape))
    model.save_pretrained(folder)
    if kind in ("clip", "metaclip_2"):
        write_clip_tokenizer(folder)
    elif texts:
        write_word_tokenizer(folder)
    return folder


def write_clip_tokenizer(folder: Path) -> None:
    """vocab.json and merges.txt in CLIP's layout: every word of WORDS is one token."""
    letters = sorted(set("".join(WORDS)))
    vocab = ["<|startoftext|>", "<|endoftext|>", *letters, *(f"{c}</w>" for c in letters)]
    merges = ["#version: 0.2"]
    for word in WORDS:
        so_far = word[0]
        for place, letter in enumerate(word[1:], 2):
            after = letter + ("</w>" if place == len(word) else "")
            merges.append(f"{so_far} {after}")
            so_far += after
            vocab.append(so_far)
    vocab = list(dict.fromkeys(vocab))
    ids = {token: number for number, token in enumerate(vocab)}
    (folder / "vocab.json").write_text(json.dumps(ids))
    (folder / "merges.txt").write_text("\n".join(dict.fromkeys(merges)) + "\n")
    (folder / "tokenizer_config.json").write_text(json.dumps({"tokenizer_class": "CLIPTokenizer"}))


def write_word_tokenizer(folder: Path) -> None:
    """Whole words, in lower case only."""
    from tokenizers import Tokenizer, models, pre_tokenizers
    from transformers import PreTrainedTokenizerFast

    tokens = ["<pad>", "</s>", "<unk>", *WORDS]
    words = Tokenizer(models.WordLevel({t: i for i, t in enumerate(tokens)}, unk_token="<unk>"))
    words.pre_tokenizer = pre_tokenizers.Whitespace()
    PreTrainedTokenizerFast(
        tokenizer_object=words, pad_token="<pad>", eos_token="</s>", unk_token="<unk>"
    ).save_pretrained(folder)
