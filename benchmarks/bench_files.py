"""What files cost: features in both forms, and comparing a field with its checksums beside loading it.

    python benchmarks/bench_files.py [--gaussians 1000000] [--capture FOLDER ...]

Features are those of `drsplat embed --segmenter graph --encoder drsplat-mini`, of the photos of each capture.
"""

import argparse
import contextlib
import io
import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array

from drsplat import EncoderIdentity, LanguageField, cli, load_field
from drsplat.field.codes.mixture import MixtureCode
from drsplat.field.codes.mixture.code import packed
from drsplat.field.codes.mixture.dictionary import AtomTable
from drsplat.field.evidence.evidence import Evidence, MaskIds
from drsplat.formats.tensors import read_tensors
from drsplat.kernels.mixture import Dictionary

sys.path.insert(0, str(Path(__file__).parent))
from machine import describe, interleaved

DIM, MASKS, PER_ROW, PHOTOS = 512, 5_000, 40, 100
ROUNDS = 9


def large_field(rows: int) -> LanguageField:
    """A mixture of four atoms per row and 40 weights, all drawn."""
    rng = np.random.default_rng(0)
    embeddings = rng.standard_normal((MASKS, DIM), dtype=np.float32)
    embeddings /= np.linalg.norm(embeddings, axis=1, keepdims=True)
    values = np.round(embeddings * 127 / np.abs(embeddings).max()).astype(np.int8)
    lengths = np.linalg.norm(values.astype(np.float32), axis=1)
    atoms = AtomTable(Dictionary(values, 1 / lengths), np.arange(MASKS, dtype=np.int32))
    ids = rng.integers(0, MASKS, (rows, 4)).astype(np.uint16)
    blocks = packed(ids, rng.integers(1, 255, ids.shape).astype(np.uint8), np.full(rows, 0.01))
    indices = np.sort(rng.integers(0, MASKS, (rows, PER_ROW), dtype=np.int32), axis=1).ravel()
    starts = np.arange(0, rows * PER_ROW + 1, PER_ROW, dtype=np.int32)
    weights = csr_array((rng.random(len(indices), np.float32), indices, starts), shape=(rows, MASKS))
    views = np.sort(rng.integers(0, PHOTOS, MASKS)).astype(np.int32)
    names = tuple(f"{number}.jpg" for number in range(PHOTOS))
    evidence = Evidence(weights, MaskIds(names, views, np.arange(MASKS, dtype=np.int32)), embeddings)
    drawn = EncoderIdentity("drawn", DIM)
    return LanguageField(
        np.arange(rows, dtype=np.uint32), MixtureCode(blocks, atoms), drawn, f"{rows}-0", rows, evidence
    )


def show_checksums(rows: int, folder: Path) -> None:
    path = folder / "a.field"
    large_field(rows).save(path)
    seconds = interleaved(
        {
            "load": lambda: load_field(path),
            "load, then compare codes": lambda: load_field(path).code,
            "load, then compare all": lambda: load_field(path).verify(),
        },
        ROUNDS,
    )
    load = np.median(seconds["load"])
    print(f"{rows:,} Gaussians of {PER_ROW} weights, {sum(f.stat().st_size for f in path.iterdir()) / 1e6:.0f} MB")
    for name, taken in seconds.items():
        print(f"  {name:28s} {np.median(taken) * 1e3:7.1f} ms, {np.median(taken) / load:5.2f} x loading")


def bytes_of(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def show_features(capture: Path, folder: Path) -> None:
    print(f"{capture.name}: photos {bytes_of(capture / 'images') / 1e6:.1f} MB")
    for options in ([], ["--langsplat"]):
        output = folder / f"{capture.name}{''.join(options)}"
        command = ["embed", str(capture), "--segmenter", "graph", "--encoder", "drsplat-mini"]
        start = time.perf_counter()
        said = io.StringIO()
        with contextlib.redirect_stdout(said):
            assert cli.main([*command, "--output", str(output), "--json", *options]) == 0
        masks = json.loads(said.getvalue())["num_masks"]
        arrays = "".join(sorted({path.suffix for path in output.rglob("*") if path.is_file()}))
        print(f"  {' '.join(options) or 'compact':12s} {bytes_of(output) / 1e6:8.1f} MB, {masks:,} masks, "
              f"{time.perf_counter() - start:.0f} s, {arrays}")  # fmt: skip
    maps = rows = 0
    for path in (folder / capture.name).rglob("*.safetensors"):
        tensors, _ = read_tensors(path)
        rows += tensors.pop("embeddings").nbytes
        maps += sum(array.nbytes for array in tensors.values())
    print(f"  compact: maps {maps / 1e6:.1f} MB, embeddings {rows / 1e6:.1f} MB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--gaussians", type=int, default=1_000_000)
    parser.add_argument("--capture", type=Path, nargs="*", default=[])
    given = parser.parse_args()
    print(describe())
    with tempfile.TemporaryDirectory() as folder:
        show_checksums(given.gaussians, Path(folder))
        for capture in given.capture:
            show_features(capture, Path(folder))


if __name__ == "__main__":
    main()
