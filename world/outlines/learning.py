"""Learn the network of outlines: python -m world.outlines.learning MAPS ROOM... --output network.safetensors

A U-Net of the form of `graph`'s, begun from its weights, learns from real photos how strong an edge HED sees at each
pixel (MAPS, as `world.outlines.teacher` writes them), and from photos of made rooms where things end: four of five
pieces are of real photos. Every eighth picture, a photo with its middle, is held out; the network that agrees best
with HED on those is written. Needs PyTorch; what is learned runs without.
"""

import argparse
import math
import time
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import UInt8
from PIL import Image
from torch import Tensor, nn

from drsplat.photos.models.graph.segmenter import Tensors, shipped_network

from ..segmenter.scenes import Photo, photos
from ..segmenter.sight import SightNet, piece, repainted, save_network, touching

HEIGHT, WIDTH, BATCH = 240, 320, 8
REAL_SHARE = 0.8  # of the pieces
WHOLE_SIZE_SHARE = 0.5  # of the real pieces; the others are scaled by 0.5 to 1
HELD_OUT_EACH = 8
RATE, WARM_STEPS, TRIAL_STEPS = 2e-3, 50, 100
EDGE_WEIGHT = 2.0  # more for a pixel that is surely an edge than for one that surely is none


class Taught(NamedTuple):
    """A real photo or its middle, and how strong an edge the teacher sees at each pixel, 0 to 255."""

    picture: str
    image: UInt8[np.ndarray, "h w 3"]
    edges: UInt8[np.ndarray, "h w"]


