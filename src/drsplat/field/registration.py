"""Language features registered straight onto Gaussians: the paper's method on one screen.

`register` streams the views. Each gives the columns of its masks in the sparse matrix W
(Gaussians x masks): W[i, j] = sum over pixels p of mask j of the blending weight of Gaussian i at p,
where i is among the top k of p. Everything after that is algebra on W and the masks' embeddings.
"""

import tempfile
from collections.abc import Collection, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from warnings import warn

import numpy as np
from scipy.sparse import csr_array

from ..base.arrays import Doubles, Embeddings, FloatRows, Vector3
from ..base.terminal import counted, facts_html
from ..errors import DrSplatWarning, InputError, MismatchError, did_you_mean
from ..formats.replacing import brief
from ..kernels import default_isa
from ..kernels.splatting import release_workspaces
from ..scene.boxes import camera_axes
from ..scene.encoders import EncoderIdentity
from ..scene.gaussians import Gaussians
from ..scene.masks.features import ViewFeatures
from ..scene.masks.masks import LEVELS
from ..scene.moving import Moving
from ..scene.photo_masks import keeps_nothing, views_with_something
from ..scene.units import doubts
from ..scene.views import View
from . import AT_ONCE, LanguageField, RowCoder, build_field, whole_evidence
from .codes import PQ, CodeSpecification, Track, untracked
from .evidence.aggregation import Aggregator, Sampling
from .evidence.aggregation import aggregator as named
from .evidence.changing import with_views, without_views
from .evidence.columns import ColumnMaker, scenery_of, stacked, time_of
from .evidence.evidence import Evidence, MaskIds
from .evidence.provenance import Provenance, cameras_of

UNKNOWN_ENCODER = "unknown"
MIN_SPAN_SHARE = 0.05  # photos whose times fill less of the scene's span are warned of


