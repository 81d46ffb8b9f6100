"""drsplat codebook: outlined things of many photos, or embeddings -> a codebook for all scenes."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING

from ...base.progress import Stopwatch
from ...base.terminal import counted
from ...errors import FormatError, InputError
from .declaring import Facts, argument, count, count_or_all, declaration, option, whole, words
from .embed import DEFAULT_ENCODER, ENCODER_HELP, image_encoder, models_device
from .options import COMPLETE, Verb, new_or_complete, overwrite, parts_of, was_complete
from .tables import show_facts, size_text, text_of

if TYPE_CHECKING:
    from ...base.arrays import Array
    from ...field.codes import Codebook
    from ...scene.encoders import EncoderIdentity

EXAMPLES = """\
  drsplat codebook train --lvis lvis_v1_train.json --images coco --output clip.safetensors
  drsplat codebook train embeddings.npy --encoder-name ViT-B-16/laion2b_s34b_b88k --output clip.safetensors
  drsplat register scene.ply capture --features capture/language_features --codebook clip.safetensors \\
      --output scene.field

To resume a stopped run, give the same command again. drsplat inspect describes a codebook."""
DAILY = "output lvis images encoder_name overwrite"
DEFAULT_PATCHES = 17_500  # 64 for each of 256 centroids to train on, and 5 % held out
HELD_OUT_SHARE, MAX_HELD_OUT_ROWS = 0.05, 10_000


@declaration
class Options(Verb):
    """Options of this verb."""

    action: str = argument("action, the only one", choices=("train",))
    features: str | None = argument(
        "embeddings (N, D) to train on, instead of --lvis", value="FEATURES.npy", nargs="?"
    )  # fmt: skip
    output: str = option(".safetensors to write the codebook to", "FILE", flags="-o", required=True)
    overwrite: bool = overwrite()
    lvis: str | None = option(
        "annotations of LVIS v1 or COCO, JSON: polygons or run lengths", "FILE", title="source"
    )  # fmt: skip
    images: str | None = option("folder of their photos, e.g. with train2017 and val2017", "DIR", title="source")
    encoder_name: str | None = option(
        "encoder that made FEATURES.npy, e.g. ViT-B-16/laion2b_s34b_b88k", "NAME", words, title="source"
    )
    limit: int | None = option(
        "embed at most N randomly drawn patches, or 'all'. Training uses 16,384 in any case, so more only cost time "
        f"(default: {DEFAULT_PATCHES}; patches under 100 pixels are left out)", "N", count_or_all, DEFAULT_PATCHES,
        title="source",
    )  # fmt: skip
    encoder: str = option(
        f"{ENCODER_HELP}{DEFAULT_ENCODER}, the paper's)", "NAME", words, DEFAULT_ENCODER, title="source"
    )  # fmt: skip
    device: str = models_device("source")
    subvectors: int = option(
        "bytes per code; must divide the embedding size (default: 128; 64 and 32 are smaller and coarser)", "L", count,
        128, title="method",
    )  # fmt: skip
    seed: int = option("random seed (default: 0)", "N", whole, 0, title="method")


def run(options: Options) -> Facts:
    from ...field.codes import load_codebook, save_codebook

    output = new_or_complete(options.output, options.overwrite, ".safetensors")
    if (options.features is None) == (options.lvis is None):
        raise InputError("codebook train: give either FEATURES.npy or --lvis with --images")
    watch, parts = Stopwatch(), parts_of(output)
    rows, encoder, facts = _embedded(options, parts) if options.features is None else _read(options, options.features)
    watch.lap("embed")
    codebook, cosines = _trained(rows, encoder, options)
    watch.lap("train")
    complete = was_complete(output, options.overwrite, lambda: load_codebook(output).hash == codebook.hash)
    if not complete:
        save_codebook(codebook, output, overwrite=options.overwrite)
    del rows  # they may be mapped from the parts
    if options.features is None:
        shutil.rmtree(parts, ignore_errors=True)
    return {
        "codebook": output,
        "was_complete": complete,
        "encoder": encoder.name,
        "dim": encoder.dim,
        "num_subvectors": codebook.num_subvectors,
        "hash": codebook.hash,
        **facts,
        "num_held_out": len(cosines),
        "held_out_cosine": float(cosines.mean()) if len(cosines) else None,
        "held_out_cosine_worst": float(cosines.min()) if len(cosines) else None,
        **watch.measures(),
    }


def show(answer: Facts) -> None:
    held_out = answer["num_held_out"]
    facts = {
        "encoder": f"{answer['encoder']} ({answer['dim']}-d)",
        "codes": f"{answer['num_subvectors']} bytes",
        "embeddings": answer["num_embeddings"],
        "cosine": f"{answer['held_out_cosine']:.4f} on average, {answer['held_out_cosine_worst']:.4f} at worst, of "
        f"{text_of(held_out)} held out" if held_out else "not measured: one embedding",
        "time": ", ".join(f"{name} {s:.1f} s" for name, s in answer["stage_seconds"].items()),
        "peak memory": size_text(answer["peak_memory_bytes"]),
    }  # fmt: skip
    if "num_photos" in answer:
        facts["photos"] = f"{text_of(answer['num_photos'])} ({text_of(answer['num_missing_photos'])} missing)"
        facts["left out"] = counted(answer["num_left_out"], "patch", "patches")
    show_facts(f"trained: {answer['codebook']}{COMPLETE if answer['was_complete'] else ''}", facts)


def _embedded(options: Options, parts: Path) -> tuple[Array, EncoderIdentity, dict[str, int]]:
    from ...formats.lvis import read_annotations
    from ...photos.embedding.patches import embed_patches, find_patches

    if options.images is None:
        raise InputError("--lvis needs --images DIR, the folder of the annotated photos")
    source = find_patches(read_annotations(options.lvis or ""), options.images, options.limit, options.seed)
    encoder = image_encoder(options.encoder, options.device, options.threads)
    embedded = embed_patches(source, encoder, parts, options.track)
    facts = {
        "num_embeddings": len(embedded.embeddings),
        "num_photos": len(source.photos),
        "num_missing_photos": len(source.missing),
        "num_left_out": source.left_out + embedded.too_small,
    }
    return embedded.embeddings, encoder.identity, facts


def _read(options: Options, path: str) -> tuple[Array, EncoderIdentity, dict[str, int]]:
    from ... import EncoderIdentity
    from ...formats.npy import map_npy

    if options.encoder_name is None:
        raise InputError(f"{path}: the file does not name its encoder: pass --encoder-name NAME")
    rows = map_npy(Path(path))
    if rows.ndim != 2 or 0 in rows.shape or rows.dtype.kind != "f":
        raise FormatError(f"{path}: expected floats (N, D), got {rows.dtype} {rows.shape}")
    return rows, EncoderIdentity(options.encoder_name, rows.shape[1]), {"num_embeddings": len(rows)}


def _trained(rows: Array, encoder: EncoderIdentity, options: Options) -> tuple[Codebook, Array]:
    """Return the codebook, and the cosine of each held-out row with its decoded code."""
    import numpy as np

    from ... import train_codebook
    from ...field.codes.codebook import MAX_TRAINING_POINTS
    from ...formats.langsplat import unit_rows

    path = Path(options.features or options.lvis or "")
    order = np.random.default_rng(options.seed).permutation(len(rows))
    share = max(1, int(HELD_OUT_SHARE * len(rows))) if len(rows) > 1 else 0
    held_out = unit_rows(rows, order[: min(share, MAX_HELD_OUT_ROWS)], path)
    drawn = unit_rows(rows, np.sort(order[share:][:MAX_TRAINING_POINTS]), path)
    codebook = train_codebook(
        drawn, options.subvectors, encoder=encoder, seed=options.seed,
        **options.running,
    )  # fmt: skip
    codes = codebook.encode(held_out, threads=options.threads)
    cosines = (held_out * codebook.decode(codes)).sum(1) * codebook.inverse_norms(codes)
    return codebook, cosines
