"""drsplat register: a scene, its photos' poses and masks -> a field."""

import argparse
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from .code_facts import code_facts
from .leaving_out import add_without, left_out
from .options import (
    LEVEL_HELP,
    add_capture_options,
    add_features,
    add_invert_masks,
    add_kernel_device,
    add_near,
    add_overwrite,
    count,
    count_or_all,
    tracker,
    views_of,
    whole,
    words,
)
from .parts import COMPLETE, new_or_complete, parts_of, was_complete
from .workers import add_workers, in_memory, scene_of

if TYPE_CHECKING:
    from ...field import LanguageField
    from ...field.codes import Codebook, CodeSpecification
    from ...field.evidence.aggregation import Aggregator, Sampling
    from ...field.registration import Registration
    from ...formats.tiles import Tiles
    from ...scene.encoders import EncoderIdentity
    from ...scene.gaussians import Gaussians
    from ...scene.masks.features import ViewFeatures
    from ...scene.moving import Moving
    from ...scene.views import View
    from .workers import Register

DEFAULT_TOPK, DEFAULT_LEVEL = 40, "large"
EXAMPLES = """\
  drsplat register scene.ply capture --features capture/language_features --output scene.field
  drsplat register scene.ply capture --features capture/language_features --topk 45 --first-hits 100 \\
      --codebook pq_index.faiss --encoder-name ViT-B-16/laion2b_s34b_b88k --output scene.field --json

  drsplat register scene.ply capture --features capture/siglip2 --weights-of scene.field --output siglip2.field

  drsplat tile city.ply --output city.tiles
  drsplat register city.tiles capture --features capture/language_features --workers 8 --output city.field

To resume a stopped run, give the same command again."""
DAILY = ("output", "features", "codebook", "encoder_name", "overwrite", "images")


class _Inputs(NamedTuple):
    scene: "Gaussians | Moving | Tiles"
    register: "Register"
    views: "Sequence[View]"
    left_out: set[str]
    features: "Mapping[str, ViewFeatures]"
    code: "CodeSpecification"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "scene",
        help="Gaussians: .ply, .spz, .sog, .splat, .ksplat, a trained model's folder, tiles of a huge scene, or a "
        "moving scene: a folder of numbered PLY files, NAME.motion, a PLY of SpacetimeGaussians",
    )
    add_features(parser)
    parser.add_argument(
        "--output", "-o", required=True, metavar="FIELD", help="folder to write the field to, conventionally NAME.field"
    )
    parser.add_argument(
        "--weights-of", metavar="FIELD",
        help="field of the same scene, photos and masks with other embeddings: reuse its weights, level, topk, first "
        "hits and near plane; no photo is read",
    )  # fmt: skip
    add_overwrite(parser)
    _add_method(parser.add_argument_group("method"))
    parser.add_argument(
        "--parts", metavar="DIR",
        help="folder for the finished views of an unfinished run, or for tiles an address such as s3://bucket/run; "
        "never removed (default: FIELD.parts, removed at the end)",
    )  # fmt: skip
    add_kernel_device(parser)
    add_workers(parser.add_argument_group("tiles"))
    add_capture_options(parser)
    add_invert_masks(parser)
    add_without(parser)


def _add_method(method: argparse._ArgumentGroup) -> None:
    method.add_argument(
        "--level",
        "--feature-level",
        "--feature_level",
        type=_level,
        default=DEFAULT_LEVEL,
        metavar="LEVEL",
        help=LEVEL_HELP,
    )
    method.add_argument(
        "--topk", "--top-k", "-k", type=count_or_all, default=argparse.SUPPRESS, metavar="K",
        help="Gaussians to keep per pixel, by weight: a number or 'all' (default: 40, or the aggregator's)",
    )  # fmt: skip
    method.add_argument(
        "--first-hits", type=count, metavar="N",
        help="take the top K only among the first N hits of each ray; the published code uses 100 (default: no limit)",
    )  # fmt: skip
    method.add_argument(
        "--aggregator", type=words, default="mean", metavar="NAME",
        help="rule that combines the masks that see a Gaussian into its feature: mean (the paper), official (its "
        "published code), inliers, trusted or robust; see docs/aggregators.md (default: mean)",
    )  # fmt: skip
    add_near(method)
    _add_code(method)
    method.add_argument(
        "--encoder-name", type=words, metavar="NAME",
        help="encoder of embeddings that `drsplat embed` did not make, e.g. ViT-B-16/laion2b_s34b_b88k; "
        "'drsplat-words' is built in. Queries and codebooks of other encoders are then refused (default: the encoder "
        "that `drsplat embed` recorded, which cannot be changed, else the codebook's, else unknown)",
    )  # fmt: skip