@dataclass(frozen=True, eq=False)
class Registration:
    """Result of registration: W, its columns and their embeddings.

    evidence: the weights (N, M), the view and mask behind each column, one embedding per column.
    scene: fingerprint of the Gaussians. encoder: who made the embeddings. sampling: how the photos were
    looked at; None: unknown. up: the direction that is up in the photos (`boxes.upward`); None: they do not tell.
    left_out: names of photos that were kept from it on purpose. provenance: how the columns came about; None: unknown,
    as of fields of older versions. coder: who codes the rows of a field.
    """

    evidence: Evidence
    scene: str
    encoder: EncoderIdentity
    sampling: Sampling | None = None
    up: Vector3 | None = None
    left_out: tuple[str, ...] = ()
    provenance: Provenance | None = None
    coder: RowCoder = AT_ONCE

    def __repr__(self) -> str:
        count, masks = self.weights.shape
        views = counted(len(self.masks.view_names), "view")
        return (
            f"Registration({counted(count, 'Gaussian')} x {counted(masks, 'mask')} of {views}, "
            f"{counted(self.weights.nnz, 'weight')}, {self.encoder.dim}-d by {self.encoder.name})"
        )

    def _repr_html_(self) -> str:
        count, masks = self.weights.shape
        facts = {
            "Gaussians": f"{self.num_registered:,} seen of {count:,}",
            "masks": f"{masks:,} of {counted(len(self.masks.view_names), 'view')}",
            "weights": f"{self.weights.nnz:,}",
            "encoder": f"{self.encoder.name}, {self.encoder.dim} numbers",
            "left out": ", ".join(self.left_out) or "none",
        }
        return facts_html("Registration", facts)

    @classmethod
    def from_field(cls, field: LanguageField) -> "Registration":
        """Return the registration that a field was made from, to add views or change the encoder without any photo.

        Raises: InputError: the field was saved without its evidence.
        """
        if field.evidence is None:
            raise InputError("this field holds no evidence: register again and keep it")
        evidence, growth = whole_evidence(field), field.growth
        provenance = None if growth is None else growth.provenance
        sampling = field.aggregator.sampling
        return cls(evidence, field.scene, field.encoder, sampling, field.up, field.left_out, provenance)

    @property
    def weights(self) -> csr_array:
        """W, (N, M) float32: row i of Gaussian i, columns ordered by view name, then mask id."""
        return self.evidence.weights

    @property
    def masks(self) -> MaskIds:
        return self.evidence.masks

    @property
    def embeddings(self) -> Embeddings:
        return self.evidence.embeddings

    @property
    def num_registered(self) -> int:
        """Gaussians that at least one mask pixel sees among its top k."""
        return self.evidence.num_seen

    def to_field(
        self,
        code: CodeSpecification = PQ(),
        *,
        aggregator: str | Aggregator = "mean",
        gaussians: Gaussians | None = None,
        threads: int = 0,
        track: Track = untracked,
    ) -> LanguageField:
        """Make a field: one coded feature per Gaussian, without unseen Gaussians.

        code: `PQ()` trains a codebook on this scene, `Mixture()` makes rows of its masks, `Smaller()` takes what is
        smaller of the two; or a `Codebook` that is ready. aggregator: how a Gaussian's
        votes become its feature, the paper's weighted mean or another of docs/aggregators.md; those that
        look at neighbours need the `gaussians` that were registered. track: shows progress.

        Raises: InputError: no aggregator of that name, or it needs the Gaussians. MismatchError: other
        Gaussians, or an aggregator for photos looked at in another way.
        """
        how = named(aggregator) if isinstance(aggregator, str) else aggregator
        self._check(how, gaussians)
        aggregated = self.coder.aggregated(how, self.evidence, gaussians, threads, track)
        aggregated = replace(aggregated, record=how.record(self.sampling))
        field = build_field(
            self.evidence, self.scene, self.encoder, code,
            aggregated=aggregated, provenance=self.provenance, coder=self.coder, threads=threads, track=track,
        )  # fmt: skip
        return replace(field, up=self.up, left_out=self.left_out)

    def _check(self, how: Aggregator, gaussians: Gaussians | None) -> None:
        wanted = how.sampling
        if wanted and self.sampling and wanted.near is None:  # whatever the scene's was
            wanted = replace(wanted, near=self.sampling.near)
        if wanted not in (None, self.sampling):
            raise MismatchError(
                f"aggregator '{how.name}' is for {how.sampling}, this registration is of "
                f"{self.sampling or 'unknown sampling'}: pass sampling={how.sampling} to register"
            )
        if gaussians is not None and gaussians.fingerprint != self.scene:
            raise MismatchError(
                f"these Gaussians are {gaussians.fingerprint}, registered was {self.scene}: pass those registered"
            )

    def with_embeddings(self, embeddings: FloatRows, encoder: EncoderIdentity) -> "Registration":
        """Return the same weights with another encoder's embeddings; no photo is read again.

        Raises: InputError: not one unit vector per mask.
        """
        if len(embeddings) != len(self.embeddings):
            raise InputError(f"expected {len(self.embeddings)} embeddings, one per mask; got {len(embeddings)}")
        return replace(self, evidence=replace(self.evidence, embeddings=embeddings), encoder=encoder)

    def merged(self, other: "Registration") -> "Registration":
        """Merge with a registration of further views of the same scene; equal to one pass over all.

        Raises: MismatchError: another scene or encoder. InputError: a view in both.
        """
        if None not in (self.sampling, other.sampling) and self.sampling != other.sampling:
            raise MismatchError(f"cannot merge {self.sampling} with {other.sampling}: register both in the same way")
        if self.scene != other.scene or not self.encoder.matches(other.encoder):
            raise MismatchError(
                f"cannot merge: one is of scene {self.scene} with {self.encoder.name}, the other of "
                f"{other.scene} with {other.encoder.name}: register both on the same file with the same encoder"
            )
        twice = sorted(set(self.masks.view_names) & set(other.masks.view_names))
        if twice:
            raise InputError(f"{len(twice)} views are in both registrations, first '{twice[0]}': remove them from one")
        evidence = with_views(self.evidence, other.evidence)
        left_out = {*self.left_out, *other.left_out} - {*evidence.masks.view_names}
        merged = None
        if self.provenance is not None and other.provenance is not None:
            names = self.masks.view_names + other.masks.view_names
            merged = self.provenance.with_views(other.provenance, np.argsort(np.array(names, object), kind="stable"))
        up = _between(self.up, other.up) if merged is None else merged.up
        return replace(self, evidence=evidence, up=up, left_out=tuple(sorted(left_out)), provenance=merged)

    def without(self, views: Collection[str]) -> "Registration":
        """Return this registration without the named views; equal to one pass over the others.

        Raises: InputError: a view that is not in it, or all of them.
        """
        names = self.masks.view_names
        unknown = sorted(set(views) - set(names))
        if unknown:
            near = did_you_mean(unknown[0], names)
            raise InputError(f"no view '{unknown[0]}' is registered: views are named like '{names[0]}'.{near}")
        gone = np.isin(names, list(views))
        if gone.all():
            raise InputError(f"these are all {len(names)} views: leave one, or remove the field itself")
        rest = None if self.provenance is None else self.provenance.of(np.flatnonzero(~gone))
        up = self.up if rest is None else rest.up
        return replace(self, evidence=without_views(self.evidence, gone), up=up, provenance=rest)


