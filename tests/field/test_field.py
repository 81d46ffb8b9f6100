"""The language field: built from evidence, scored, explained, saved and loaded."""

import json
import os
import signal
import subprocess
import sys
import textwrap
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from safetensors.numpy import load_file, save_file
from scipy.sparse import csr_array

from drsplat.base import contents
from drsplat.errors import FormatError, MismatchError
from drsplat.field import LanguageField, build_field, load_field
from drsplat.field.codes import Codebook, Mixture, train_codebook
from drsplat.field.codes.mixture import MixtureCode
from drsplat.field.evidence.aggregation import Aggregated
from drsplat.field.evidence.evidence import Evidence, Explanation, MaskIds
from drsplat.formats.tensors import map_tensors, sealed, write_tensors
from drsplat.scene.encoders import EncoderIdentity
from drsplat.scene.gaussians import Gaussians
from fields import SCENE, TOY, random_evidence, toy_field, unit_rows
from places import SUPPORT
from refusing import malformed, refused

few = settings(derandomize=True, max_examples=40)


def same_field(a: LanguageField, b: LanguageField) -> None:
    assert_array_equal(a.gaussian_ids, b.gaussian_ids)
    ours, theirs = a.code.tensors(), b.code.tensors()
    assert set(ours) == set(theirs)
    for name, array in ours.items():
        assert_array_equal(array, theirs[name])
    assert (a.fingerprint, a.code.kind, a.scene) == (b.fingerprint, b.code.kind, b.scene)
    assert (a.encoder, a.num_gaussians) == (b.encoder, b.num_gaussians)


def residual_field() -> LanguageField:
    evidence, rng = random_evidence(default_rng(0)), default_rng(1)
    coarse = np.concatenate([unit_rows(rng, 7, 32), np.zeros((2, 32), np.float32)])
    points = 0.5 * unit_rows(rng, 3000, 32)
    centroids = train_codebook(points, 16, encoder=TOY).centroids
    return build_field(evidence, SCENE, TOY, Codebook(centroids, coarse, TOY))


def mixed_field() -> LanguageField:
    evidence = random_evidence(default_rng(0))
    return build_field(evidence, SCENE, TOY, Mixture(3))


@few
@given(st.integers(0, 60), st.integers(0, 999))
def test_columns_are_summed_as_scipy_does(count, seed):
    """To the bit, also of rows that come twice or are empty."""
    rng = default_rng(seed)
    evidence = random_evidence(rng)
    rows = rng.integers(0, len(evidence), count)
    assert_array_equal(evidence.column_sums(rows), evidence.weights[rows].sum(axis=0))


def test_evidence_of_a_file_is_what_was_saved(tmp_path):
    field = toy_field()
    field.save(tmp_path / "toy.field")
    stored = load_field(tmp_path / "toy.field").evidence
    assert "weights" not in vars(stored)  # which need SciPy
    for ours, theirs in zip(stored.entries, field.evidence.entries, strict=True):
        assert_array_equal(ours, theirs)
    other = replace(stored, embeddings=-stored.embeddings)
    for evidence in (stored, other):
        assert (evidence.weights != field.evidence.weights).nnz == 0
    assert_array_equal(other.entries.data, other.weights.data)


def test_features_are_the_normalised_means_of_their_evidence():
    evidence = random_evidence(default_rng(0))
    field = build_field(evidence, SCENE, TOY)
    rows = evidence.weights.astype(np.float64) @ evidence.embeddings.astype(np.float64)
    norms = np.linalg.norm(rows, axis=1)
    assert_array_equal(field.gaussian_ids, np.flatnonzero(norms))
    assert 0 < len(field) < len(evidence)
    expected = rows[field.gaussian_ids] / norms[field.gaussian_ids, None]
    assert_allclose(field.evidence.features(0, len(field)), expected, atol=1e-6)
    assert ((field.feature(slice(None)) * expected).sum(axis=1)).min() > 0.99