def _add_code(method: argparse._ArgumentGroup) -> None:
    """Add the options of the code that features are kept in."""
    method.add_argument(
        "--code", choices=("auto", "pq", "mixture"), default="auto",
        help="pq: product quantisation, 132 bytes per Gaussian and a codebook, as in the paper. mixture: a few of the "
        "scene's own masks per Gaussian, 14 bytes and the masks' embeddings. auto: the smaller one; pq with "
        "--codebook or --subvectors (default: auto)",
    )  # fmt: skip
    method.add_argument(
        "--atoms", type=count, metavar="K", help="masks per Gaussian of a mixture, 1 to 16 (default: 4)",
    )  # fmt: skip
    method.add_argument(
        "--codebook", metavar="FILE",
        help="codebook for coding features, .safetensors or the authors' .faiss (default: trained on this scene)",
    )  # fmt: skip
    method.add_argument(
        "--subvectors", type=count, metavar="L",
        help="bytes per Gaussian of a codebook trained here (default: 128, or what divides the embedding size)",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from ...formats.field_folder import claimed_field
    from ...kernels.cuda.devices import device_in_use

    with claimed_field(new_or_complete(arguments.output, arguments.overwrite)) as output:
        return _registered(arguments, output) | {"device": device_in_use()}


def device(arguments: argparse.Namespace) -> str:
    """Return the device to register on."""
    name: str = arguments.device
    return name


def interrupted(arguments: argparse.Namespace) -> str:
    """Return what a stopped run keeps, and how to go on."""
    parts = _parts(arguments, Path(arguments.output))
    return f"the views registered so far are kept in {parts}: give the same command again to go on"


def _registered(arguments: argparse.Namespace, output: Path) -> dict[str, Any]:
    from ... import load_field
    from ...base.progress import Stopwatch
    from ...base.system import peak_memory_bytes
    from ...field.building import AtOnce
    from ...field.evidence.aggregation import aggregator
    from ...photos.embedding.growing import with_words
    from ...scene.moving import canonical_of

    watch = Stopwatch()
    how = aggregator(arguments.aggregator)
    known = _weights_of(arguments)
    sampling = _sampling(arguments, how) if known is None else known.aggregator.sampling
    inputs = _read(arguments)
    watch.lap("read")
    parts = _parts(arguments, output)
    before = _written(parts)
    shared: dict[str, Any] = {"threads": arguments.threads, "track": tracker(arguments)}
    registration = _registration(inputs, known, sampling, parts, shared)
    watch.lap("register")
    voting = how.voting is not None and isinstance(registration.coder, AtOnce)  # others have their tiles
    gaussians = canonical_of(in_memory(inputs.scene)) if voting else None
    field = registration.to_field(inputs.code, aggregator=how, gaussians=gaussians, **shared)
    field = with_words(field, arguments.features)
    watch.lap("code")
    complete = was_complete(output, arguments.overwrite, lambda: load_field(output).equals(field))
    if not complete:
        field.save(output, overwrite=arguments.overwrite)
    watch.lap("save")
    computed = len(_written(parts).items() - before.items())
    if arguments.parts is None:
        shutil.rmtree(parts, ignore_errors=True)
    return {
        "field": str(output),
        "was_complete": complete,
        **_facts(registration, field),
        "num_views_reused": None if "://" in str(parts) else len(registration.masks.view_names) - computed,
        "left_out": sorted(inputs.left_out),
        "topk": registration.sampling.topk if registration.sampling else None,
        "seconds": sum(watch.seconds.values()),
        "stage_seconds": watch.seconds,
        "field_bytes": sum(file.stat().st_size for file in output.rglob("*") if file.is_file()),
        "peak_memory_bytes": peak_memory_bytes(),
    }


def _registration(
    given: "_Inputs", known: "LanguageField | None", sampling: "Sampling | None", parts: str | Path,
    shared: Mapping[str, Any],
) -> "Registration":  # fmt: skip
    from ...field.evidence.aggregation import Sampling
    from ...field.growing import with_weights_of

    if known is not None and sampling is not None:
        return with_weights_of(known, in_memory(given.scene), given.views, given.features, track=shared["track"])
    made = given.register(given.scene, given.views, given.features, sampling or Sampling(), parts=parts, **shared)
    return replace(made, left_out=tuple(sorted(given.left_out)))


def _read(arguments: argparse.Namespace) -> "_Inputs":
    from ... import read_features

    (scene, register), views = scene_of(arguments), views_of(arguments, arguments.capture)
    without = left_out([view.name for view in views], arguments.without)
    codebook = _codebook(arguments)
    code = _code(arguments, codebook)
    features = read_features(arguments.features, level=arguments.level, encoder=_encoder(arguments, codebook))
    kept = [view for view in views if view.name not in without]
    return _Inputs(scene, register, kept, without, features, code)


def _facts(registration: "Registration", field: "LanguageField") -> dict[str, Any]:
    from ...scene.views import pictures_kind, scenes_rendered

    return {
        "num_gaussians": field.num_gaussians,
        "num_registered": len(field),
        "num_views": len(registration.masks.view_names),
        "pictures": pictures_kind(field.rendered_from),
        "rendered_from": scenes_rendered(field.rendered_from),
        "num_times": None if field.times is None else len(set(field.times.tolist())),
        "num_masks": len(registration.masks),
        "num_weights": int(registration.weights.nnz),
        "dim": field.encoder.dim,
        "encoder": field.encoder.name,
        **code_facts(field.code),
        "aggregator": field.aggregator.name,
        "near": registration.sampling.near if registration.sampling else None,
    }


def _code(arguments: argparse.Namespace, codebook: "Codebook | None") -> "CodeSpecification":
    from ...errors import InputError
    from ...field.codes import PQ, Mixture, Smaller
    from ...field.codes.mixture import DEFAULT_ATOMS_PER_ROW

    quantised = arguments.code == "pq" or codebook is not None or arguments.subvectors is not None
    mixed = arguments.code == "mixture" or arguments.atoms is not None
    if mixed and quantised:
        raise InputError(
            "--code mixture and --atoms go with neither --codebook, --subvectors nor --code pq: drop one of them"
        )
    if quantised:
        return codebook or PQ(arguments.subvectors)
    return (Mixture if mixed else Smaller)(arguments.atoms or DEFAULT_ATOMS_PER_ROW)


def show(answer: dict[str, Any]) -> None:
    from .tables import show_facts, size_text, text_of

    reused = f" ({answer['num_views_reused']} from an earlier run)" if answer["num_views_reused"] else ""
    out = f", {text_of(len(answer['left_out']))} left out" if answer["left_out"] else ""
    stages = ", ".join(f"{name} {seconds:.1f}" for name, seconds in answer["stage_seconds"].items())
    share = answer["num_registered"] / max(1, answer["num_gaussians"])
    show_facts(
        f"registered: {answer['field']}{COMPLETE if answer['was_complete'] else ''}",
        {
            "Gaussians": f"{text_of(answer['num_registered'])} of {text_of(answer['num_gaussians'])} ({share:.1%})",
            "views": f"{text_of(answer['num_views'])} {answer['pictures']}{_at_times(answer)}{reused}{out}",
            "masks": f"{text_of(answer['num_masks'])}, embedded by {answer['encoder']} ({answer['dim']}-d)",
            "weights": text_of(answer["num_weights"]),
            "codes": f"{answer['bytes_per_gaussian']} bytes per Gaussian",
            "field": size_text(answer["field_bytes"]),
            "time": f"{answer['seconds']:.1f} s ({stages})",
            "peak memory": size_text(answer["peak_memory_bytes"]),
        },
    )


def _at_times(answer: dict[str, Any]) -> str:
    return f" at {answer['num_times']:,} times" if answer["num_times"] else ""


def _parts(arguments: argparse.Namespace, output: Path) -> str | Path:
    """Return the folder of --parts, or its address of `field.tiles.store`."""
    given = arguments.parts or parts_of(output)
    return given if "://" in str(given) else Path(given)


def _weights_of(arguments: argparse.Namespace) -> "LanguageField | None":
    """Return the field of --weights-of; its settings become those of the command.

    Raises: InputError: options about what the field has settled.
    """
    from ... import load_field
    from ...errors import InputError

    if arguments.weights_of is None:
        return None
    given = {"--topk": hasattr(arguments, "topk"), "--level": arguments.level != DEFAULT_LEVEL}
    given |= {f"--{name.replace('_', '-')}": getattr(arguments, name) for name in ("first_hits", "near", "without")}
    clashing = [flag for flag, value in given.items() if value]
    if clashing:
        raise InputError(f"--weights-of FIELD takes these from the field: drop {' and '.join(clashing)}")
    field = load_field(arguments.weights_of)
    if field.growth is not None:
        arguments.level = field.growth.provenance.level or DEFAULT_LEVEL
    return field


def _written(parts: str | Path) -> dict[str, int]:
    """Return when each finished view's file was written."""
    return {file.name: file.stat().st_mtime_ns for file in Path(parts).glob("*.columns.safetensors")}


def _sampling(arguments: argparse.Namespace, how: "Aggregator") -> "Sampling":
    """Return the aggregator's own sampling where it has one; --topk and --first-hits may not contradict it."""
    from ...errors import InputError
    from ...field.evidence.aggregation import Sampling

    given = {} if arguments.first_hits is None else {"first_hits": arguments.first_hits}
    given |= {"topk": arguments.topk} if hasattr(arguments, "topk") else {}
    own = how.sampling
    if own is None:
        return Sampling(**({"topk": DEFAULT_TOPK} | given), near=arguments.near)
    for name, value in given.items():
        if value != getattr(own, name):
            raise InputError(f"--aggregator {how.name} has its own --{name.replace('_', '-')}: drop that option")
    return replace(own, near=arguments.near)


def _level(text: str) -> str | int:
    """Return a level as a number from 0 to 3, or as a name, which the reader of features checks."""
    return whole(text, most=3) if text.isdecimal() else words(text)


def _codebook(arguments: argparse.Namespace) -> "Codebook | None":
    from ...errors import InputError
    from ...field.codes.official import read_codebook

    if arguments.codebook is None:
        return None
    if arguments.subvectors is not None:
        raise InputError("--subvectors is for a codebook trained here; --codebook has its own: drop one of them")
    return read_codebook(arguments.codebook, arguments.encoder_name)


def _encoder(arguments: argparse.Namespace, codebook: "Codebook | None") -> "EncoderIdentity | None":
    from ... import EncoderIdentity, WordEncoder
    from ...formats.langsplat import FeatureFolder
    from ...photos.embedding.embed import recorded_encoder

    noted = recorded_encoder(arguments.features)
    if arguments.encoder_name is None:
        return noted or (codebook.encoder if codebook else None)
    if arguments.encoder_name == WordEncoder.identity.name:
        return WordEncoder.identity
    if codebook is not None and codebook.encoder.name == arguments.encoder_name:
        return codebook.encoder
    dim = FeatureFolder(Path(arguments.features), 0).dim
    return EncoderIdentity(arguments.encoder_name, dim)
