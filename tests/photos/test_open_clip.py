"""CLIP under OpenCLIP's names against the same model as transformers saves it."""

import json
import re
import shutil
from collections.abc import Callable
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drsplat.errors import FormatError, InputError
from drsplat.photos.models import pretrained, transformers_encoders
from drsplat.photos.models.loading import DEFAULT_ENCODER, load_encoder
from refusing import malformed, refused
from tiny_encoders import PATCH, SIDE, TOKENS, write_clip_tokenizer, write_model

torch = pytest.importorskip("torch", reason="needs torch")
transformers = pytest.importorskip("transformers", reason="needs transformers")
hub = pytest.importorskip("huggingface_hub", reason="comes with transformers")
torch.set_num_threads(1)

IMAGES = [
    np.random.default_rng(seed).integers(0, 256, (*size, 3), np.uint8)
    for seed, size in enumerate(((32, 32), (20, 50), (3, 3)))
]
TEXTS = ["a red mug", "the table", "mug", "a blue mug on the table"]
WIDE, HEADS = 128, 4  # of the text; the image's two heads follow from 64 numbers per head


def as_open_clip(model: Any) -> dict[str, Any]:
    """The inverse of what is tested, written out."""
    theirs = model.state_dict()
    seen, read = "vision_model.embeddings.", "text_model.embeddings."
    ours = {
        "logit_scale": theirs["logit_scale"],
        "visual.class_embedding": theirs[seen + "class_embedding"],
        "visual.positional_embedding": theirs[seen + "position_embedding.weight"],
        "visual.proj": theirs["visual_projection.weight"].T,
        "visual.conv1.weight": theirs[seen + "patch_embedding.weight"],
        "token_embedding.weight": theirs[read + "token_embedding.weight"],
        "positional_embedding": theirs[read + "position_embedding.weight"],
        "text_projection": theirs["text_projection.weight"].T,
    }
    for end in ("weight", "bias"):
        ours[f"visual.ln_pre.{end}"] = theirs[f"vision_model.pre_layrnorm.{end}"]
        ours[f"visual.ln_post.{end}"] = theirs[f"vision_model.post_layernorm.{end}"]
        ours[f"ln_final.{end}"] = theirs[f"text_model.final_layer_norm.{end}"]
        for tower, name, config in (
            ("visual.", "vision_model", model.config.vision_config),
            ("", "text_model", model.config.text_config),
        ):
            for number in range(config.num_hidden_layers):
                block = f"{tower}transformer.resblocks.{number}"
                layer = f"{name}.encoder.layers.{number}"
                parts = [theirs[f"{layer}.self_attn.{part}_proj.{end}"] for part in ("q", "k", "v")]
                ours[f"{block}.attn.in_proj_{end}"] = torch.cat(parts)
                for new, old in (
                    ("attn.out_proj", "self_attn.out_proj"),
                    ("ln_1", "layer_norm1"),
                    ("ln_2", "layer_norm2"),
                    ("mlp.c_fc", "mlp.fc1"),
                    ("mlp.c_proj", "mlp.fc2"),
                ):
                    ours[f"{block}.{new}.{end}"] = theirs[f"{layer}.{old}.{end}"]
    assert sum(tensor.numel() for tensor in ours.values()) == sum(tensor.numel() for tensor in theirs.values())
    return {name: tensor.contiguous() for name, tensor in ours.items()}


def save(folder: Path, tensors: dict[str, Any]) -> None:
    from safetensors.torch import save_file

    save_file(tensors, folder / "open_clip_model.safetensors")


def with_text_prefix(tensors: dict[str, Any]) -> dict[str, Any]:
    """As CustomTextCLIP has them."""
    outside = ("visual.", "logit_scale")
    return {n if n.startswith(outside) else f"text.{n}": t for n, t in tensors.items()}


def highest_is_the_end(folder: Path) -> int:
    """A tokenizer with the end of a text as its highest number, as CLIP's; how many tokens it has."""
    write_clip_tokenizer(folder)
    ids = json.loads((folder / "vocab.json").read_text())
    special = ["<|startoftext|>", "<|endoftext|>"]
    tokens = [token for token in ids if token not in special] + special
    numbers = {token: number for number, token in enumerate(tokens)}
    (folder / "vocab.json").write_text(json.dumps(numbers))
    return len(tokens)


