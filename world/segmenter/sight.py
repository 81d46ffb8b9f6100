"""Learn the network of `graph`: python -m world.segmenter.sight ROOM... --output network.safetensors

A small U-Net learns, from photos of made rooms, at which pixels things end, and traits: numbers of each pixel that are
near for two pixels of one thing, near or far in the photo. Hues are turned at random, so that it does not remember the
paint of the training rooms. Needs PyTorch; what is learned runs on NumPy (`drsplat.photos.models.graph.segmenter`).
"""

import argparse
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float32, Int64
from PIL import Image
from safetensors.numpy import save_file
from torch import Tensor, nn

from drsplat.base.arrays import Pixels
from drsplat.kernels.photo_regions import TRAITS
from drsplat.photos.models.graph.segmenter import LEVELS

from .scenes import Photo, photos

CHANNELS = (12, 20, 32, 40, 48)  # at a half of the size, a quarter ...
HEIGHT, WIDTH, BATCH = 240, 320, 8
PAIRS = 12_000  # of pixels of a picture, from NEAREST to FURTHEST apart
NEAREST, FURTHEST = 2, 160
RATE, WARM = 3e-3, 100  # of learning; steps until it is reached
GREY = np.full(3, 3**-0.5)


class Block(nn.Module):
    """Two convolutions."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.a, self.b = nn.Conv2d(inputs, outputs, 3, padding=1), nn.Conv2d(outputs, outputs, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        return F.relu(self.b(F.relu(self.a(x))))


class SightNet(nn.Module):
    """(B, 3, H, W) from -1 to 1 to (B, 1 + TRAITS, H, W): the logit of a border, then traits. H, W: even."""

    def __init__(self) -> None:
        super().__init__()
        self.stem = nn.Conv2d(12, CHANNELS[0], 3, padding=1)
        self.down = nn.ModuleList(Block(CHANNELS[max(k - 1, 0)], CHANNELS[k]) for k in range(LEVELS))
        self.up = nn.ModuleList(Block(CHANNELS[k] + CHANNELS[k + 1], CHANNELS[k]) for k in range(LEVELS - 1))
        self.head = nn.Conv2d(CHANNELS[0], 4 * (1 + TRAITS), 1)

    def forward(self, x: Tensor) -> Tensor:
        x, seen = F.relu(self.stem(F.pixel_unshuffle(x, 2))), []
        for level, block in enumerate(self.down):
            x = block(F.max_pool2d(x, 2) if level else x)
            seen.append(x)
        for level in reversed(range(LEVELS - 1)):
            x = self.up[level](torch.cat([seen[level], F.interpolate(x, size=seen[level].shape[2:])], 1))
        return F.pixel_shuffle(self.head(x), 2)


@dataclass(frozen=True, eq=False)
class Batch:
    """pixels (B, 3, H, W), things (B, H, W), weights: pixels of small things count for more."""

    pixels: Tensor
    things: Tensor
    weights: Tensor


def batches(shown: Sequence[Photo], rng: np.random.Generator) -> Iterator[Batch]:
    while True:
        pieces = [piece(shown[rng.integers(len(shown))], rng) for _ in range(BATCH)]
        pixels = torch.from_numpy(np.stack([repainted(image, rng) for image, _ in pieces])).permute(0, 3, 1, 2)
        things = torch.from_numpy(np.stack([owners for _, owners in pieces]))
        weights = torch.stack([torch.bincount(t.ravel()).clamp(min=30)[t].float() ** -0.5 for t in things])
        yield Batch(pixels.contiguous() * 2 - 1, things, (weights / weights.mean((1, 2), keepdim=True)).clamp(max=4))


def piece(photo: Photo, rng: np.random.Generator) -> tuple[Pixels, Int64[np.ndarray, "h w"]]:
    """A part of a photo at 0.6 to 2 times its size, mirrored or not."""
    full_height, full_width = photo.truth.shape
    shrink = np.exp(rng.uniform(np.log(0.5), np.log(1.6)))
    height, width = int(min(full_height, HEIGHT * shrink)), int(min(full_width, WIDTH * shrink))
    y, x = rng.integers(full_height - height + 1), rng.integers(full_width - width + 1)
    part = Image.fromarray(photo.image[y : y + height, x : x + width])
    image = np.asarray(part.resize((WIDTH, HEIGHT), Image.Resampling.BILINEAR if shrink < 1 else Image.Resampling.BOX))
    rows = y + (2 * np.arange(HEIGHT) + 1) * height // (2 * HEIGHT)
    columns = x + (2 * np.arange(WIDTH) + 1) * width // (2 * WIDTH)
    owners = photo.truth[rows[:, None], columns]
    return (image[:, ::-1], owners[:, ::-1].copy()) if rng.random() < 0.5 else (image, owners)


def repainted(image: Pixels, rng: np.random.Generator) -> Float32[np.ndarray, "h w 3"]:
    """Under other light and in other paints, 0 to 1, with noise."""
    x = image.astype(np.float32) / 255
    if rng.random() < 0.7:
        x = x @ turned_hues(rng.uniform(-np.pi, np.pi)).T.astype(np.float32)
    if rng.random() < 0.5:
        grey = x.mean(2, keepdims=True)
        x = grey + (x - grey) * rng.uniform(0.5, 1.4)
    x = np.clip(x, 0, 1) ** np.exp(rng.normal(0, 0.25)) * np.exp(rng.normal(0, 0.2)) * np.exp(rng.normal(0, 0.06, 3))
    return np.clip(x + rng.normal(0, rng.choice([0, 0.01, 0.03]), x.shape), 0, 1).astype(np.float32)


def turned_hues(angle: float) -> np.ndarray:
    """A turn about the line of greys."""
    across = np.cross(np.eye(3), GREY)
    return np.eye(3) + np.sin(angle) * across + (1 - np.cos(angle)) * across @ across


def loss(out: Tensor, batch: Batch, nearness: Tensor) -> Tensor:
    return border_loss(out[:, 0], batch) + trait_loss(out[:, 1:], batch, nearness)


def border_loss(logits: Tensor, batch: Batch) -> Tensor:
    truth = touching(batch.things)
    weights = torch.where(truth > 0, 3.0, 1.0) * batch.weights
    each = F.binary_cross_entropy_with_logits(logits, truth, reduction="none")
    return (each * weights).sum() / weights.sum()


def touching(things: Tensor) -> Tensor:
    """Which pixels have one of another thing beside, above or below."""
    found = torch.zeros_like(things, dtype=torch.bool)
    across, down = things[:, :, 1:] != things[:, :, :-1], things[:, 1:] != things[:, :-1]
    found[:, :, 1:] |= across
    found[:, :, :-1] |= across
    found[:, 1:] |= down
    found[:, :-1] |= down
    return found.float()


def trait_loss(traits: Tensor, batch: Batch, nearness: Tensor) -> Tensor:
    """Of pairs of pixels: that they show one thing is as likely as their traits are near, `nearness` is even odds."""
    y, x = torch.randint(HEIGHT, (BATCH, PAIRS)), torch.randint(WIDTH, (BATCH, PAIRS))
    far, angle = NEAREST * (FURTHEST / NEAREST) ** torch.rand(BATCH, PAIRS), 2 * math.pi * torch.rand(BATCH, PAIRS)
    other_y, other_x = (y + far * torch.sin(angle)).round().long(), (x + far * torch.cos(angle)).round().long()
    inside = (other_y >= 0) & (other_y < HEIGHT) & (other_x >= 0) & (other_x < WIDTH)
    ends = y * WIDTH + x, other_y.clamp(0, HEIGHT - 1) * WIDTH + other_x.clamp(0, WIDTH - 1)
    flat = traits.reshape(BATCH, TRAITS, -1)
    first, second = (torch.gather(flat, 2, end[:, None].expand(-1, TRAITS, -1)) for end in ends)
    logits = nearness - (first - second).square().sum(1)
    things = [batch.things.reshape(BATCH, -1).gather(1, end) for end in ends]
    weights = torch.maximum(*(batch.weights.reshape(BATCH, -1).gather(1, end) for end in ends)) * inside
    same = (things[0] == things[1]).float()
    share = torch.where(same > 0, 0.5 / (weights * same).sum(), 0.5 / (weights * (1 - same)).sum())
    return (F.binary_cross_entropy_with_logits(logits, same, reduction="none") * weights * share).sum()


def learned(shown: Sequence[Photo], steps: int) -> SightNet:
    torch.manual_seed(0)
    net, nearness, start, told = SightNet(), nn.Parameter(torch.tensor(2.0)), time.monotonic(), 0.0
    optimizer = torch.optim.AdamW([*net.parameters(), nearness], lr=RATE, weight_decay=1e-4)
    for step, batch in zip(range(steps), batches(shown, np.random.default_rng(0)), strict=False):
        for group in optimizer.param_groups:
            group["lr"] = RATE * min(1, (step + 1) / WARM) * (0.5 + 0.5 * math.cos(math.pi * step / steps)) + 1e-5
        with torch.autocast("cpu", torch.bfloat16):
            out = net(batch.pixels)
        value = loss(out.float(), batch, nearness)
        optimizer.zero_grad()
        value.backward()
        nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        optimizer.step()
        told += value.item()
        if step % 100 == 99:
            print(f"{step + 1} steps, {time.monotonic() - start:.0f} s: {told / 100:.3f}", flush=True)
            told = 0.0
    return net


def save_network(net: SightNet, path: Path) -> None:
    """As `drsplat.photos.models.graph.segmenter.shipped_network` reads it, in half precision."""
    named = {"stem": net.stem, "head": net.head}
    for kind, blocks in (("down", net.down), ("up", net.up)):
        for level, block in enumerate(blocks):
            named |= {f"{kind}{level}a": block.a, f"{kind}{level}b": block.b}
    tensors = {}
    for name, layer in named.items():
        rows = layer.weight.detach().permute(2, 3, 1, 0).reshape(-1, layer.weight.shape[0])
        tensors |= {f"{name}.weight": rows.half().numpy(), f"{name}.bias": layer.bias.detach().half().numpy()}
    save_file({name: np.ascontiguousarray(array) for name, array in tensors.items()}, path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", type=Path, nargs="+", metavar="ROOM", help="as python -m world writes them")
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=3000)
    arguments = parser.parse_args()
    save_network(learned(photos(arguments.scenes), arguments.steps), arguments.output)


if __name__ == "__main__":
    main()
