"""A field with more views, or with fewer: equal to the bit to one that was registered at once from these views."""

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from warnings import warn

import numpy as np

from ...base.arrays import Flags
from ...base.progress import Stopwatch
from ...errors import DrSplatWarning, InputError, MismatchError
from ...kernels import available_isas, default_isa
from ...scene.gaussians import Gaussians
from ...scene.masks.features import ViewFeatures
from ...scene.moving import Moving, canonical_of
from ...scene.views import View
from .. import LanguageField, regrown_field
from ..codes import Track, untracked
from ..evidence.aggregation import Aggregator, aggregator
from ..evidence.changing import rows_with
from ..evidence.columns import ColumnMaker, scenery_of
from ..evidence.evidence import Evidence
from ..evidence.provenance import Provenance
from ..registration import Registration, register, with_features

CURE = "register its photos once more with `drsplat register`, and it can grow"


@dataclass(frozen=True, eq=False)
class Change:
    """Result of adding or removing views.

    field: after the change. added, replaced, removed: names of views, sorted. unchanged: views that were in it already
    and stayed. left_out: views that were removed or kept from it on purpose, and were not added. num_touched: Gaussians
    seen by masks of changed views. num_coded: Gaussians whose features were coded again. seconds: by stage.
    """

    field: LanguageField
    added: tuple[str, ...] = ()
    replaced: tuple[str, ...] = ()
    removed: tuple[str, ...] = ()
    unchanged: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    num_touched: int = 0
    num_coded: int = 0
    seconds: Mapping[str, float] = dataclasses.field(default_factory=dict)

    @property
    def is_empty(self) -> bool:
        return not (self.added or self.replaced or self.removed)


def add_views(
    field: LanguageField,
    scene: Gaussians | Moving,
    views: Sequence[View],
    features: Mapping[str, ViewFeatures],
    *,
    renew: bool = False,
    back: Collection[str] = (),
    parts: Path | None = None,
    threads: int = 0,
    track: Track = untracked,
) -> Change:
    """Register those of the views that have features and are not in the field yet.

    All settings are those that the field was registered with. Words that it is contrasted with and negatives stay,
    objects are left out: see `change_field`. renew: compare the masks and embeddings of views that are in the field
    already, and replace those that have become others; else such views are not looked at. back: names of views that
    were removed or kept out on purpose, and are to be added all the same. parts: as for `register`.

    Warns: DrSplatWarning: another instruction set than the field's.
    Raises: InputError: the field does not know how it was made, or no view has features. MismatchError: another scene,
    encoder or size of embeddings, or masks of another level.
    """
    watch = Stopwatch()
    before, how = registration_of(field, scene), recorded_aggregator(field)
    encoder = getattr(features, "encoder", None)
    if encoder is not None:  # features that name none are taken for the field's
        field.check_encoder(encoder)
    chosen = with_features(views, features)
    present = [(view, key) for view, key in chosen if view.name in before.masks.view_names]
    others = Comparison(before, scene).changed(present, features, track) if renew and present else []
    change = _planned(field, [view.name for view, _ in chosen], {view.name for view in others}, set(back))
    watch.lap("read")
    if change.is_empty:
        return replace(change, seconds=watch.seconds)
    new = [view for view, _ in chosen if view.name in {*change.added, *change.replaced}]
    assert before.sampling is not None
    warn_of_isa(before.provenance)
    more = register(scene, new, features, before.sampling, parts=parts, threads=threads, track=track)
    watch.lap("register")
    after = _replaced(before, set(change.replaced), replace(more, encoder=field.encoder))
    touched = (np.diff(more.weights.indptr) > 0) | _touched(before.evidence, change.replaced)
    watch.lap("weights")
    return _changed(change, touched, after, how, canonical_of(scene), watch=watch, threads=threads, track=track)


def _planned(field: LanguageField, given: Sequence[str], others: set[str], back: set[str]) -> Change:
    """Return the change that is to be made for the views `given`, by name.

    others: views of the field whose masks or embeddings have changed. back: left-out views to be added all the same.
    """
    assert field.evidence is not None
    names, left_out = set(field.evidence.masks.view_names), kept_out(field) - back
    return Change(
        field,
        added=tuple(name for name in given if name not in names | left_out),
        replaced=tuple(name for name in given if name in others),
        unchanged=tuple(name for name in given if name in names - others),
        left_out=tuple(name for name in given if name in left_out - names),
    )


def kept_out(field: LanguageField) -> set[str]:
    """Return the views that people removed from a field, or kept out of it from the start."""
    return {*field.left_out, *(field.growth.removed if field.growth else ())}


def remove_views(
    field: LanguageField,
    scene: Gaussians | Moving,
    names: Collection[str],
    *,
    threads: int = 0,
    track: Track = untracked,
) -> Change:
    """Remove the named views from a field; `add_views` leaves them out from then on.

    Words and negatives stay, objects are left out: see `change_field`. Views that were removed before are passed over
    (`left_out`): a killed command can be given again.

    Raises: InputError: views that are not in it, or all of them; the field does not know how it was made.
    MismatchError: another scene.
    """
    watch = Stopwatch()
    before, how = registration_of(field, scene), recorded_aggregator(field)
    assert field.growth is not None
    gone = set(names) & set(field.growth.removed) - set(before.masks.view_names)
    names = set(names) - gone
    if gone and not names:
        return Change(field, unchanged=before.masks.view_names, left_out=tuple(sorted(gone)), seconds=watch.seconds)
    after, touched = before.without(names), _touched(before.evidence, names)
    watch.lap("weights")
    change = Change(field, removed=tuple(sorted(names)), unchanged=after.masks.view_names, left_out=tuple(sorted(gone)))
    return _changed(change, touched, after, how, canonical_of(scene), watch=watch, threads=threads, track=track)