def written_directly(folder: Path, act: str) -> Any:
    """A model of transformers with an end of texts that it is told, and its tokenizer."""
    folder.mkdir()
    count = highest_is_the_end(folder)
    sizes = {"hidden_size": WIDE, "intermediate_size": 4 * WIDE, "num_hidden_layers": 2}
    text = {"vocab_size": count, "max_position_embeddings": TOKENS, "num_attention_heads": HEADS}
    vision = {"patch_size": PATCH, "image_size": SIDE, "num_attention_heads": 2}
    torch.manual_seed(7)
    config = transformers.CLIPConfig(
        text_config={**text, **sizes, "hidden_act": act, "bos_token_id": count - 2,
                     "eos_token_id": count - 1},
        vision_config={**vision, **sizes, "hidden_act": act}, projection_dim=8,
    )  # fmt: skip
    model = transformers.CLIPModel(config)
    with torch.no_grad():
        for weight in model.parameters():
            weight.add_(0.05 * torch.randn(weight.shape))
    transformers.utils.logging.disable_progress_bar()
    model.save_pretrained(folder)
    return model


def settings_of(tokens: int, **model: Any) -> dict[str, Any]:
    """open_clip_config.json of `written_directly`, with what OpenCLIP leaves out left out."""
    sizes = {"width": WIDE, "layers": 2}
    return {
        "model_cfg": {
            "embed_dim": 8,
            "vision_cfg": {"image_size": SIDE, "patch_size": PATCH, **sizes},
            "text_cfg": {"context_length": TOKENS, "vocab_size": tokens, "heads": HEADS, **sizes},
            **model,
        }
    }


def tiny(folder: Path) -> Any:
    return load_encoder(str(folder), "cpu", "float32")


def rewrite(path: Path, change: Callable[[Any], object]) -> None:
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


def check_same(found: Any, expected: Any) -> None:
    assert_allclose(found.encode_images(IMAGES), expected.encode_images(IMAGES), atol=1e-6)
    rows = expected.encode_texts(TEXTS)
    assert_allclose(found.encode_texts(TEXTS), rows, atol=1e-6)
    assert np.abs(rows[0] - rows[1:]).max(axis=1).min() > 1e-3  # so the wrong token would show


@pytest.fixture(scope="module")
def direct(tmp_path_factory) -> Path:
    return write_model(tmp_path_factory.mktemp("direct") / "direct", "clip")


@pytest.fixture(scope="module")
def tensors(direct) -> dict[str, Any]:
    return as_open_clip(transformers.CLIPModel.from_pretrained(direct).float())


@pytest.fixture
def renamed(direct, tensors, tmp_path) -> Path:
    """A model of transformers with its weights under OpenCLIP's names."""
    folder = Path(shutil.copytree(direct, tmp_path / "renamed"))
    (folder / "model.safetensors").unlink()
    save(folder, tensors)
    return folder


@pytest.fixture(scope="module", params=["gelu", "quick_gelu"])
def pair(request, tmp_path_factory) -> Any:
    """The same model as transformers and as OpenCLIP save it."""
    base = tmp_path_factory.mktemp("pair")
    model = written_directly(base / "direct", request.param)
    own = base / "own"
    own.mkdir()
    count = highest_is_the_end(own)
    flag = {"quick_gelu": True} if request.param == "quick_gelu" else {}
    (own / "open_clip_config.json").write_text(json.dumps(settings_of(count, **flag)))
    save(own, as_open_clip(model))
    return base / "direct", own


@pytest.fixture
def own(pair, tmp_path) -> Path:
    """A folder of OpenCLIP to change."""
    return Path(shutil.copytree(pair[1], tmp_path / "own"))


# --- the same vectors -------------------------------------------------------------------------


def test_same_vectors_beside_config_json(direct, renamed):
    encoder = tiny(renamed)
    check_same(encoder, tiny(direct))
    assert encoder.identity.dim == 8
    assert encoder.identity.weights == pretrained.weights_hash([renamed / "open_clip_model.safetensors"])


def test_same_vectors_where_the_text_tower_has_a_prefix(direct, renamed, tensors):
    save(renamed, with_text_prefix(tensors))
    check_same(tiny(renamed), tiny(direct))


def test_same_vectors_without_config_json(pair):
    """Text of the direct model ends at the number it is told; ours at the highest."""
    check_same(tiny(pair[1]), tiny(pair[0]))


def test_other_heads_or_another_curve_are_other_models(pair, own):
    """Neither can be seen in the weights, so the settings decide; these tests could fail."""
    for change in (
        lambda d: d["model_cfg"].update(quick_gelu=not d["model_cfg"].get("quick_gelu")),
        lambda d: d["model_cfg"]["vision_cfg"].update(head_width=32),
    ):
        shutil.copy(pair[1] / "open_clip_config.json", own)
        rewrite(own / "open_clip_config.json", change)
        rows = tiny(own).encode_images(IMAGES)
        assert np.abs(rows - tiny(pair[0]).encode_images(IMAGES)).max() > 1e-4


