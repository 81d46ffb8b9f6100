"""Segmenters by name; SAM, SAM 2, SAM 3 and EdgeTAM of transformers without their processors."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from ...base.arrays import Float32, Pixels, PlanePoints, Spans, Vectors
from ...errors import InputError, MissingExtraError
from .devices import chosen_device, fitting
from .graph import GraphSegmenter
from .libraries import models_library
from .point_decoder import PointDecoder
from .point_masks import PointMasks, PointMaskSettings, PointSegmenter
from .preprocessing import HALF, IMAGENET, Colors, Triple, colors_of, processor_settings
from .pretrained import load_model, model_folder, model_type, weight_files, weights_hash
from .torch_encoder import as_rows

DEFAULT_SEGMENTER = "facebook/sam-vit-huge"
"""The paper's segmenter. Source: LangSplat preprocess.py (sam_vit_h_4b8939)."""
CPU_SEGMENTER = "facebook/sam2.1-hiera-tiny"
"""The segmenter to take without a GPU."""


class Architecture(NamedTuple):
    """Architecture of a segmenter.

    stretched: see ModelFrame. colors: of its published preprocessing. packages: that its image encoder needs beside
    transformers.
    """

    class_name: str
    stretched: bool = True
    colors: Colors = IMAGENET
    packages: tuple[str, ...] = ()


_SAM2 = Architecture("Sam2Model")
_SAM3 = Architecture("Sam3TrackerModel", colors=HALF)
_EDGETAM = Architecture("EdgeTamModel", packages=("timm", "torchvision"))
ARCHITECTURES = {
    "sam": Architecture("SamModel", stretched=False),
    "sam2": _SAM2,
    "sam2_video": _SAM2,  # in Meta's SAM 2 checkpoints, which hold both
    "sam3_tracker": _SAM3,
    "sam3_video": _SAM3,  # likewise facebook/sam3, which holds a detector too
    "edgetam": _EDGETAM,
    "edgetam_video": _EDGETAM,
}
"""Architectures by model_type of config.json. Source: the processors and configurations of transformers 5.23."""
_CHUNK_FLOATS = 1 << 24  # of enlarged masks: 64 MiB


@dataclass(frozen=True)
class ModelFrame:
    """Map from an image to what the model sees, a square of `side` pixels, and from its masks back.

    stretched: SAM 2 and its successors stretch the image to the square. SAM scales the longer side to it and fills
    the rest, right and below, with zeros after normalising. Scaled by Pillow, bilinear, as bytes.

    Source: segment-anything utils/transforms.py and modeling/sam.py; sam2 utils/transforms.py,
    which scales floats in torch, so up to 1/255 differs before normalising.
    """

    side: int
    stretched: bool
    mean: Triple = IMAGENET[0]
    std: Triple = IMAGENET[1]

    def scaled_size(self, height: int, width: int) -> tuple[int, int]:
        """Return height and width of the image within the square."""
        if self.stretched:
            return self.side, self.side
        scale = self.side / max(height, width)
        return max(1, int(height * scale + 0.5)), max(1, int(width * scale + 0.5))

    def pixel_values(self, image: Pixels) -> Float32[np.ndarray, "3 s s"]:
        height, width = self.scaled_size(*image.shape[:2])
        scaled = Image.fromarray(image).resize((width, height), Image.Resampling.BILINEAR)
        pixels = np.asarray(scaled, np.float64) / 255
        values = np.zeros((3, self.side, self.side), np.float32)
        values[:, :height, :width] = ((pixels - self.mean) / self.std).transpose(2, 0, 1)
        return values

    def scaled_points(self, points: PlanePoints, height: int, width: int) -> Float32[np.ndarray, "n 2"]:
        """Map points (x, y) from pixels of the image to pixels of the square."""
        new_height, new_width = self.scaled_size(height, width)
        scaled = points * (new_width / width, new_height / height)
        return np.asarray(scaled, np.float32)

    def enlarged(self, logits: Any, height: int, width: int) -> Any:
        """Resize logits of masks, (n, h, w) over the square, to the size of the image, as tensors."""
        from torch.nn.functional import interpolate

        rows = logits[:, None].float()
        if not self.stretched:
            used_height, used_width = self.scaled_size(height, width)
            rows = interpolate(rows, (self.side, self.side), mode="bilinear", align_corners=False)
            rows = rows[..., :used_height, :used_width]
        rows = interpolate(rows, (height, width), mode="bilinear", align_corners=False)
        return rows[:, 0]