def register(
    scene: Gaussians | Moving,
    views: Sequence[View],
    features: Mapping[str, ViewFeatures],
    sampling: Sampling = Sampling(),
    *,
    parts: Path | None = None,
    threads: int = 0,
    track: Track = untracked,
) -> Registration:
    """Register the masks of every view onto the Gaussians; in a moving scene, as they are at the view's time.

    scene: a moving one makes one field for the whole film, of its canonical rows, which keeps the views' times.
    features: by view name, with or without suffix; views without features are left out with a warning. Their maps lie
    on the photos as stored, as LangSplat's do: where a view has a distortion it is undone on them too. For maps made on
    what `load_image` returned, pass views with distortion None. sampling: which contributors of a pixel count; some
    aggregators want their own (`Aggregator.sampling`). parts: folder for each view's finished columns; a run that finds
    them there does not redo them, so a killed run loses at most one view. None uses a temporary folder. track: shows
    progress.

    Warns: DrSplatWarning: views without features; units that make no sense (`units.doubts`); views with times of a
    scene that stands still.
    Raises: InputError: no view has features, two embedding sizes; of a moving scene a view without a time, or with one
    outside of its span.
    Source: Dr. Splat Sec. A "Training stage".

    >>> features = ds.read_features("capture/language_features", encoder=ds.WordEncoder().identity)
    >>> field = ds.register(scene.gaussians, scene.views, features).to_field()
    >>> len(field) <= len(scene.gaussians)
    True
    """
    chosen = with_features(views, features)
    gaussians, seen = scene.canonical if isinstance(scene, Moving) else scene, [view for view, _ in chosen]
    warn_of_missing(views, chosen)
    _warn_of_doubts(gaussians, seen)
    times = times_of(scene, seen)
    with ExitStack() as stack:
        folder = parts or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="drsplat-")))
        if parts is None:
            stack.enter_context(brief())
        scenery = scenery_of(scene, sampling.near)
        near = scenery.near
        maker = ColumnMaker(scenery, folder, sampling, threads)
        followed = track(chosen, "registering views")
        columns = [maker.columns(view, features[key])[0] for view, key in followed]
        del maker, scenery  # and what views are drawn from: W takes its place
        release_workspaces()
        check_one_size({c.embeddings.shape[1]: c.view_name for c in columns})
        widths = [len(c.embeddings) for c in columns]
        weights = stacked([c.triples for c in columns], widths, len(gaussians))
    masks = masks_of(seen, widths)
    evidence = Evidence(weights, replace(masks, times=times), np.concatenate([c.embeddings for c in columns]))
    encoder = encoder_of(features, evidence.embeddings.shape[1])
    provenance = provenance_of(seen, [c.key for c in columns], features)
    return Registration(
        evidence, gaussians.fingerprint, encoder, replace(sampling, near=near), provenance.up,
        provenance=provenance,
    )  # fmt: skip


def times_of(scene: Gaussians | Moving, views: Sequence[View]) -> Doubles | None:
    """Return the times of a moving scene's views; None for a still scene.

    Warns: DrSplatWarning: times of a scene that stands still, or that fill little of the scene's.
    Raises: InputError: a moving scene, and a view without a time, or with one outside of its span.
    """
    if not isinstance(scene, Moving):
        if any(view.time is not None for view in views):
            text = "the photos have times, but this scene stands still: they are registered as if all were of one time"
            warn(text, DrSplatWarning, stacklevel=3)
        return None
    times = np.array([scene.inside(time_of(view)) for view in views])
    low, high = scene.span
    if len(set(times.tolist())) > 1 and np.ptp(times) < MIN_SPAN_SHARE * (high - low):
        text = (
            f"the photos' times, {times.min():g} to {times.max():g}, fill little of the scene's, {low:g} to {high:g}: "
            "are both of one unit?"
        )
        warn(text, DrSplatWarning, stacklevel=3)
    return times


