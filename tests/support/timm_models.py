"""Models whose image encoders are timm's, each in a process alone: python timm_models.py edgetam | open_clip

timm imports torchvision; where that is not installed there is a stand-in, so that no other test may share the process.
"""

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.testing import assert_allclose, assert_array_equal
from test_sam import DECODER, IMAGE, LOOSE, PROMPTS, fill, test_answers_are_those_of_the_bare_model

from drsplat.photos.models.loading import load_encoder
from drsplat.photos.models.sam import load_segmenter
from torchvision_standin import install_where_absent

REPVIT = {
    "model_type": "timm_wrapper", "architecture": "repvit_m1", "num_classes": 2, "label_names": ["a", "b"],
    "model_args": {
        "in_chans": 3, "features_only": True, "out_indices": [0, 1, 2, 3], "embed_dim": [8, 16, 32, 64],
        "depth": [1, 1, 1, 1],
    },
}  # fmt: skip
EDGETAM = {
    "vision_config": {
        "model_type": "edgetam_vision_model", "backbone_config": REPVIT, "backbone_channel_list": [64, 32, 16, 8],
        "backbone_feature_sizes": [[16, 16], [8, 8], [4, 4]], "fpn_hidden_size": 16,
    },
    "prompt_encoder_config": {**PROMPTS, "patch_size": 16},
    "mask_decoder_config": DECODER,
}  # fmt: skip
TEXTS = ["a red mug", "the table", "mug"]


def edgetam(folder: Path) -> None:
    """Masks are those of the bare model, one point at a time, on an image that fills the square."""
    import transformers

    transformers.utils.logging.disable_progress_bar()
    model = transformers.EdgeTamModel(transformers.EdgeTamConfig(**EDGETAM)).eval()
    fill(model, 0)
    model.save_pretrained(folder)
    segmenter = load_segmenter(str(folder), "cpu", LOOSE)
    assert segmenter.identity["architecture"] == "EdgeTamModel"
    assert len(segmenter.segment(IMAGE)["default"]) >= 20
    test_answers_are_those_of_the_bare_model(folder, transformers)


def open_clip(folder: Path) -> None:
    """Embeddings are those of the library's own calls, images scaled by hand."""
    import open_clip as library
    from safetensors.torch import save_file

    vision = {"timm_model_name": "test_vit", "timm_model_pretrained": False, "timm_pool": "map", "timm_proj": None,
              "image_size": 32}  # fmt: skip
    text = {"context_length": 12, "vocab_size": 49408, "width": 16, "heads": 2, "layers": 1, "no_causal_mask": True}
    settings: dict[str, Any] = {
        "model_cfg": {"embed_dim": 64, "vision_cfg": vision, "text_cfg": text, "custom_text": True},
        "preprocess_cfg": {"mean": [0.5] * 3, "std": [0.5] * 3, "interpolation": "bilinear", "resize_mode": "squash"},
    }
    (folder / "open_clip_config.json").write_text(json.dumps(settings))
    torch.manual_seed(0)
    model = library.create_model(f"local-dir:{folder}", load_weights=False, pretrained_text=False).eval()
    with torch.no_grad():
        for weight in model.parameters():
            weight.add_(0.1 * torch.randn(weight.shape))
    save_file(
        {name: tensor.contiguous() for name, tensor in model.state_dict().items()},
        folder / "open_clip_model.safetensors",
    )
    (folder / "open_clip_pytorch_model.bin").write_bytes(b"never read")
    encoder: Any = load_encoder(f"open_clip:{folder}", "cpu", "float32")
    assert str(encoder.preprocessing).startswith("32 px bilinear stretched")
    images = [np.random.default_rng(seed).integers(0, 256, (32, 32, 3), np.uint8) for seed in range(3)]
    pixels = torch.tensor(np.stack(images).transpose(0, 3, 1, 2) / 127.5 - 1).float()
    with torch.no_grad():
        by_hand = model.encode_image(pixels, normalize=True).numpy()
        words = model.encode_text(library.tokenize(TEXTS, 12), normalize=True).numpy()
    assert_allclose(encoder.encode_images(images), by_hand, atol=2e-6)
    assert_allclose(encoder.encode_texts(TEXTS), words, atol=2e-6)
    assert np.abs(words[0] - words[1]).max() > 1e-3
    half = load_encoder(f"open_clip:{folder}", "cpu", "bfloat16")
    assert 0 < np.abs(half.encode_images(images) - by_hand).max() < 0.03
    assert_array_equal(half.encode_texts(TEXTS), encoder.encode_texts(TEXTS))


if __name__ == "__main__":
    torch.set_num_threads(1)
    install_where_absent()
    with tempfile.TemporaryDirectory() as made:
        {"edgetam": edgetam, "open_clip": open_clip}[sys.argv[1]](Path(made))