def test_half_precision_weights_are_computed_in_single(direct, renamed, tensors):
    save(renamed, {name: tensor.half() for name, tensor in tensors.items()})
    encoder = tiny(renamed)
    assert {weight.dtype for weight in encoder._model.parameters()} == {torch.float32}
    exact = tiny(direct).encode_images(IMAGES)
    assert 0 < np.abs(encoder.encode_images(IMAGES) - exact).max() < 0.01


def test_the_names_of_transformers_come_first(direct, renamed):
    shutil.copy(direct / "model.safetensors", renamed)
    (renamed / "open_clip_model.safetensors").write_bytes(b"not read")
    assert tiny(renamed).identity.weights == tiny(direct).identity.weights
    assert pretrained.weight_files(renamed) == [renamed / "model.safetensors"]


# --- tensors that are not as they should be ---------------------------------------------------


def test_each_tensor_is_needed_in_its_shape(direct, tensors):
    config = transformers.CLIPConfig.from_pretrained(direct)
    assert len(transformers_encoders.renamed(tensors, config, "here")) == 12 * 4 + 4 * 4 + 14
    for name, tensor in tensors.items():
        rest = {other: t for other, t in tensors.items() if other != name}
        with malformed(rf"here: lacks the tensor '{re.escape(name)}'"):
            transformers_encoders.renamed(rest, config, "here")
        for wrong in (tensor[None], tensor.new_zeros(3, 5), tensor.int()):
            with malformed(rf"here: '{re.escape(name)}': expected floats"):
                transformers_encoders.renamed({**rest, name: wrong}, config, "here")


@pytest.mark.parametrize("name", ["logit_bias", "visual.transformer.resblocks.2.ln_1.weight"])
def test_tensors_left_over(name, direct, tensors):
    config = transformers.CLIPConfig.from_pretrained(direct)
    with malformed(f"has 1 tensors .* first '{name}'"):
        transformers_encoders.renamed({**tensors, name: torch.zeros(1)}, config, "here")
    twice = {**tensors, "text.ln_final.weight": tensors["ln_final.weight"]}
    with malformed(r"first 'text\.ln_final\.weight'"):
        transformers_encoders.renamed(twice, config, "here")


def test_what_is_wrong_is_said_when_the_model_is_asked_for(renamed, tensors):
    save(renamed, {name: t for name, t in tensors.items() if name != "visual.proj"})
    with malformed(r"open_clip_model\.safetensors: lacks .*'visual\.proj'"):
        tiny(renamed)
    path = renamed / "open_clip_model.safetensors"
    path.write_bytes(path.read_bytes()[:-1])
    with malformed(r"open_clip_model\.safetensors: damaged or incomplete"):
        tiny(renamed)


def test_sizes_from_strangers_are_compared_before_they_are_made(own):
    for tower, size, name in (
        ("text_cfg", {"layers": 10**12}, "transformer.resblocks.2.ln_1.weight"),
        ("text_cfg", {"vocab_size": 10**12}, "token_embedding.weight"),
        ("vision_cfg", {"image_size": 10**12}, "visual.positional_embedding"),
    ):
        shutil.copy(own / "open_clip_config.json", own / "kept")
        rewrite(own / "open_clip_config.json", lambda d, t=tower, s=size: d["model_cfg"][t].update(s))
        with malformed(re.escape(f"'{name}'")):
            tiny(own)
        shutil.move(own / "kept", own / "open_clip_config.json")


# --- settings that are not as they should be --------------------------------------------------