@few
@given(st.integers(1, 6), st.integers(0, 2**32))
def test_relevancy_is_the_least_two_way_softmax(count, seed):
    field, rng = toy_field(), default_rng(seed)
    query, negatives = unit_rows(rng, 1, 32)[0], unit_rows(rng, count, 32)
    positive = field.scores(query).astype(np.float64)
    pairs = [(positive, field.scores(negative).astype(np.float64)) for negative in negatives]
    softmax = [np.exp(10 * p) / (np.exp(10 * p) + np.exp(10 * n)) for p, n in pairs]
    cached = field.with_negatives(negatives)
    for relevancy in (
        field.relevancy(query, negatives),
        cached.relevancy(query),
        cached.relevancy(query, negatives),
        toy_field().with_negatives(unit_rows(rng, 2, 32)).relevancy(query, negatives),
    ):
        assert_allclose(relevancy, np.min(softmax, axis=0), atol=1e-6)


def test_relevancy_without_negatives_is_refused():
    field, query = toy_field(), np.ones(32, np.float32)
    with refused("with_negatives"):
        field.relevancy(query)
    with refused("one or more negatives"):
        field.with_negatives(np.empty((0, 32), np.float32))
    with refused("texts"):
        field.with_negatives(unit_rows(default_rng(0), 2, 32), ("one",))


def test_dense_scores_have_a_fill_where_nothing_is_known():
    field = toy_field()
    scores = field.scores(np.ones(32, np.float32))
    dense = field.dense(scores, fill=-2)
    absent = np.setdiff1d(np.arange(field.num_gaussians), field.gaussian_ids)
    assert_array_equal(dense[field.gaussian_ids], scores)
    assert_array_equal(dense[absent], -2)


def test_an_explanation_names_the_photos_and_masks_with_the_largest_support():
    embeddings = np.eye(4, dtype=np.float32)[[0, 0, 1, 0]]
    masks = MaskIds(("a", "b"), np.int32([0, 0, 1, 1]), np.array([0, 1, 0, 1], "i4"))
    weights = csr_array(np.float32([[1, 3, 5, 0], [0, 0, 0, 2], [0] * 4, [0, 0, 1, 0]]))
    field = build_field(Evidence(weights, masks, embeddings), SCENE, EncoderIdentity("e", 4))
    query = np.float32([2, 0, 0, 0])
    assert field.explain(0, query) == [Explanation("a", 1, 0.75), Explanation("a", 0, 0.25)]
    assert field.explain(0, query, top=1) == [Explanation("a", 1, 0.75)]
    assert field.explain(1, query) == [Explanation("b", 1, 1.0)]
    assert field.explain(2, query) == []  # pruned
    assert field.explain(3, query) == []  # nothing speaks for it
    with refused("Gaussian 4 of a scene of 4"):
        field.explain(4, query)


def test_rows_whose_embeddings_cancel_have_no_feature():
    embeddings = np.float32([[1, 0], [-1, 0], [0, 1]])
    masks = MaskIds(("a",), np.zeros(3, np.int32), np.arange(3, dtype=np.int32))
    weights = csr_array(np.float32([[2, 2, 0], [0, 0, 1], [0, 0, 0], [1, 0, 0]]))
    field = build_field(Evidence(weights, masks, embeddings), SCENE, EncoderIdentity("e", 2))
    assert_array_equal(field.gaussian_ids, [1, 3])
    assert_allclose(field.scores(np.float32([1, 0])), [0, 1], atol=1e-5)
    assert field.evidence is not None
    assert len(field.evidence) == 2


def test_a_field_is_the_same_to_the_bit_for_any_number_of_threads():
    evidence = random_evidence(default_rng(2), rows=9000)
    fields = [build_field(evidence, SCENE, TOY, threads=threads) for threads in (1, 2, 3)]
    for field in fields[1:]:
        same_field(field, fields[0])


def test_building_shares_the_weights_and_never_copies_them():
    evidence = random_evidence(default_rng(3))
    field = build_field(evidence, SCENE, TOY)
    assert np.shares_memory(field.evidence.weights.data, evidence.weights.data)
    assert_array_equal(field.evidence.weights.toarray(), evidence.weights.toarray()[field.gaussian_ids])


