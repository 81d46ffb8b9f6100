"""Views that come and go: the field is, to the bit, that of one registration of those that are left."""

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from scipy.sparse import csr_array

from drsplat import load_field
from drsplat.errors import DrSplatWarning, MismatchError
from drsplat.field import LanguageField, learning
from drsplat.field.codes import PQ, Mixture, Smaller
from drsplat.field.evidence.aggregation import Sampling
from drsplat.field.evidence.changing import with_views, without_views
from drsplat.field.evidence.evidence import Evidence, MaskIds
from drsplat.field.growing import Change, add_views, change_field, remove_views
from drsplat.field.registration import Registration, register
from drsplat.formats.replacing import claimed_output
from drsplat.scene.masks.features import ViewFeatures
from growing_fields import COUNT, Killed, at_once, features, files_of, killed_at, remaining, scene, views
from refusing import refused

NAMES = tuple(view.name for view in views())
CODES = (PQ(4), Mixture(2), Smaller(3))


@pytest.fixture(autouse=True)
def _learnt_from_two(monkeypatch) -> None:
    """Of seven views: so that what is learnt sometimes changes, and mostly does not."""
    monkeypatch.setattr(learning, "MAX_LEARNING_VIEWS", 2)


def added(field: LanguageField, *names: str, **options: object) -> Change:
    new = [view for view in views() if view.name in names]
    return add_views(field, scene(), new, features(), **options)


def forgetful(field: LanguageField, removed: tuple[str, ...] = ()) -> LanguageField:
    """With no memory of views that were removed, or of others."""
    return replace(field, growth=replace(field.growth, removed=removed))


steps = st.lists(st.tuples(st.sets(st.sampled_from(NAMES), min_size=1, max_size=3), st.integers(0, 40)), max_size=4)


@pytest.mark.slow
@settings(derandomize=True)
@given(
    st.sets(st.sampled_from(NAMES), min_size=1),
    steps,
    st.sampled_from([*CODES, "given"]),
    st.sampled_from(["mean", "mean", "official", "inliers", "robust"]),
)
def test_any_order_of_adding_and_removing_with_kills_is_one_registration(tmp_path_factory, first, steps, code, how):
    """Each step toggles some views, is killed at a random change of the disk, and is given again."""
    folder = tmp_path_factory.mktemp("grown")
    path, parts = folder / "a.field", folder / "a.field.parts"
    if code == "given":
        code = at_once(NAMES, PQ(4)).codebook
    names, ever = set(first), set(first)
    at_once(remaining(names), code, how).save(path)

    def become(wanted):
        def add(field):
            return added(field, *wanted, parts=parts, back=wanted)

        def remove(field):
            gone = set(field.evidence.masks.view_names) - wanted
            return remove_views(field, scene(), gone) if gone else Change(field)

        if wanted - names:
            change_field(path, scene(), add)
        if names - wanted:
            change_field(path, scene(), remove)

    for toggled, moment in steps:
        wanted = names ^ toggled or names
        with killed_at(moment, pytest.MonkeyPatch.context), suppress(Killed):
            become(wanted)
        assert load_field(path).evidence is not None  # the old one or the new one, whole
        become(wanted)
        names, ever = wanted, ever | wanted
        expected = forgetful(at_once(remaining(names), code, how), tuple(sorted(ever - names)))
        expected.save(folder / "b.field", overwrite=True)
        assert files_of(path) == files_of(folder / "b.field")


@pytest.mark.slow
def test_only_rows_that_are_seen_are_coded_again():
    """Or the test above would show nothing."""
    coded, total = [], []
    for name in NAMES:
        change = added(at_once(remaining(set(NAMES) - {name}), Mixture(2)), name)
        coded.append(change.num_coded)
        total.append(len(change.field))
        assert change.num_touched <= change.num_coded
    assert min(coded) < 0.4 * max(total)
    assert sum(count < whole for count, whole in zip(coded, total, strict=True)) >= 3
    assert any(count == whole for count, whole in zip(coded, total, strict=True))


def test_a_view_more_seldom_changes_what_is_learnt_from(monkeypatch):
    """With a chance of LEARNT_FROM / V, whatever its name."""
    monkeypatch.setattr(learning, "MAX_LEARNING_VIEWS", 8)
    names = [f"photo_{number:03d}.jpg" for number in range(100)]
    masks = MaskIds(tuple(names), np.arange(100, dtype=np.int32), np.zeros(100, np.int32))
    weights = csr_array(np.eye(100, dtype=np.float32))
    rows = np.tile(np.eye(8, dtype=np.float32)[0], (100, 1))
    changes = []
    for number in range(50, 100):
        few = [Evidence(weights[:, :n], MaskIds(tuple(names[:n]), masks.views[:n], masks.ids[:n]), rows[:n])
               for n in (number, number + 1)]  # fmt: skip
        before, now = map(learning.learning_views, few)
        assert len(before) == len(now) == 8
        assert len(set(now) - set(before)) <= 1
        changes.append(before != now)
    assert 0 < sum(changes) < 12  # 5.5 are expected
    blind = Evidence(csr_array(np.diag((np.arange(100) % 2).astype(np.float32))), masks, rows)
    assert all(int(name[6:9]) % 2 for name in learning.learning_views(blind))


