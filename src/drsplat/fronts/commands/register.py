"""drsplat register: a scene, its photos' poses and masks -> a field."""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ...errors import InputError
from .declaring import Facts, argument, count, count_or_all, declaration, option, part, whole, words
from .options import (
    COMPLETE,
    LEVEL_HELP,
    Photos,
    Verb,
    capture,
    features,
    invert_masks,
    kernel_device,
    left_out,
    near,
    new_or_complete,
    overwrite,
    parts_of,
    was_complete,
    without,
)
from .tables import code_facts
from .workers import Workers, in_memory, scene_of

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
DAILY = "output features codebook encoder_name overwrite images"


class _Inputs(NamedTuple):
    scene: "Gaussians | Moving | Tiles"
    register: "Register"
    views: "Sequence[View]"
    left_out: set[str]
    features: "Mapping[str, ViewFeatures]"
    code: "CodeSpecification"


def _level(text: str) -> str | int:
    """Return a level as a number from 0 to 3, or as a name, which the reader of features checks."""
    return whole(text, most=3) if text.isdecimal() else words(text)


def _topk(text: str) -> int:
    """Return an option's number of Gaussians; 0 stands for all."""
    return count_or_all(text) or 0


@declaration
class Method:
    """How masks become features, and what code these are kept in."""

    TITLE = "method"
    level: str | int = option(
        LEVEL_HELP, "LEVEL", _level, DEFAULT_LEVEL, flags="--level --feature-level --feature_level"
    )  # fmt: skip
    topk: int | None = option(
        "Gaussians to keep per pixel, by weight: a number or 'all' (default: 40, or the aggregator's)", "K", _topk,
        flags="--topk --top-k -k",
    )  # fmt: skip
    first_hits: int | None = option(
        "take the top K only among the first N hits of each ray; the published code uses 100 (default: no limit)",
        "N", count,
    )  # fmt: skip
    aggregator: str = option(
        "rule that combines the masks that see a Gaussian into its feature: mean (the paper), official (its published "
        "code), inliers, trusted or robust; see docs/aggregators.md (default: mean)", "NAME", words, "mean",
    )  # fmt: skip
    near: float | None = near()
    code: str = option(
        "pq: product quantisation, 132 bytes per Gaussian and a codebook, as in the paper. mixture: a few of the "
        "scene's own masks per Gaussian, 14 bytes and the masks' embeddings. auto: the smaller one; pq with --codebook "
        "or --subvectors (default: auto)", default="auto", choices=("auto", "pq", "mixture"),
    )  # fmt: skip
    atoms: int | None = option("masks per Gaussian of a mixture, 1 to 16 (default: 4)", "K", count)
    codebook: str | None = option(
        "codebook for coding features, .safetensors or the authors' .faiss (default: trained on this scene)", "FILE"
    )
    subvectors: int | None = option(
        "bytes per Gaussian of a codebook trained here (default: 128, or what divides the embedding size)", "L", count
    )
    encoder_name: str | None = option(
        "encoder of embeddings that `drsplat embed` did not make, e.g. ViT-B-16/laion2b_s34b_b88k; 'drsplat-words' is "
        "built in. Queries and codebooks of other encoders are then refused (default: the encoder that `drsplat embed` "
        "recorded, which cannot be changed, else the codebook's, else unknown)", "NAME", words,
    )  # fmt: skip


@declaration
class Options(Verb):
    """Options of this verb."""

    scene: str = argument(
        "Gaussians: .ply, .spz, .sog, .splat, .ksplat, a trained model's folder, tiles of a huge scene, or a moving "
        "scene: a folder of numbered PLY files or NAME.motion"
    )
    capture: str = capture()
    features: str = features()
    output: str = option(
        "folder to write the field to, conventionally NAME.field", "FIELD", flags="-o", required=True
    )  # fmt: skip
    weights_of: str | None = option(
        "field of the same scene, photos and masks with other embeddings: reuse its weights, level, topk, first hits "
        "and near plane; no photo is read", "FIELD",
    )  # fmt: skip
    overwrite: bool = overwrite()
    method: Method = part(Method)
    parts: str | None = option(
        "folder for the finished views of an unfinished run, or for tiles an address such as s3://bucket/run; never "
        "removed (default: FIELD.parts, removed at the end)", "DIR",
    )  # fmt: skip
    device: str = kernel_device()
    workers: Workers = part(Workers)
    photos: Photos = part(Photos)
    invert_masks: bool = invert_masks()
    without: str | None = without()

    @property
    def parts_place(self) -> str | Path:
        """Folder of --parts, or its address of `field.tiles.store`."""
        given = self.parts or parts_of(self.output)
        return given if "://" in str(given) else Path(given)