@pytest.mark.parametrize(
    ("part", "change", "kind", "message"),
    [
        (None, {"embed_dim": None}, FormatError, r"embed_dim: expected a number, got None"),
        (None, {"multimodal_cfg": {"width": 8}}, InputError, "multimodal_cfg: a dict of 1 makes a"),
        (None, {"vision_cfg": [1]}, FormatError, "vision_cfg: expected an object, got a list"),
        ("vision_cfg", {"timm_model_name": "vit"}, InputError, "timm_model_name: 'vit' makes"),
        ("vision_cfg", {"layers": [3, 4, 6, 3]}, FormatError, "layers: expected a number, got a l"),
        ("vision_cfg", {"width": 0}, FormatError, "width: expected a positive number, got 0"),
        ("vision_cfg", {"width": "8"}, FormatError, "width: expected a number, got '8'"),
        ("vision_cfg", {"head_width": 256}, FormatError, "head_width: expected a positive"),
        ("vision_cfg", {"image_size": [32, 16]}, FormatError, "image_size: expected a number"),
        ("vision_cfg", {"image_size": []}, FormatError, "image_size: expected a number"),
        ("vision_cfg", {"mlp_ratio": None}, FormatError, "mlp_ratio: expected a number"),
        ("vision_cfg", {"pool_type": "avg"}, InputError, "pool_type: 'avg' makes a model"),
        ("text_cfg", {"pool_type": "eos"}, InputError, "pool_type: 'eos' makes a model"),
        ("text_cfg", {"hf_model_name": "roberta"}, InputError, "hf_model_name: 'roberta' makes"),
        ("text_cfg", {"heads": 3}, FormatError, "do not make a CLIPConfig"),
        ("text_cfg", {"mlp_ratio": 2.0}, FormatError, r"'transformer\.resblocks\.0\.mlp\.c_fc"),
    ],
)
def test_settings_that_are_refused(part, change, kind, message, own):
    path = own / "open_clip_config.json"
    rewrite(path, lambda d: (d["model_cfg"][part] if part else d["model_cfg"]).update(change))
    with pytest.raises(kind, match=message):
        tiny(own)


def test_settings_without_effect(pair, own):
    for part, change in (
        (None, {"custom_text": True}),
        ("vision_cfg", {"patch_dropout": 0.5, "pool_type": "tok", "ls_init_value": None}),
        ("vision_cfg", {"image_size": [SIDE, SIDE], "head_width": 64, "mlp_ratio": 4}),
        ("text_cfg", {"pool_type": "argmax", "eos_id": 5, "hf_tokenizer_name": "", "qk_norm": False}),
    ):  # fmt: skip
        rewrite(
            own / "open_clip_config.json",
            lambda d, p=part, c=change: (d["model_cfg"][p] if p else d["model_cfg"]).update(c),
        )
    check_same(tiny(own), tiny(pair[0]))


def test_settings_files_that_are_no_settings(own):
    for text, message in (
        ("[]", "expected an object, got a list of 0"),
        ("{", "expected JSON"),
        ('{"model_cfg": 3}', "model_cfg: expected an object, got 3"),
        ("{}", "embed_dim: expected a number, got None"),
    ):
        (own / "open_clip_config.json").write_text(text)
        with malformed(message):
            tiny(own)


def test_config_json_that_is_no_clip(renamed):
    for change, kind, message in (
        ({"model_type": "siglip"}, InputError, "is read as a CLIP, and config.json says 'siglip'"),
        ({"vision_config": {"image_size": [32, 32]}}, FormatError, "image_size and patch_size"),
        ({"vision_config": {"hidden_size": "wide"}}, FormatError, "do not make a CLIPConfig"),
        ({"text_config": {"num_attention_heads": 0}}, FormatError, "do not make a CLIPConfig"),
    ):
        shutil.copy(renamed / "config.json", renamed / "kept")
        rewrite(renamed / "config.json", lambda d, c=change: d.update(c))
        with pytest.raises(kind, match=message):
            tiny(renamed)
        shutil.move(renamed / "kept", renamed / "config.json")
    (renamed / "config.json").unlink()
    with refused(r"no config\.json.*nor open_clip_config\.json"):
        tiny(renamed)


# --- preprocessing ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, "32 px bicubic cut, x0.00392157, mean 0.481455 0.45782"),
        ({"mean": [0.5, 0.25, 0.125]}, "32 px bicubic cut, x0.00392157, mean 0.5 0.25 0.125, std 0.2"),
        ({"std": [1, 1, 2], "size": [32, 32]}, "32 px bicubic cut.*std 1 1 2"),
        ({"size": 32, "interpolation": "bilinear"}, "32 px bilinear cut"),
        ({"resize_mode": "squash", "mode": "RGB"}, "32 px bicubic stretched"),
    ],
)  # fmt: skip
def test_preprocessing_of_open_clip(given, expected, own):
    rewrite(own / "open_clip_config.json", lambda d: d.update(preprocess_cfg=given))
    assert re.match(expected, tiny(own).identity.preprocessing)


@pytest.mark.parametrize(
    ("given", "kind", "message"),
    [
        ({"resize_mode": "longest"}, InputError, "resize_mode 'longest'"),
        ({"interpolation": "random"}, InputError, "interpolation 'random'"),
        ({"mean": [1, 2]}, FormatError, "image_mean: expected 3 numbers"),
        ({"std": [1, 0, 1]}, FormatError, "positive"),
        ({"size": [32, 40]}, FormatError, "size: expected a number"),
        ({"size": 40}, FormatError, "scaled to 40 pixels, the model expects 32"),
        ([1], FormatError, "preprocess_cfg: expected an object"),
    ],
)
def test_preprocessing_that_is_refused(given, kind, message, own):
    rewrite(own / "open_clip_config.json", lambda d: d.update(preprocess_cfg=given))
    with pytest.raises(kind, match=message):
        tiny(own)


