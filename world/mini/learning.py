"""Learn `mini`: python -m world.mini.learning --train TRAIN.npz --output mini.safetensors [--epochs 24]

Images and texts meet in a sigmoid loss (Zhai et al. 2023, SigLIP): each crop of a batch with each text of a
batch, true or not by the lexicon. Batch normalisation is folded into the convolutions when it is done.
"""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from safetensors.numpy import save_file
from torch import nn

from drsplat.photos.models.mini.encoder import DIM, STRIDES
from drsplat.photos.models.mini.lexicon import WORDS

from .augment import augmented, repainted
from .texts import Label, bank, said_of, truth

CHANNELS = (3, 32, 64, 64, 128, 128, 256, 256)
LEAST_PIXELS = 70
REPAINTED = 0.35  # of a batch: names are to be learned from shapes, too
ROWS = {word: row for row, word in enumerate(WORDS)}


class Tower(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        pairs = zip(CHANNELS[:-1], CHANNELS[1:], STRIDES, strict=True)
        self.convolutions = nn.ModuleList(
            nn.Sequential(nn.Conv2d(a, b, 3, s, 1, bias=False), nn.BatchNorm2d(b)) for a, b, s in pairs
        )
        self.drop = nn.Dropout(0.1)
        self.projection = nn.Linear(2 * CHANNELS[-1], DIM, bias=False)
        self.words = nn.Parameter(0.05 * torch.randn(len(WORDS), DIM))
        self.scale = nn.Parameter(torch.tensor(2.3))  # of the logarithm
        self.bias = nn.Parameter(torch.tensor(-6.0))

    def images(self, pixels: torch.Tensor) -> torch.Tensor:
        x = pixels
        for layer in self.convolutions:
            x = torch.relu(layer(x))
        pooled = torch.cat([x.mean((2, 3)), x.amax((2, 3))], 1)
        return nn.functional.normalize(self.projection(self.drop(pooled)).float())

    def texts(self, texts: list[tuple[str, ...]]) -> torch.Tensor:
        chosen = torch.zeros(len(texts), len(WORDS))
        for i, text in enumerate(texts):
            for word in text:
                chosen[i, ROWS[word]] += 1
        return nn.functional.normalize(chosen @ self.words)

    def logits(self, images: torch.Tensor, texts: list[tuple[str, ...]]) -> torch.Tensor:
        return self.scale.exp() * images @ self.texts(texts).T + self.bias


def exported(tower: Tower) -> dict[str, np.ndarray]:
    """What `drsplat.photos.models.mini` reads, in half precision."""
    tensors: dict[str, np.ndarray] = {}
    for i, (conv, norm) in enumerate(tower.convolutions):
        gain = norm.weight / torch.sqrt(norm.running_var + norm.eps)
        weight = (conv.weight * gain[:, None, None, None]).permute(2, 3, 1, 0)
        tensors[f"conv{i}.weight"] = weight.reshape(-1, weight.shape[-1]).detach().numpy()
        tensors[f"conv{i}.bias"] = (norm.bias - norm.running_mean * gain).detach().numpy()
    tensors["projection"] = tower.projection.weight.T.detach().numpy()
    tensors["words"] = tower.words.detach().numpy()
    return {name: np.ascontiguousarray(array.astype(np.float16)) for name, array in tensors.items()}


class Crops:
    def __init__(self, paths: Sequence[Path]) -> None:
        stored = [np.load(path) for path in paths]
        self.images = np.concatenate([each["images"] for each in stored])
        side = self.images.shape[1]
        masks = np.concatenate([np.unpackbits(each["masks"], axis=1) for each in stored])
        self.masks = masks.reshape(-1, side, side).astype(bool)
        rows = np.concatenate([each["labels"] for each in stored]).tolist()
        self.labels: list[Label] = [tuple(row) for row in rows]
        self.seen = [i for i, mask in enumerate(self.masks) if mask.sum() > LEAST_PIXELS]

    def batch(self, rows: np.ndarray, rng: np.random.Generator) -> tuple[torch.Tensor, list[Label]]:
        chosen = [self.seen[row] for row in rows]
        pictures = [augmented(self.images[i], self.masks[i], rng) for i in chosen]
        labels = [self.labels[i] for i in chosen]
        for k in np.flatnonzero(rng.random(len(chosen)) < REPAINTED):
            pictures[k], labels[k] = repainted(pictures[k], rng), (labels[k][0], "", "")
        pixels = torch.from_numpy(np.stack(pictures)).permute(0, 3, 1, 2).float() / 127.5 - 1
        return pixels, labels


def doubt(logits: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
    """The sigmoid loss, summed over all pairs whose truth is known (not NaN)."""
    known = ~torch.isnan(wanted)
    return nn.functional.binary_cross_entropy_with_logits(logits[known], wanted[known], reduction="sum")


def learn(paths: Sequence[Path], epochs: int, size: int, seed: int) -> Tower:
    torch.manual_seed(seed)
    rng, crops, tower = np.random.default_rng(seed), Crops(paths), Tower()
    print(f"{len(crops.seen)} crops", flush=True)
    steps = epochs * (len(crops.seen) // size)
    optimizer = torch.optim.AdamW(tower.parameters(), 2e-3, weight_decay=0.02)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 3e-3, total_steps=steps, pct_start=0.15)
    start = time.monotonic()
    for epoch in range(epochs):
        order = rng.permutation(len(crops.seen))
        losses = []
        for at in range(0, len(order) - size + 1, size):
            pixels, labels = crops.batch(order[at : at + size], rng)
            texts = [said_of(label, rng) for label in labels] + bank(2 * size, rng)
            with torch.autocast("cpu", torch.bfloat16):  # twice as fast, and as good
                images = tower.images(pixels)
            logits = tower.logits(images, texts)
            loss = doubt(logits, torch.from_numpy(truth(labels, texts))) / size
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
            losses.append(loss.item())
        print(f"epoch {epoch + 1}: loss {np.mean(losses):.3f}, {time.monotonic() - start:.0f} s", flush=True)
    return tower.eval()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--train", type=Path, nargs="+", required=True)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--epochs", type=int, default=24)
    parser.add_argument("--batch", type=int, default=128)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    tower = learn(arguments.train, arguments.epochs, arguments.batch, arguments.seed)
    save_file(exported(tower), arguments.output)


if __name__ == "__main__":
    main()