def run(options: Options) -> Facts:
    from ...formats.field_folder import claimed_field
    from ...kernels.cuda.devices import device_in_use

    with claimed_field(new_or_complete(options.output, options.overwrite)) as output:
        return _registered(options, output) | {"device": device_in_use()}


def device(options: Options) -> str:
    """Return the device to register on."""
    return options.device


def interrupted(options: Options) -> str:
    """Return what a stopped run keeps, and how to go on."""
    return f"the views registered so far are kept in {options.parts_place}: give the same command again to go on"


def _registered(options: Options, output: Path) -> Facts:
    from ...base.progress import Stopwatch
    from ...base.system import folder_bytes, peak_memory_bytes
    from ...field.building import AT_ONCE
    from ...field.evidence.aggregation import aggregator
    from ...photos.embedding.growing import with_words
    from ...scene.moving import canonical_of

    watch = Stopwatch()
    how = aggregator(options.method.aggregator)
    known = _weights_of(options)
    sampling = _sampling(options.method, how) if known is None else known.aggregator.sampling
    inputs = _read(options, known)
    watch.lap("read")
    parts = options.parts_place
    before = _written(parts)
    shared: dict[str, Any] = {"threads": options.threads, "track": options.track}
    registration = _registration(inputs, known, sampling, parts, shared)
    watch.lap("register")
    voting = how.voting is not None and registration.coder is AT_ONCE  # others have their tiles
    gaussians = canonical_of(in_memory(inputs.scene)) if voting else None
    field = registration.to_field(inputs.code, aggregator=how, gaussians=gaussians, **shared)
    field = with_words(field, options.features)
    watch.lap("code")
    complete = _was_saved(field, output, options.overwrite)
    watch.lap("save")
    computed = len(_written(parts).items() - before.items())
    if options.parts is None:
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
        "field_bytes": folder_bytes(output),
        "peak_memory_bytes": peak_memory_bytes(),
    }


def _was_saved(field: "LanguageField", output: Path, overwrite: bool) -> bool:
    """Save a field, unless it lies there already; return whether it did."""
    from ... import load_field

    complete = was_complete(output, overwrite, lambda: load_field(output).equals(field))
    if not complete:
        field.save(output, overwrite=overwrite)
    return complete


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


def _read(options: Options, known: "LanguageField | None") -> "_Inputs":
    from ...formats.langsplat import read_features

    scene, register = scene_of(options.scene, options.workers, options.parts, options.threads)
    views = options.photos.views(options.capture, options.invert_masks)
    out = left_out([view.name for view in views], options.without)
    method, level = options.method, options.method.level
    codebook = _codebook(method)
    if known is not None and known.growth is not None:
        level = known.growth.provenance.level or DEFAULT_LEVEL
    encoder = _named_encoder(method.encoder_name, codebook)
    features = read_features(options.features, level, encoder, codebook.encoder if codebook else None)
    if features.record is not None:
        features.record.whole()
    kept = [view for view in views if view.name not in out]
    return _Inputs(scene, register, kept, out, features, _code(method, codebook))


def _facts(registration: "Registration", field: "LanguageField") -> Facts:
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