def test_preprocessor_config_json_comes_first(own):
    rewrite(own / "open_clip_config.json", lambda d: d.update(preprocess_cfg={"mean": [0.5, 0.5, 0.5]}))
    (own / "preprocessor_config.json").write_text(json.dumps({"image_mean": [0.25, 0.25, 0.25]}))
    assert "mean 0.25 0.25 0.25" in tiny(own).identity.preprocessing


# --- tokenizers, pickles, the hub -------------------------------------------------------------


def test_tokenizers_without_config_json(pair, own):
    """OpenCLIP's folders may have no file that says which class it is."""
    rows = tiny(pair[0]).encode_texts(TEXTS)
    whole = transformers.AutoTokenizer.from_pretrained(own)
    (own / "tokenizer_config.json").unlink()
    assert_allclose(tiny(own).encode_texts(TEXTS), rows, atol=1e-6)
    for name in ("vocab.json", "merges.txt"):
        (own / name).unlink()
    encoder = tiny(own)
    with refused("has no tokenizer"):
        encoder.encode_texts(["mug"])
    whole.backend_tokenizer.save(str(own / "tokenizer.json"))
    assert_allclose(encoder.encode_texts(TEXTS), rows, atol=1e-6)


def test_pickles_are_converted_by_the_command_that_is_given(pair, own):
    from safetensors.torch import load_file

    path = own / "open_clip_model.safetensors"
    torch.save(load_file(path), own / "open_clip_pytorch_model.bin")
    path.unlink()
    with refused(r"open_clip_pytorch_model\.bin.*Convert it once") as caught:
        tiny(own)
    command = re.search(r'python -c "(.*)"', str(caught.value))
    exec(command[1], {})
    check_same(tiny(own), tiny(pair[0]))


def fake_hub(repository: Path, target: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """A hub with one repository; the names that were downloaded, in order."""
    downloaded = []
    target.mkdir()

    def download(_: str, allow_patterns: list[str]) -> str:
        for path in sorted(repository.iterdir()):
            wanted = any(fnmatch(path.name, pattern) for pattern in allow_patterns)
            if wanted and not (target / path.name).exists():
                shutil.copy(path, target)
                downloaded.append(path.name)
        return str(target)

    monkeypatch.setattr(hub, "snapshot_download", download)
    return downloaded


def test_the_hub_is_asked_for_weights_under_either_name(pair, own, tmp_path, monkeypatch):
    (own / "open_clip_pytorch_model.bin").write_bytes(b"pickle")
    downloaded = fake_hub(own, tmp_path / "first", monkeypatch)
    encoder = load_encoder(DEFAULT_ENCODER, "cpu", "float32")
    check_same(encoder, tiny(pair[0]))
    assert encoder.identity.name == DEFAULT_ENCODER
    assert downloaded[-1] == "open_clip_model.safetensors"
    assert "open_clip_pytorch_model.bin" not in downloaded


def test_weights_are_not_downloaded_twice(direct, renamed, tmp_path, monkeypatch):
    shutil.copy(direct / "model.safetensors", renamed)
    downloaded = fake_hub(renamed, tmp_path / "first", monkeypatch)
    load_encoder("some/model", "cpu")
    assert "model.safetensors" in downloaded
    assert "open_clip_model.safetensors" not in downloaded


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        (("open_clip_config.json", "open_clip_model.safetensors"), True),
        (("config.json", "open_clip_model.safetensors"), True),
        (("config.json", "model.safetensors"), True),
        (("open_clip_model.safetensors",), False),
        (("open_clip_config.json", "model.safetensors"), False),
        (("config.json", "open_clip_config.json"), False),
    ],
)
def test_what_is_cached_in_full(files, expected, tmp_path, monkeypatch):
    monkeypatch.setattr(hub.constants, "HF_HUB_CACHE", str(tmp_path))
    cache = tmp_path / f"models--{DEFAULT_ENCODER.replace('/', '--')}"
    (cache / "snapshots" / ("0" * 40)).mkdir(parents=True)
    (cache / "refs").mkdir()
    (cache / "refs" / "main").write_text("0" * 40)
    for name in files:
        (cache / "snapshots" / ("0" * 40) / name).touch()
    assert pretrained.cached_in_full(DEFAULT_ENCODER) is expected