def read_taught(maps: Path) -> tuple[list[Taught], list[Taught]]:
    """Return the photos to learn from, and those that are held out."""
    taught = [
        Taught(path.stem.removesuffix("_middle"), np.asarray(Image.open(path.with_suffix(".png"))), np.load(path))
        for path in sorted(maps.glob("*.npy"))
    ]
    pictures = sorted({one.picture for one in taught})
    held_out = set(pictures[HELD_OUT_EACH // 2 :: HELD_OUT_EACH])
    return [one for one in taught if one.picture not in held_out], [one for one in taught if one.picture in held_out]


def batches(taught: Sequence[Taught], rooms: Sequence[Photo], rng: np.random.Generator) -> Iterator[tuple[Tensor, ...]]:
    """Yield pixels (B, 3, H, W) from -1 to 1 and how strong their edges are (B, H, W), 0 to 1."""
    while True:
        real = rng.random(BATCH) < (REAL_SHARE if rooms else 1.0)
        pieces = [real_piece(taught, rng) if is_real else made_piece(rooms, rng) for is_real in real]
        pixels, edges = (torch.from_numpy(np.stack(arrays)) for arrays in zip(*pieces, strict=True))
        yield (pixels.permute(0, 3, 1, 2) * 2 - 1).contiguous(memory_format=torch.channels_last), edges


def real_piece(taught: Sequence[Taught], rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    one = taught[rng.integers(len(taught))]
    scale = 1.0 if rng.random() < WHOLE_SIZE_SHARE else rng.uniform(0.5, 1)
    size = np.minimum(one.edges.shape, np.round(np.divide((HEIGHT, WIDTH), scale)).astype(int))
    y, x = rng.integers(one.edges.shape - size + 1)
    part = np.s_[y : y + size[0], x : x + size[1]]
    image, edges = (
        np.asarray(Image.fromarray(array[part]).resize((WIDTH, HEIGHT), Image.Resampling.HAMMING))
        for array in (one.image, one.edges)
    )
    if rng.random() < 0.5:
        image, edges = image[:, ::-1], edges[:, ::-1]
    return repainted(image, rng), edges.astype(np.float32) / 255


def made_piece(rooms: Sequence[Photo], rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return a piece of a made photo; edges are the pixels at borders of things and one more on either side."""
    image, things = piece(rooms[rng.integers(len(rooms))], rng)
    borders = F.max_pool2d(touching(torch.from_numpy(things)[None])[:, None], 3, stride=1, padding=1)
    return repainted(image, rng), borders[0, 0].numpy()


def loss(logits: Tensor, edges: Tensor) -> Tensor:
    """Return weighted cross-entropy and, for crisp edges, Dice's coefficient. Source: Deng et al. 2018."""
    weights = 1 + EDGE_WEIGHT * edges
    entropy = F.binary_cross_entropy_with_logits(logits, edges, weights, reduction="sum") / weights.sum()
    both, either = (logits.sigmoid() * edges).sum((1, 2)), (logits.sigmoid() ** 2 + edges**2).sum((1, 2))
    return entropy + 0.2 * (1 - ((2 * both + 1) / (either + 1)).mean())


@torch.inference_mode()
def disagreement(net: SightNet, held_out: Sequence[Taught]) -> float:
    """Return the mean loss over whole photos that are held out."""
    values = []
    for one in held_out:
        height, width = (side // 32 * 32 for side in one.edges.shape)
        pixels = torch.tensor(one.image[:height, :width]).permute(2, 0, 1)[None].float() / 127.5 - 1
        edges = torch.tensor(one.edges[None, :height, :width]).float() / 255
        with torch.autocast("cpu", torch.bfloat16):
            out = net(pixels.contiguous(memory_format=torch.channels_last))[:, 0]
        values.append(loss(out.float(), edges).item())
    return float(np.mean(values))


def begun_from(tensors: Tensors) -> SightNet:
    """Return a network with weights as `graph` stores them, without traits."""
    net = SightNet()
    with torch.no_grad():
        for name, layer in net.named_modules():
            if isinstance(layer, nn.Conv2d):
                stored = name.replace(".", "")
                rows, bias = (torch.from_numpy(tensors[f"{stored}.{part}"]) for part in ("weight", "bias"))
                layer.weight.copy_(rows.reshape(*layer.kernel_size, -1, len(bias)).permute(3, 2, 0, 1))
                layer.bias.copy_(bias)
        net.head.weight[4:], net.head.bias[4:] = 0, 0
    return net.to(memory_format=torch.channels_last)


def learn(
    taught: Sequence[Taught], held_out: Sequence[Taught], rooms: Sequence[Photo], steps: int, output: Path
) -> None:
    """Write the network whenever it is better than before on what is held out."""
    net = begun_from(shipped_network()[0])
    optimizer = torch.optim.AdamW(net.parameters(), lr=RATE, weight_decay=1e-4)
    least = disagreement(net, held_out)
    print(f"graph's own borders: {least:.4f} on {len(held_out)} photos that are held out", flush=True)
    start, total = time.monotonic(), 0.0
    for step, (pixels, edges) in enumerate(islice(batches(taught, rooms, np.random.default_rng(0)), steps), 1):
        for group in optimizer.param_groups:
            group["lr"] = RATE * min(1, step / WARM_STEPS) * (0.5 + 0.5 * math.cos(math.pi * step / steps)) + 1e-5
        with torch.autocast("cpu", torch.bfloat16):
            out = net(pixels)[:, 0]
        value = loss(out.float(), edges)
        optimizer.zero_grad()
        value.backward()
        nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        optimizer.step()
        total += value.item()
        if step % TRIAL_STEPS == 0 or step == steps:
            now = disagreement(net, held_out)
            mean, total = total / ((step - 1) % TRIAL_STEPS + 1), 0.0
            print(f"{step} steps, {time.monotonic() - start:.0f} s: {mean:.4f}, held out {now:.4f}", flush=True)
            if now < least:
                save_network(net, output)
            least = min(now, least)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("maps", type=Path, metavar="MAPS", help="as python -m world.outlines.teacher writes them")
    parser.add_argument("rooms", type=Path, nargs="*", metavar="ROOM", help="as python -m world writes them")
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=1000)
    arguments = parser.parse_args()
    (taught, held_out), rooms = read_taught(arguments.maps), photos(arguments.rooms)
    print(f"{len(taught)} real photos, {len(held_out)} held out, {len(rooms)} of made rooms")
    learn(taught, held_out, rooms, arguments.steps, arguments.output)


if __name__ == "__main__":
    main()