def _code(method: Method, codebook: "Codebook | None") -> "CodeSpecification":
    from ...field.codes import PQ, Mixture, Smaller
    from ...field.codes.mixture import DEFAULT_ATOMS_PER_ROW

    quantised = method.code == "pq" or codebook is not None or method.subvectors is not None
    mixed = method.code == "mixture" or method.atoms is not None
    if mixed and quantised:
        raise InputError(
            "--code mixture and --atoms go with neither --codebook, --subvectors nor --code pq: drop one of them"
        )
    if quantised:
        return codebook or PQ(method.subvectors)
    return (Mixture if mixed else Smaller)(method.atoms or DEFAULT_ATOMS_PER_ROW)


def show(answer: Facts) -> None:
    from .tables import show_facts, size_text, text_of

    reused = f" ({answer['num_views_reused']} from an earlier run)" if answer["num_views_reused"] else ""
    out = f", {text_of(len(answer['left_out']))} left out" if answer["left_out"] else ""
    times = f" at {answer['num_times']:,} times" if answer["num_times"] else ""
    stages = ", ".join(f"{name} {seconds:.1f}" for name, seconds in answer["stage_seconds"].items())
    share = answer["num_registered"] / max(1, answer["num_gaussians"])
    show_facts(
        f"registered: {answer['field']}{COMPLETE if answer['was_complete'] else ''}",
        {
            "Gaussians": f"{text_of(answer['num_registered'])} of {text_of(answer['num_gaussians'])} ({share:.1%})",
            "views": f"{text_of(answer['num_views'])} {answer['pictures']}{times}{reused}{out}",
            "masks": f"{text_of(answer['num_masks'])}, embedded by {answer['encoder']} ({answer['dim']}-d)",
            "weights": answer["num_weights"],
            "codes": f"{answer['bytes_per_gaussian']} bytes per Gaussian",
            "field": size_text(answer["field_bytes"]),
            "time": f"{answer['seconds']:.1f} s ({stages})",
            "peak memory": size_text(answer["peak_memory_bytes"]),
        },
    )


def _weights_of(options: Options) -> "LanguageField | None":
    """Return the field of --weights-of, whose settings are those of the command.

    Raises: InputError: options about what the field has settled.
    """
    from ... import load_field

    if options.weights_of is None:
        return None
    method = options.method
    given: dict[str, object] = {"--topk": method.topk is not None, "--level": method.level != DEFAULT_LEVEL}
    given |= {"--first-hits": method.first_hits, "--near": method.near, "--without": options.without}
    clashing = [flag for flag, value in given.items() if value]
    if clashing:
        raise InputError(f"--weights-of FIELD takes these from the field: drop {' and '.join(clashing)}")
    return load_field(options.weights_of)


def _written(parts: str | Path) -> dict[str, int]:
    """Return when each finished view's file was written."""
    return {file.name: file.stat().st_mtime_ns for file in Path(parts).glob("*.columns.safetensors")}


def _sampling(method: Method, how: "Aggregator") -> "Sampling":
    """Return the aggregator's own sampling where it has one; --topk and --first-hits may not contradict it."""
    from ...field.evidence.aggregation import Sampling

    given: dict[str, Any] = {} if method.first_hits is None else {"first_hits": method.first_hits}
    given |= {} if method.topk is None else {"topk": method.topk or None}
    own = how.sampling
    if own is None:
        return Sampling(**({"topk": DEFAULT_TOPK} | given), near=method.near)
    for name, value in given.items():
        if value != getattr(own, name):
            raise InputError(f"--aggregator {how.name} has its own --{name.replace('_', '-')}: drop that option")
    return replace(own, near=method.near)


def _codebook(method: Method) -> "Codebook | None":
    from ...field.codes.official import read_codebook

    if method.codebook is None:
        return None
    if method.subvectors is not None:
        raise InputError("--subvectors is for a codebook trained here; --codebook has its own: drop one of them")
    return read_codebook(method.codebook, method.encoder_name)


def _named_encoder(name: str | None, codebook: "Codebook | None") -> "EncoderIdentity | str | None":
    """Return all that is known of the encoder of this name."""
    from ... import WordEncoder

    known = [WordEncoder.identity] if codebook is None else [WordEncoder.identity, codebook.encoder]
    return next((one for one in known if one.name == name), name)