class SamPredictor:
    """SAM of any generation on one device, in float32. identity: name and hash of the weights."""

    def __init__(self, model: Any, frame: ModelFrame, device: str, identity: Mapping[str, object]):
        self.model, self.frame, self.device = model.to(device), frame, device
        self.identity: Mapping[str, object] = dict(identity)
        self._last: tuple[np.ndarray | None, Any] = None, None

    def find(self, crop: Pixels, points: PlanePoints, settings: PointMaskSettings) -> Iterator[PointMasks]:
        """Yield masks at points; see PointPredictor. The last image's encoding is reused; points go in batches."""
        size = crop.shape[:2]
        if self._last[0] is not crop:
            self._last = crop, fitting(self._features, [crop], "photos")[0]
        decoder = self._last[1]
        scaled = self.frame.scaled_points(points, *size)
        for start in range(0, len(scaled), settings.points_per_batch):
            batch, first = scaled[start : start + settings.points_per_batch], start
            for logits, iou in fitting(partial(self._answers, decoder), batch, "points"):
                # before masks are enlarged, which costs time and memory
                wanted = np.isin(np.arange(3), settings.looked_at) & (iou > settings.min_predicted_iou)
                for masks in self._enlarged(logits, iou, np.argwhere(wanted), size, settings):
                    yield masks._replace(point=first + masks.point)
                first += len(iou)

    def _features(self, crops: list[Pixels]) -> PointDecoder:
        """Run the image encoder on the single crop of this batch."""
        import torch

        with torch.inference_mode():  # never across a yield: it would hold in the caller
            pixels = torch.from_numpy(self.frame.pixel_values(crops[0]))[None].to(self.device)
            return PointDecoder(self.model, self.model.get_image_embeddings(pixels))

    def _answers(self, decoder: PointDecoder, points: Float32[np.ndarray, "n 2"]) -> tuple[Any, Vectors]:
        """Return logits of three masks per point, (p, 3, h, w) over the square, and their predicted IoU."""
        import torch

        with torch.inference_mode():
            masks, iou = decoder.answers(points)
            return masks, as_rows(iou)

    def _enlarged(
        self,
        logits: Any,
        iou: Float32[np.ndarray, "p 3"],
        wanted: Spans,
        size: tuple[int, ...],
        settings: PointMaskSettings,
    ) -> Iterator[PointMasks]:
        """Yield the stable masks at the size of the crop. wanted: point and output of each mask."""
        import torch

        chunk = max(1, _CHUNK_FLOATS // max(size[0] * size[1], self.frame.side**2))
        for start in range(0, len(wanted), chunk):
            points, outputs = wanted[start : start + chunk].T
            with torch.inference_mode():
                enlarged = self.frame.enlarged(logits[points, outputs], size[0], size[1])
                strict, lax = (
                    (enlarged > bound).flatten(1).sum(1)
                    for bound in (settings.stability_offset, -settings.stability_offset)
                )
                stability = strict / lax.clamp(min=1)  # nothing above the laxer bound: 0
                stable = stability >= settings.min_stability
                masks, good = (enlarged[stable] > 0).cpu().numpy(), stable.cpu().numpy()
                sure = as_rows(stability[stable])
            yield PointMasks(masks, iou[points, outputs][good], sure, outputs[good], points[good])


def load_segmenter(
    name: str = DEFAULT_SEGMENTER, device: str = "auto", settings: PointMaskSettings | None = None, *, threads: int = 0
) -> PointSegmenter | GraphSegmenter:
    """Load the built-in `graph`, or SAM, SAM 2 (also 2.1), SAM 3 or EdgeTAM with a grid of points.

    name: "graph", which has neither device nor settings; a folder as `save_pretrained` writes it, or an id of the
    Hugging Face hub, which is downloaded unless it is cached; without a GPU take CPU_SEGMENTER. Only safetensors are
    loaded, never pickles. device: auto, cpu, cuda or mps. threads: of `graph`, 0 for all cores.

    identity of SAM: name, architecture, the BLAKE2b hash of the weights' files, mean and deviation of
    pixels, and the settings. The device is not part of it, although it may change single pixels.

    Raises: InputError: no such model, a gated one, another architecture, no weights; settings for
    `graph`. FormatError: damaged or incomplete ones. MissingExtraError: torch, transformers, the
    device, or timm for EdgeTAM is absent. DrSplatError: no network.

    >>> photo = ds.load_image(scene.views[0])
    >>> masks = ds.load_segmenter("graph").segment(photo)["large"]
    """
    if name == GraphSegmenter.name:
        if settings is not None:
            raise InputError("the segmenter graph has no point grid: load it without settings")
        return GraphSegmenter(threads=threads)
    models_library()
    device = chosen_device(device)
    called, folder = model_folder(name)
    architecture = _architecture(name, folder)
    files = weight_files(folder)
    model = load_model(architecture.class_name, folder)
    settings_file, prepared = processor_settings(folder)
    mean, std = colors_of(prepared, settings_file, architecture.colors)
    side = int(model.config.prompt_encoder_config.image_size)  # in which points are placed
    frame = ModelFrame(side, architecture.stretched, mean, std)
    identity = {
        "name": called, "architecture": architecture.class_name, "weights": weights_hash(files),
        "side": side, "mean": list(mean), "std": list(std),
    }  # fmt: skip
    return PointSegmenter(SamPredictor(model, frame, device, identity), settings)


def _architecture(name: str, folder: Path) -> Architecture:
    """Return a folder's architecture.

    Raises: InputError: no segmenter. MissingExtraError: packages that it needs are not installed.
    """
    kind = model_type(folder)
    if kind not in ARCHITECTURES:
        raise InputError(
            f"{name}: is a '{kind}', expected SAM, SAM 2, SAM 3 or EdgeTAM ({', '.join(ARCHITECTURES)}), such as "
            f"{DEFAULT_SEGMENTER} or, without a GPU, {CPU_SEGMENTER}"
        )
    architecture = ARCHITECTURES[kind]
    absent = [package for package in architecture.packages if find_spec(package) is None]
    if absent:
        raise MissingExtraError(
            f"{name}: its image encoder needs {' and '.join(absent)}, not installed: pip install {' '.join(absent)} "
            f"(the torchvision of the installed torch); {CPU_SEGMENTER} needs neither"
        )
    return architecture