def test_a_mixture_is_of_the_votes_that_count_and_names_columns_of_the_evidence():
    """Columns out of order, and votes that neighbours lend."""
    rng = default_rng(8)
    evidence = random_evidence(rng)
    shuffled = rng.permutation(40)
    masks = MaskIds(evidence.masks.view_names, evidence.masks.views[shuffled], evidence.masks.ids[shuffled])
    mixed_up = Evidence(csr_array(evidence.weights[:, shuffled]), masks, evidence.embeddings[shuffled])
    field = build_field(mixed_up, SCENE, TOY, Mixture(16))
    code = field.code
    assert isinstance(code, MixtureCode)
    named = np.flatnonzero(code.atoms.masks >= 0)
    vectors = code.atoms.vectors(named)
    theirs = field.evidence.embeddings[code.atoms.masks[named]]
    assert_allclose(vectors, theirs, atol=0.02)
    donors = rng.permutation(600).astype(np.int32)
    lent = build_field(mixed_up, SCENE, TOY, Mixture(16), aggregated=Aggregated(mixed_up, donors))
    own = mixed_up.features(0, 600)[donors[lent.gaussian_ids]]
    assert ((lent.feature(slice(None)) * own).sum(axis=1)).min() > 0.999


def test_any_dimension_finds_a_number_of_parts():
    for dim, parts in ((1, 1), (12, 4), (36, 4), (512, 128), (768, 128)):
        evidence = random_evidence(default_rng(5), rows=40, dim=dim)
        field = build_field(evidence, SCENE, EncoderIdentity("e", dim))
        assert field.codebook.num_subvectors == parts


@pytest.mark.parametrize("make", [toy_field, residual_field, mixed_field])
def test_a_field_comes_back_from_disk_to_the_bit_and_mapped(make, tmp_path, monkeypatch):
    monkeypatch.setattr(contents, "MAX_READ_BYTES", 0)
    negatives = unit_rows(default_rng(6), 2, 32)
    field = make().with_negatives(negatives, ("this", "that"))
    field.save(tmp_path / "a.field")
    again = load_field(tmp_path / "a.field")
    same_field(field, again)
    assert_array_equal(again.negatives.maxima, field.negatives.maxima)
    assert again.negatives.texts == ("this", "that")
    assert_array_equal(again.evidence.weights.toarray(), field.evidence.weights.toarray())
    assert again.evidence.masks.view_names == field.evidence.masks.view_names
    query = negatives[0] + negatives[1]
    assert_array_equal(again.relevancy(query), field.relevancy(query))
    explained = [again.explain(int(i), query) for i in field.gaussian_ids[:20]]
    assert explained == [field.explain(int(i), query) for i in field.gaussian_ids[:20]]
    assert any(explained)
    weights = again.evidence.weights
    for array in (
        next(iter(again.code.tensors().values())),
        again.gaussian_ids,
        weights.data,
        weights.indices,
        weights.indptr,
    ):
        assert is_mapped(array)
        assert not array.flags.writeable
    assert is_mapped(again.evidence.embeddings)


def is_mapped(array: np.ndarray) -> bool:
    base = array
    while isinstance(base, np.ndarray) and not isinstance(base, np.memmap):
        base = base.base
    return isinstance(base, np.memmap)


def test_a_field_without_evidence_is_saved_without_it(tmp_path):
    field = toy_field()
    bare = LanguageField(field.gaussian_ids, field.code, field.encoder, field.scene, field.num_gaussians)
    bare.save(tmp_path / "a.field")
    assert sorted(os.listdir(tmp_path / "a.field")) == ["codes.safetensors", "field.json"]
    again = load_field(tmp_path / "a.field")
    assert again.evidence is None
    with refused("no evidence"):
        again.explain(0, np.ones(32, np.float32))