def recorded_aggregator(field: LanguageField) -> Aggregator:
    """Return the aggregator of a field's features. Raises: InputError, MismatchError: not in this version."""
    record = field.aggregator
    how = aggregator(record.name)
    if dict(record.parameters) != how.parameters:
        raise MismatchError(
            f"this field's features are of '{record.name}' with {dict(record.parameters)}, here it has "
            f"{how.parameters}: {CURE}"
        )
    return how


def registration_of(field: LanguageField, scene: Gaussians | Moving) -> Registration:
    """Return a field's registration.

    Raises: InputError: the field does not say how it was made. MismatchError: another scene.
    """
    field.check_scene(canonical_of(scene))
    field.check_motion(isinstance(scene, Moving))
    check_growth(field)
    return Registration.from_field(field)


def check_growth(field: LanguageField) -> None:
    """Check that views can be added to a field. Raises: InputError: it does not say how it was made."""
    if field.evidence is None or field.growth is None or field.aggregator.sampling is None:
        raise InputError(f"this field does not say how it was made, as fields of older versions do not: {CURE}")


def warn_of_isa(provenance: Provenance | None) -> None:
    """Warn of weights that were computed with another instruction set than this process has."""
    if provenance is None or provenance.isa == default_isa():
        return
    cure = f"set DRSPLAT_ISA={provenance.isa}" if provenance.isa in available_isas() else "register all on one machine"
    text = (
        f"the weights of this field were computed with {provenance.isa}, those of new views are with {default_isa()}: "
        f"last bits will be others than of a registration at once. For the same, {cure}"
    )
    warn(text, DrSplatWarning, stacklevel=3)


def _replaced(before: Registration, others: set[str], more: Registration) -> Registration:
    if more.evidence.dim != before.evidence.dim:
        raise MismatchError(
            f"embeddings of {more.evidence.dim} numbers in a field of {before.evidence.dim}: embed with its encoder, "
            f"{before.encoder.name}"
        )
    if others == set(before.masks.view_names):
        return replace(more, sampling=before.sampling, left_out=before.left_out)
    return (before.without(others) if others else before).merged(more)


def _changed(
    change: Change,
    touched: Flags,
    after: Registration,
    how: Aggregator,
    gaussians: Gaussians,
    *,
    watch: Stopwatch,
    threads: int,
    track: Track,
) -> Change:
    """Make the field of the registration `after`; rows that are not `touched` keep their codes where they can."""
    field, names = change.field, {*change.added, *change.replaced, *change.removed}
    assert field.growth is not None
    assert after.provenance is not None
    again = regrown_field(field, after.evidence, after.provenance, touched, names, threads=threads, track=track)
    num_coded = int(np.count_nonzero(touched))
    if again is None:
        again = after.to_field(
            field.growth.specification(field.code), aggregator=how, gaussians=gaussians, threads=threads, track=track
        )
        num_coded = len(again)
    assert again.growth is not None
    removed = {*field.growth.removed, *change.removed} - {*after.masks.view_names}
    grown = replace(again.growth, removed=tuple(sorted(removed)))
    again = replace(again, up=after.up, left_out=after.left_out, growth=grown).with_words_of(field, threads=threads)
    watch.lap("code")
    return replace(
        change, field=again, num_touched=int(np.count_nonzero(touched)), num_coded=num_coded, seconds=watch.seconds
    )


def _touched(evidence: Evidence, names: Collection[str]) -> Flags:
    """Return which rows a mask of the named views sees."""
    masks = evidence.masks
    changed = np.isin(masks.view_names, list(names))
    if not changed.any():
        return np.zeros(len(evidence), np.bool_)
    return rows_with(evidence.weights, changed[masks.views])


class Comparison:
    """Comparison of views with a registration of these Gaussians whose provenance is known."""

    def __init__(self, registration: Registration, scene: Gaussians | Moving) -> None:
        sampling = registration.sampling
        if sampling is None:
            raise InputError("how the photos were looked at is not known of this registration: register again")
        self.registration = registration
        self._maker = ColumnMaker(scenery_of(scene, sampling.near), Path(), sampling, 0)

    def changed(
        self, views: Sequence[tuple[View, str]], features: Mapping[str, ViewFeatures], track: Track = untracked
    ) -> list[View]:
        """Return the views whose camera, masks or embeddings have changed. views: each with its features' name."""
        others = []
        for view, key in track(views, "comparing views"):
            embeddings = self.registration.embeddings[self._columns(view.name)]
            if not self.has_masks(view, features[key]) or not np.array_equal(embeddings, features[key].embeddings):
                others.append(view)
        return others

    def has_masks(self, view: View, features: ViewFeatures) -> bool:
        """Return whether camera and masks, and so W's columns, are those of the registration."""
        registration = self.registration
        assert registration.provenance is not None
        number = registration.masks.view_names.index(view.name)
        if int(np.count_nonzero(self._columns(view.name))) != len(features.embeddings):
            return False
        return bool(registration.provenance.keys[number].tobytes() == self._maker.key(view, features))

    def _columns(self, name: str) -> np.ndarray:
        masks = self.registration.masks
        return masks.views == masks.view_names.index(name)