def with_features(views: Sequence[View], features: Collection[str]) -> list[tuple[View, str]]:
    """Return the views that have features, by name, each with the name of its features.

    features: the names that there are. Views whose photo's mask leaves everything out are dropped with a warning.

    Warns: DrSplatWarning: photos that their masks leave out entirely.
    Raises: InputError: no view has any, or two have the same. FormatError, MismatchError: see `load_mask`.
    """
    owners: dict[str, View] = {}  # of the features by their names
    keys = set(features)  # not `in features`: a folder of them finds one key by several names
    for view in sorted(views, key=lambda v: v.name):
        stem = str(Path(view.name).with_suffix("").as_posix())
        key = next((key for key in (view.name, stem, Path(stem).name) if key in keys), None)
        if key in owners:
            raise InputError(
                f"views '{owners[key].name}' and '{view.name}' both find the features '{key}': name the feature "
                "files after the whole path of the photo"
            )
        if key is not None:
            owners[key] = view
    if not owners:
        example = next(iter(features), "(there are none)")
        first = views[0].name if views else "(there are none)"
        raise InputError(
            f"no view has features: views are named like '{first}', features like '{example}', so they belong to "
            "other photos: make the features of these with `drsplat embed CAPTURE`"
        )
    usable = {view.name for view in views_with_something([*owners.values()])}
    if not usable:
        raise InputError("the masks of all photos leave all of them out: white is kept, and black is left out")
    return [(view, key) for key, view in owners.items() if view.name in usable]


def warn_of_missing(views: Sequence[View], chosen: Sequence[tuple[View, str]]) -> None:
    complete = {view.name for view, _ in chosen}
    missing = sorted(view.name for view in views if view.name not in complete and not keeps_nothing(view))
    if missing:
        warn(
            f"{len(missing)} of {len(views)} views have no features: {', '.join(missing[:5])}",
            DrSplatWarning,
            stacklevel=4,
        )


def _warn_of_doubts(gaussians: Gaussians, views: Sequence[View]) -> None:
    for doubt in doubts(gaussians, views):
        warn(doubt, DrSplatWarning, stacklevel=4)


def check_one_size(sizes: Mapping[int, str]) -> None:
    """Refuse embeddings of several sizes. sizes: an example of a view for each. Raises: InputError: several."""
    if len(sizes) > 1:
        listed = ", ".join(f"{size} ('{name}')" for size, name in sizes.items())
        raise InputError(f"embeddings of different sizes: {listed}: embed all views with one encoder")


def masks_of(views: Sequence[View], counts: Sequence[int]) -> MaskIds:
    """Return the ids of the masks of all views, `counts` of each, one view after another."""
    sources = tuple(view.rendered_from for view in views)
    return MaskIds(
        view_names=tuple(view.name for view in views),
        views=np.repeat(np.arange(len(views), dtype=np.int32), counts),
        ids=np.concatenate([np.arange(n, dtype=np.int32) for n in counts]),
        rendered_from=sources if any(sources) else (),
    )


def provenance_of(views: Sequence[View], keys: Sequence[bytes], features: Mapping[str, ViewFeatures]) -> Provenance:
    """Return the provenance of the views' columns. keys: hash of each view's columns."""
    hashes = np.frombuffer(b"".join(keys), np.uint8).reshape(len(keys), -1)
    level = getattr(features, "level", None)
    level_name = None if level is None else LEVELS[level]
    return Provenance(camera_axes(views), hashes, default_isa(), level_name, cameras_of(views))


def encoder_of(features: Mapping[str, ViewFeatures], dim: int) -> EncoderIdentity:
    encoder = getattr(features, "encoder", None)
    return encoder if isinstance(encoder, EncoderIdentity) else EncoderIdentity(UNKNOWN_ENCODER, dim)


def _between(one: Vector3 | None, other: Vector3 | None) -> Vector3 | None:
    """Return the direction between two; the only one if the other is None; None for opposite ones."""
    if one is None or other is None:
        return other if one is None else one
    total = one + other
    length = float(np.linalg.norm(total))
    return total / length if length > 1 else None