def test_saving_replaces_only_fields_and_only_when_told_to(tmp_path):
    path = tmp_path / "a.field"
    toy_field(0).save(path)
    with refused("overwrite"):
        toy_field(1).save(path)
    mapped = load_field(path)
    toy_field(1).save(path, overwrite=True)
    same_field(load_field(path), toy_field(1))
    same_field(mapped, toy_field(0))  # still readable: its files live on until it is dropped
    precious = tmp_path / "photos"
    precious.mkdir()
    with refused("not ours"):
        toy_field(1).save(precious, overwrite=True)
    with refused("make it first"):
        toy_field(1).save(tmp_path / "none" / "a.field")
    assert sorted(os.listdir(tmp_path)) == ["a.field", "photos"]


@pytest.mark.parametrize("exchange", [True, False])
@pytest.mark.parametrize("step", ["write_tensors", "_take_place"])
def test_a_failed_save_leaves_the_old_field(exchange, step, tmp_path, monkeypatch):
    from drsplat.formats import field_folder

    path = tmp_path / "a.field"
    toy_field(0).save(path)

    def fail(*_):
        raise OSError("disk full")

    with monkeypatch.context() as patch:
        patch.setattr(field_folder, step, fail)
        with pytest.raises(OSError, match="disk full"):
            toy_field(1).save(path, overwrite=True)
    same_field(load_field(path), toy_field(0))
    assert os.listdir(tmp_path) == ["a.field"]
    if not exchange:
        monkeypatch.setattr(field_folder, "_exchange", lambda *_: False)
    toy_field(1).save(path, overwrite=True)
    same_field(load_field(path), toy_field(1))
    assert os.listdir(tmp_path) == ["a.field"]


KILLED = """
    import sys
    sys.path.insert(0, sys.argv[1])
    from fields import toy_field
    fields = [toy_field(0), toy_field(1)]
    print("ready", flush=True)
    while True:
        for field in fields:
            field.save(sys.argv[2], overwrite=True)
"""


@pytest.mark.slow
def test_a_killed_save_leaves_one_whole_field(tmp_path):
    path, rng = tmp_path / "a.field", default_rng(7)
    toy_field(0).save(path)
    known = {toy_field(seed).fingerprint for seed in (0, 1)}
    script = [sys.executable, "-c", textwrap.dedent(KILLED), str(SUPPORT), str(path)]
    for _ in range(3):
        with subprocess.Popen(script, stdout=subprocess.PIPE) as process:
            assert process.stdout.readline() == b"ready\n"
            try:
                process.wait(float(rng.uniform(0.005, 0.06)))
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGKILL)
        field = load_field(path)
        assert field.fingerprint in known
        assert field.evidence is not None


def test_another_scene_is_refused():
    rng = default_rng(8)

    def gaussians(count):
        means, quats = rng.random((count, 3), np.float32), np.zeros((count, 4), np.float32)
        columns = np.ones((count, 3), np.float32), np.ones(count, np.float32)
        return Gaussians(means, quats, *columns, np.zeros((count, 1, 3), np.float32))

    scene = gaussians(600)
    field = build_field(random_evidence(rng), scene.fingerprint, TOY)
    field.check_scene(scene)
    with pytest.raises(MismatchError, match="compressing"):
        field.check_scene(scene.subset(np.arange(600)[::-1]))
    with pytest.raises(MismatchError, match="600 Gaussians, the given one has 599"):
        field.check_scene(scene.subset(np.arange(599)))


def test_another_encoder_is_refused():
    field = toy_field()
    field.check_encoder(EncoderIdentity("toy", 32, ""))
    for other in (EncoderIdentity("toy", 64), EncoderIdentity("toy", 32, "w1")):
        with pytest.raises(MismatchError, match="use toy with the same weights"):
            field.check_encoder(other)
    with pytest.raises(MismatchError, match=r"64 numbers.*toy \(32-d, weights w0\)"):
        field.scores(np.ones(64, np.float32))
    with refused("not zero"):
        field.scores(np.zeros(32, np.float32))
    evidence = random_evidence(default_rng(9))
    with pytest.raises(MismatchError, match="codebook is of"):
        build_field(evidence, SCENE, EncoderIdentity("other", 32), field.codebook)
    with pytest.raises(MismatchError, match="embeddings of 32 numbers"):
        build_field(evidence, SCENE, EncoderIdentity("toy", 16))