def test_gaussians_whose_features_cancel_out_are_kept_for_later():
    field = at_once(NAMES[:2], Mixture(2))
    assert len(field.growth.rest_ids) > 0
    change = remove_views(field, scene(), NAMES[1:2])
    assert len(change.field.rows_of(field.growth.rest_ids)) > 0
    assert (change.field.rows_of(field.growth.rest_ids) >= 0).all()
    assert forgetful(change.field).equals(at_once(NAMES[:1], Mixture(2)))


def test_the_smaller_code_may_become_the_other_one():
    """Few Gaussians for each mask are PQ, many are mixtures."""
    field = at_once(NAMES[:3], Smaller(3))
    assert field.code.kind == "mixture"
    many = default_rng(0).normal(size=(4000, 8)).astype(np.float32)
    many /= np.linalg.norm(many, axis=1, keepdims=True)
    swollen = dict(features())
    swollen[NAMES[3]] = ViewFeatures(features()[NAMES[3]].mask_ids, many)
    change = add_views(field, scene(), views()[:4], swollen)
    assert change.field.code.kind == "pq"
    assert change.field.equals(register(scene(), views()[:4], swollen, Sampling(6)).to_field(Smaller(3)))
    back = remove_views(change.field, scene(), [NAMES[3]])
    assert forgetful(back.field).equals(field)


def test_words_follow():
    field = at_once(NAMES[:4], Mixture(2))
    words = default_rng(1).normal(size=(5, 8)).astype(np.float32)
    texts = tuple("abcde")
    known = field.with_negatives(words[:3], texts[:3]).with_contrast(words, texts)
    whole = at_once(NAMES[:5], Mixture(2)).with_negatives(words[:3], texts[:3]).with_contrast(words, texts)
    assert added(known, NAMES[4]).field.equals(whole)


def test_a_view_that_is_there_is_left_alone_until_it_is_to_be_compared():
    field = at_once(NAMES, PQ(4))
    same = add_views(field, scene(), views(), features(1))
    assert same.is_empty
    assert same.field is field
    assert same.unchanged == NAMES
    assert add_views(field, scene(), views(), features(), renew=True).is_empty
    mixed = dict(features()) | {NAMES[2]: features(1)[NAMES[2]]}
    masks = mixed[NAMES[4]].mask_ids.copy()
    masks[:9] = -1
    mixed[NAMES[4]] = ViewFeatures(masks, mixed[NAMES[4]].embeddings)
    moved = [replace(view, cam_from_world=views()[0].cam_from_world) if view.name == NAMES[5] else view
             for view in views()]  # fmt: skip
    change = add_views(field, scene(), moved, mixed, renew=True)
    assert change.replaced == (NAMES[2], NAMES[4], NAMES[5])
    assert change.unchanged == (NAMES[0], NAMES[1], NAMES[3], NAMES[6])
    assert change.field.equals(register(scene(), moved, mixed, Sampling(6)).to_field(PQ(4)))


def test_all_views_may_be_replaced():
    change = add_views(at_once(NAMES, PQ(4)), scene(), views(), features(1), renew=True)
    assert change.replaced == NAMES
    assert change.field.equals(at_once(NAMES, PQ(4), "mean", 1))


def test_views_that_were_left_out_on_purpose_stay_out():
    field = replace(at_once(NAMES[:3], PQ(4)), left_out=(NAMES[3],))
    change = added(field, *NAMES[2:5])
    assert (change.added, change.left_out, change.unchanged) == ((NAMES[4],), (NAMES[3],), (NAMES[2],))
    assert change.field.left_out == (NAMES[3],)


def test_views_that_were_removed_stay_out_until_they_are_asked_back():
    whole = at_once(NAMES, PQ(4))
    field = remove_views(whole, scene(), NAMES[1:3]).field
    change = added(field, *NAMES)
    assert (change.is_empty, change.left_out) == (True, NAMES[1:3])
    change = added(field, *NAMES, back=NAMES[1:2])
    assert (change.added, change.left_out, change.field.growth.removed) == (NAMES[1:2], NAMES[2:3], NAMES[2:3])
    assert added(change.field, NAMES[2], back=NAMES[2:3]).field.equals(whole)


