"""Names of files with a model's weights and settings, and advice for weights that are pickles."""

from pathlib import Path

WEIGHTS, INDEX = "model.safetensors", "model.safetensors.index.json"
OPEN_CLIP, OPEN_CLIP_CONFIG = "open_clip_model.safetensors", "open_clip_config.json"


def no_weights(folder: Path) -> str:
    """Return the error text for a folder without safetensors, with the command that converts a pickle."""
    others = sorted(path.name for path in folder.glob("*") if path.suffix in (".bin", ".pt", ".pth"))
    if not others:
        return (
            f"{folder}: has no {WEIGHTS} and no {OPEN_CLIP}: download the model's weights into it. Where they are "
            "published as a pickle only, put that there and run this again for the command that converts it"
        )
    cure = _converted_open_clip(folder) if others[0].startswith("open_clip") else _converted(folder)
    return (
        f"{folder}: its weights are a pickle ({others[0]}), which can run code when it is loaded. "
        f"Convert it once, where you trust it: {cure}"
    )


def _converted(folder: Path) -> str:
    return (
        'python -c "from transformers import AutoModel; '
        f"AutoModel.from_pretrained({str(folder)!r}).save_pretrained('converted')\", copy the "
        "tokenizer's files beside it, and give that folder"
    )


def _converted_open_clip(folder: Path) -> str:
    source, target = (str(folder / name) for name in ("open_clip_pytorch_model.bin", OPEN_CLIP))
    return (
        'python -c "import torch; from safetensors.torch import save_file; '
        f'save_file(torch.load({source!r}, weights_only=True), {target!r})"'
    )