def test_no_evidence_at_all_is_refused():
    evidence = random_evidence(default_rng(10))
    empty = csr_array((600, 40), dtype=np.float32)
    with refused("no Gaussian is under any mask"):
        build_field(Evidence(empty, evidence.masks, evidence.embeddings), SCENE, TOY)


def test_evidence_that_does_not_fit_is_refused():
    good = random_evidence(default_rng(11))
    with refused("unit vectors"):
        Evidence(good.weights, good.masks, 2 * good.embeddings)
    with refused("per column"):
        Evidence(good.weights, good.masks, good.embeddings[:-1])
    with refused("view"):
        MaskIds(("a",), np.ones(3, np.int32), np.zeros(3, np.int32))


@pytest.mark.parametrize("make", [toy_field, residual_field, mixed_field])
def test_what_is_found_is_what_the_scores_say(make):
    field, rng = make(), default_rng(11)
    queries = 3 * unit_rows(rng, 5, 32)
    scores = field.scores(queries)
    assert_array_equal(scores[3], field.scores(queries[3]))
    assert_array_equal(field.select(queries[0], 0.2).rows, np.flatnonzero(scores[0] > 0.2))
    order = np.argsort(-scores[0], kind="stable")
    assert_array_equal(field.top(queries[0], 7).rows, order[:7])
    best = field.best(queries)
    assert_array_equal(best.index, scores.argmax(axis=0))
    assert_array_equal(best.scores, scores.max(axis=0))
    assert_array_equal(best.runner_up, np.sort(scores, axis=0)[-2])
    with refused("with_negatives"):
        field.select_relevant(queries[0])
    compared = field.with_negatives(unit_rows(rng, 20, 32))
    for threshold in (0.3, 0.5, 0.55):
        rows, theirs = compared.select_relevant(queries[0], threshold)
        expected = np.flatnonzero(compared.relevancy(queries[0]) > threshold)
        assert len(set(rows) ^ set(expected)) <= 1  # rounding at the edge
        assert_array_equal(theirs, scores[0, rows])
    for bad in (0.0, 1.0, float("nan")):
        with refused("between 0 and 1"):
            compared.select_relevant(queries[0], bad)
    with pytest.raises(MismatchError, match="31 numbers"):
        field.best(queries[:, 1:])


def test_codes_begin_at_a_cache_line(tmp_path):
    for seed, rows in enumerate((600, 601, 777)):
        field = build_field(random_evidence(default_rng(seed), rows), SCENE, TOY)
        field.save(tmp_path / str(seed))
        again = load_field(tmp_path / str(seed))
        assert again.code.grouped.ctypes.data % 64 == 0


def manifest_of(path: Path) -> dict:
    return json.loads((path / "field.json").read_text())


@pytest.fixture
def saved(tmp_path) -> Path:
    toy_field(0).with_negatives(unit_rows(default_rng(0), 2, 32)).save(tmp_path / "a")
    return tmp_path / "a"


@pytest.mark.parametrize("file", ["codes.safetensors", "evidence.safetensors", "field.json"])
def test_files_of_two_fields_do_not_mix(file, saved, tmp_path):
    toy_field(1).save(tmp_path / "b")
    (saved / file).write_bytes((tmp_path / "b" / file).read_bytes())
    with pytest.raises(MismatchError, match="do not mix"):
        load_field(saved)


@pytest.mark.parametrize("file", ["codes", "evidence", "negatives"])
def test_a_missing_file_is_noticed(file, saved):
    (saved / f"{file}.safetensors").unlink()
    with malformed("incomplete"):
        load_field(saved)