def test_a_registration_without_views_is_one_of_the_others():
    registration = Registration.from_field(at_once(NAMES, Mixture(2)))
    rest = registration.without(NAMES[1:3])
    assert rest.to_field(Mixture(2)).equals(at_once(NAMES[:1] + NAMES[3:], Mixture(2)))
    with refused(r"no view 'x' is registered: views are named like '000\.png'"):
        registration.without(["x"])
    with refused("these are all 7 views"):
        registration.without(NAMES)


def test_what_does_not_belong_together_is_refused():
    field = at_once(NAMES[:3], PQ(4))
    with pytest.raises(MismatchError, match="belongs to a scene"):
        add_views(field, scene().subset(np.arange(50)), views(), features())
    wide = {NAMES[3]: ViewFeatures(features()[NAMES[3]].mask_ids, np.eye(16, dtype=np.float32)[:3])}
    with pytest.raises(MismatchError, match="embeddings of 16 numbers in a field of 8"):
        add_views(field, scene(), views(), wide)
    with refused("no view has features"):
        add_views(field, scene(), views(), {"elsewhere": features()[NAMES[0]]})
    with refused("both find the features"):
        add_views(field, scene(), [*views(), views()[4]], features())
    with refused("does not say how it was made"):
        add_views(replace(field, growth=None), scene(), views(), features())
    record = replace(field.aggregator, parameters={"MaskTrust.sharpness": 3.0})
    with pytest.raises(MismatchError, match="register its photos once more"):
        remove_views(replace(field, aggregator=record), scene(), NAMES[:1])
    other = replace(field.growth.provenance, isa="another")
    with pytest.warns(DrSplatWarning, match="computed with another, .* register all on one machine"):
        grown = added(replace(field, growth=replace(field.growth, provenance=other)), NAMES[4]).field
    assert "another" in grown.growth.provenance.isa.split("+")


def test_two_writers_do_not_share_a_field(tmp_path):
    path = tmp_path / "a.field"
    at_once(NAMES[:3], PQ(4)).save(path)
    before = files_of(path)
    with claimed_output(path), refused(r"a\.field is being written by process"):
        change_field(path, scene(), lambda field: added(field, NAMES[3]))
    assert files_of(path) == before
    with refused("there is no such file or folder"):
        change_field(tmp_path / "none.field", scene(), lambda field: added(field, NAMES[3]))
    assert sorted(one.name for one in tmp_path.iterdir()) == ["a.field"]


def test_the_number_of_threads_does_not_matter():
    fields = [added(at_once(NAMES[:5], code), NAMES[5], threads=threads).field for code in CODES for threads in (1, 3)]
    assert all(one.equals(other) for one, other in zip(fields[::2], fields[1::2], strict=True))
    assert len(NAMES) == COUNT


@settings(derandomize=True)
@given(st.integers(0, 10_000), st.sets(st.integers(0, 5), max_size=5), st.integers(1, 4))
def test_columns_that_come_and_go_are_those_of_dense_matrices(seed, gone, count):
    """Views of any order of names, columns and rows without entries among them."""
    rng = default_rng(seed)

    def evidence(names):
        of_view = np.repeat(np.arange(len(names), dtype=np.int32), rng.integers(0, 4, len(names)))
        ids = np.concatenate([np.arange(n, dtype=np.int32) for n in np.bincount(of_view, minlength=len(names))])
        dense = rng.random((20, len(ids)), np.float32) * (rng.random((20, len(ids))) < 0.2)
        rows = np.tile(np.eye(3, dtype=np.float32)[0], (len(ids), 1))
        return Evidence(csr_array(dense.astype(np.float32)), MaskIds(tuple(names), of_view, ids), rows)

    names = [f"{name}.jpg" for name in rng.permutation(20)[: 6 + count]]
    old, new = evidence(sorted(names[:6])), evidence(sorted(names[6:]))
    mask = np.isin(np.arange(6), list(gone))
    fewer = without_views(old, mask)
    assert_array_equal(fewer.weights.toarray(), old.weights.toarray()[:, ~mask[old.masks.views]])
    assert fewer.masks.view_names == tuple(name for name, goes in zip(sorted(names[:6]), mask, strict=True) if not goes)
    both = with_views(fewer, new)
    assert both.masks.view_names == tuple(sorted(fewer.masks.view_names + new.masks.view_names))
    for part in (fewer, new):
        for number, name in enumerate(part.masks.view_names):
            here = both.masks.views == both.masks.view_names.index(name)
            its = part.masks.views == number
            assert_array_equal(both.weights.toarray()[:, here], part.weights.toarray()[:, its])
            assert_array_equal(both.masks.ids[here], part.masks.ids[its])
    assert both.weights.has_canonical_format
    assert (both.weights.indptr.dtype, both.weights.indices.dtype) == (np.int32, np.int32)
