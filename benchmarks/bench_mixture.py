"""Searching in the mixture code beside our own product quantisation of 128 bytes, in one process and in turns.

    python benchmarks/bench_mixture.py FIELD [--points 1000000] [--threads 1] [--rounds 15]
        [--more-atoms 34000] [--json out.json]

FIELD: a field saved with its evidence. Its rows are encoded as mixtures of 2, 4 and 8 atoms, and repeated, rows of
both codes alike, up to --points. Times are minima of wall time of what a caller waits for: the scores of
the dictionary's atoms, or the look-up tables, and the scan. --more-atoms: fills the dictionary up to so many, which
makes it one of a larger capture, with ids spread over it.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
from machine import arguments, describe, interleaved
from search_rivals import Run

from drsplat import LanguageField, load_field
from drsplat.field.codes import Code, PQCode
from drsplat.field.codes.mixture import AtomTable, MixtureCode, encode_mixture, quantised
from drsplat.field.evidence.evidence import Evidence
from drsplat.kernels import default_isa
from drsplat.kernels.mixture import Blocks

PER_ROW = (2, 4, 8)
CHECKED = 50_000  # rows whose winners are compared with those of exact features


def repeated(code: Code, points: int) -> Code:
    return code.rows(np.arange(points) % len(code))


def with_more_atoms(code: MixtureCode, count: int) -> MixtureCode:
    """Atoms of random directions among the others; a row's atoms are as far apart as its columns were."""
    rng, old = np.random.default_rng(0), len(code.atoms)
    places = np.sort(rng.choice(count, old, replace=False))
    vectors = rng.standard_normal((count, code.dim), np.float32)
    vectors[places] = code.atoms.vectors(np.arange(old))
    masks = np.full(count, -1, np.int32)
    masks[places] = code.atoms.masks
    ids = places.astype(np.uint16)[code.blocks.ids]
    return MixtureCode(Blocks(ids, *code.blocks[1:]), AtomTable(quantised(vectors), masks))


def drawn_queries(evidence: Evidence, count: int) -> np.ndarray:
    """MaskIds of the scene, each turned away from itself."""
    rng = np.random.default_rng(1)
    drawn = evidence.embeddings[rng.choice(len(evidence.embeddings), count)]
    turned = drawn + 0.05 * rng.standard_normal(drawn.shape)
    return (turned / np.linalg.norm(turned, axis=1, keepdims=True)).astype(np.float32)


def encoded(evidence: Evidence, threads: int) -> dict[str, MixtureCode]:
    codes = {}
    for per_row in PER_ROW:
        start = time.perf_counter()
        codes[f"mixture K={per_row}"] = code = encode_mixture(evidence, per_row, threads=threads)
        seconds = time.perf_counter() - start
        print(f"mixture K={per_row}: {len(code):,} rows encoded in {seconds:.1f} s; {code.row_bytes} bytes per row and "
              f"{code.atoms.nbytes / len(code):.1f} of {len(code.atoms):,} atoms")  # fmt: skip
    return codes


def shown(title: str, rivals: dict[str, Run], rounds: int, reference: str) -> dict[str, float]:
    times = {name: 1e3 * float(s.min()) for name, s in interleaved(rivals, rounds).items()}
    print(f"\n{title}")
    for name, least in times.items():
        print(f"  {name:<44} {least:9.2f} ms   {times[reference] / least:6.2f} x as fast as {reference}")
    return times


def single(codes: dict[str, Code], query: np.ndarray, args: argparse.Namespace) -> dict[str, object]:
    pq, reference = codes["PQ 128"], "PQ 128, all scores"
    assert isinstance(pq, PQCode)
    cut = float(np.quantile(pq.scores(query[None])[0], 0.99))
    rivals: dict[str, Run] = {}
    for name, code in codes.items():
        rivals[f"{name}, all scores"] = lambda c=code: c.scores(query[None], threads=args.threads)
        rivals[f"{name}, list of the best 1 %"] = lambda c=code: c.select(query, cut, threads=args.threads)
        rivals[f"{name}, top 100"] = lambda c=code: c.top(query, 100, threads=args.threads)
    return shown(f"one query, {args.points:,} rows", rivals, args.rounds, reference)  # type: ignore[return-value]


def many(
    codes: dict[str, Code], field: LanguageField, queries: np.ndarray, args: argparse.Namespace
) -> dict[str, object]:
    rivals: dict[str, Run] = {
        name: lambda c=code: c.best(queries, threads=args.threads) for name, code in codes.items()
    }
    title = f"best of {len(queries)} queries, {args.points:,} rows"
    times = shown(title, rivals, max(3, args.rounds // 3), "PQ 128")
    assert field.evidence is not None
    rows = min(CHECKED, len(field))
    exact = (field.evidence.features(0, rows) @ queries.T).argmax(axis=1)
    agreement = {}
    for name, code in codes.items():
        index = code.best(queries).index[:rows]
        decoded = (code.decode(np.arange(rows)) @ queries.T).argmax(axis=1)
        agreement[name] = float((index == exact).mean()), float((index == decoded).mean())
        print(
            f"  {name:<14} the winner of exact features {agreement[name][0]:.2%}, of decoded ones "
            f"{agreement[name][1]:.2%}"
        )
    return {"ms": times, "agreement": agreement}


def main() -> None:
    args = arguments(__doc__, "field", points=1_000_000, threads=1, rounds=15, more_atoms=34_000, json=Path)
    field = load_field(args.field)
    if field.evidence is None or not isinstance(field.code, PQCode):
        raise SystemExit("expected a field with product-quantised codes and its evidence")
    print(f"kernels {default_isa()}, {args.threads} threads")
    mixed = encoded(field.evidence, args.threads)
    codes: dict[str, Code] = {"PQ 128": field.code, **mixed}
    wide = with_more_atoms(mixed["mixture K=4"], args.more_atoms)
    codes[f"mixture K=4 of {args.more_atoms:,} atoms"] = wide
    codes = {name: repeated(code, args.points) for name, code in codes.items()}
    queries = drawn_queries(field.evidence, 200)
    found = {"machine": describe(), "single": single(codes, queries[0], args)}
    for count in (20, 200):
        found[str(count)] = many(codes, field, queries[:count], args)
    if args.json:
        args.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