@pytest.mark.parametrize(
    ("entry", "value", "message"),
    [
        ("format", "other", "expected a 'drsplat field'"),
        ("version", 4, "upgrade"),
        ("version", True, "upgrade"),
        ("version", 2, "upgrade"),
        ("encoder", {"name": "other", "dim": 32, "weights": ""}, "codebook is of"),
        ("encoder", {"name": "toy"}, "the encoder: dim: expected a number"),
        ("code", {"kind": "pq", "codebook": "0", "encoder": asdict(TOY)}, "hash"),
        ("code", {"kind": "pq", "codebook": "0"}, "the encoder: expected an object with name, dim"),
        ("code", {"kind": "other"}, "kept as 'other'"),
        ("code", None, "code: expected an object with kind"),
        ("num_gaussians", 500, "in a scene of 500"),
        ("num_gaussians", True, "num_gaussians: expected a number"),
        ("negatives", ["one"], r"expected embeddings \(1, 32\), got \(2, 32\)"),
    ],
)
def test_a_changed_manifest_is_refused(entry, value, message, saved):
    (saved / "field.json").write_text(json.dumps(sealed(manifest_of(saved) | {entry: value})))
    with pytest.raises((FormatError, MismatchError), match=message):
        load_field(saved)


@pytest.mark.parametrize(
    ("file", "name", "shape", "kind", "value"),
    [
        ("codes", "grouped_codes", (600, 32), "u1", 0),
        ("codes", "grouped_codes", (1, 32, 256), "u1", 0),
        ("codes", "grouped_codes", (3, 31, 256), "u1", 0),
        ("codes", "grouped_codes", (3, 32, 255), "u1", 0),
        ("codes", "grouped_codes", (3, 32, 256), "i1", 0),
        ("codes", "inverse_norms", 600, "f4", np.nan),
        ("codes", "gaussian_ids", 600, "u4", 0),
        ("codes", "gaussian_ids", 600, "i8", 0),
        ("codes", "coarse_ids", 600, "u2", 0),
        ("codes", "centroids", (32, 256, 1), "f8", 0),
        ("evidence", "indptr", 0, "i4", 0),
        ("evidence", "indptr", 2, "i4", 10**6),
        ("evidence", "indices", 1200, "i4", 40),
        ("evidence", "indices", 1200, "i4", -1),
        ("evidence", "data", (2, 600), "f4", 0),
        ("evidence", "embeddings", (40, 32), "f4", 0),
        ("evidence", "embeddings", 40, "f4", 0),
        ("evidence", "segment_views", 40, "i4", 3),
        ("negatives", "maxima", 3, "f4", 0),
        ("negatives", "embeddings", (2, 31), "f4", 0),
        ("codes", "grouped_codes", None, "", 0),
        ("evidence", "indices", None, "", 0),
    ],
)
def test_arrays_that_do_not_fit_are_refused(file, name, shape, kind, value, saved):
    path = saved / f"{file}.safetensors"
    tensors, metadata = map_tensors(path)
    others = {key: np.array(array) for key, array in tensors.items() if key != name}
    changed = {} if shape is None else {name: np.full(shape, value, kind)}
    write_tensors(path, others | changed, metadata, overwrite=True)
    with pytest.raises(FormatError):
        load_field(saved)


def test_our_files_are_plain_safetensors(saved, tmp_path):
    ours, _ = map_tensors(saved / "codes.safetensors")
    theirs = load_file(saved / "codes.safetensors")
    assert ours.keys() == theirs.keys()
    for name, array in ours.items():
        assert_array_equal(array, theirs[name])
    save_file(theirs, tmp_path / "back", {"field": "x"})
    back, metadata = map_tensors(tmp_path / "back")
    assert metadata == {"field": "x"}
    for name, array in back.items():
        assert_array_equal(array, theirs[name])


def test_rows_of_gaussians():
    field = toy_field()
    ids = field.gaussian_ids.astype(np.int64)
    assert_array_equal(field.rows_of(ids[::-1]), np.arange(len(field))[::-1])
    absent = np.setdiff1d(np.arange(-2, field.num_gaussians + 2), ids)
    assert len(absent) > 4
    assert (field.rows_of(absent) == -1).all()
    assert field.rows_of(np.array([2**40, -(2**40)])).tolist() == [-1, -1]
    nothing = np.empty(0, np.int64)
    none = replace(field, gaussian_ids=field.gaussian_ids[:0], code=field.code.rows(nothing), evidence=None)
    assert none.rows_of(ids[:2]).tolist() == [-1, -1]
