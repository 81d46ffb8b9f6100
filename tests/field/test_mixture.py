"""The mixture code: from evidence to rows that are searched, explained and handed on."""

from functools import lru_cache

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from drsplat.field import build_field
from drsplat.field.codes import PQ, Code, Codebook, Mixture, Smaller, choose_code, official_bytes, train_codebook
from drsplat.field.codes.mixture import (
    MixtureCode,
    encode_mixture,
    encoding,
    mixture_from_tensors,
    quantised,
    recoded,
    scene_atoms,
    train_scene_atoms,
)
from drsplat.field.evidence.evidence import Evidence
from drsplat.scene.encoders import EncoderIdentity
from fields import SCENE, TOY, random_evidence, unit_rows
from mutations import bounded_allocations
from refusing import malformed, refused
from twins import mixture as reference_mixture

SMALL = EncoderIdentity("small", 16)


@lru_cache
def evidence() -> Evidence:
    return random_evidence(default_rng(0), rows=900)


@lru_cache
def code() -> MixtureCode:
    return encode_mixture(evidence(), scene_atoms=20)


def rows_of(found: MixtureCode) -> tuple[np.ndarray, np.ndarray]:
    ids, weights, _ = found.unpacked(slice(None))
    return ids, weights


def test_it_is_a_code():
    assert isinstance(code(), Code)
    assert code().kind == "mixture"
    assert (len(code()), code().dim, code().atoms_per_row, code().row_bytes) == (900, 32, 4, 14)


def test_quantised_vectors_have_unit_length_and_hardly_turn():
    vectors = 7 * unit_rows(default_rng(1), 50, 300)
    vectors[3] = 0
    found = reference_mixture.atoms(quantised(vectors))
    lengths = np.linalg.norm(found, axis=1)
    assert_allclose(np.delete(lengths, 3), 1, atol=1e-6)
    assert lengths[3] == 0
    assert np.einsum("nd,nd->n", found, vectors / 7)[np.arange(50) != 3].min() > 0.9995
    with refused("finite"):
        quantised(np.full((1, 2), np.inf, np.float32))


def test_vectors_too_short_to_be_scaled_count_as_none():
    """Warnings are errors: 127 over such an entry is infinite."""
    found = quantised(np.float32([[1e-38, 0, 0], [1e-36, 0, 0]]))
    assert found.values.tolist() == [[0, 0, 0], [127, 0, 0]]
    assert found.scales[0] == 0


def test_rows_of_up_to_four_masks_are_kept():
    lengths = np.diff(evidence().weights.indptr)
    short = (lengths > 0) & (lengths <= 4)
    features = evidence().features(0, 900)[short]
    decoded = encode_mixture(evidence(), scene_atoms=0).decode(np.flatnonzero(short))
    assert short.sum() > 500
    assert np.einsum("nd,nd->n", features, decoded).min() > 0.998  # of eight bits per number and weight


def test_decoded_rows_have_unit_length_or_none():
    lengths = np.linalg.norm(code().decode(slice(None)), axis=1)
    seen = np.diff(evidence().weights.indptr) > 0
    assert 0 < seen.sum() < 900
    assert_allclose(lengths[seen], 1, atol=1e-3)  # a half float's digits
    assert not lengths[~seen].any()


def test_scores_are_cosines_of_what_is_decoded():
    queries = unit_rows(default_rng(2), 5, 32)
    scores = code().scores(queries)
    assert_allclose(scores, queries @ code().decode(slice(None)).T, atol=4e-5)
    assert not scores[:, np.diff(evidence().weights.indptr) == 0].any()


def test_rows_are_made_of_their_own_masks_and_of_scene_atoms():
    ids, weights = rows_of(code())
    masks, w = code().atoms.masks, evidence().weights
    for i in range(900):
        own = set(w.indices[w.indptr[i] : w.indptr[i + 1]])
        assert set(masks[ids[i][weights[i] > 0]]) <= own | {-1}
    assert (masks == -1).sum() <= 20
    assert len(np.unique(masks[masks >= 0])) == (masks >= 0).sum()


def test_atoms_that_no_row_uses_are_left_out():
    ids, weights = rows_of(code())
    uses = np.bincount(ids[weights > 0], minlength=len(code().atoms))
    assert (uses > 0).all()
    assert (np.diff(uses) <= 0).all()


def test_scene_atoms_help():
    rng = default_rng(4)
    base = random_evidence(rng, rows=2000, columns=60)
    features = base.features(0, 2000)
    cosines = [
        np.einsum("nd,nd->n", encode_mixture(base, 1, scene_atoms=count).decode(slice(None)), features).mean()
        for count in (0, 300)
    ]  # fmt: skip
    assert cosines[1] > cosines[0] + 0.01


def test_spherical_kmeans_finds_what_is_there():
    rng = default_rng(5)
    things = unit_rows(rng, 12, 24)
    points = things[rng.integers(0, 12, 2000)] + 0.02 * rng.standard_normal((2000, 24))
    points = (points / np.linalg.norm(points, axis=1, keepdims=True)).astype(np.float32)
    atoms = train_scene_atoms(points, 80)  # drawn at random, 12 would miss some
    assert (atoms.vectors @ things.T).max(axis=0).min() > 0.995
    assert_allclose(np.linalg.norm(atoms.vectors, axis=1), 1, atol=1e-5)
    nearest = np.argmax(points @ atoms.vectors.T, axis=1)
    assert (atoms.near(points)[:, 0] == nearest).mean() > 0.9


def test_idle_centres_move_to_where_the_fit_is_worst():
    points = np.repeat(np.eye(3, dtype=np.float32), [8, 1, 1], axis=0)
    centres = np.eye(3, dtype=np.float32)[[0, 0, 0]]
    moved = scene_atoms._means(points, np.zeros(10, np.int32), centres, 1)
    assert_array_equal(np.sort(moved[1:].argmax(axis=1)), [1, 2])
    with refused("atoms of 0 points"):
        train_scene_atoms(points[:0], 3)


def test_more_masks_than_ids_keep_those_used_most(monkeypatch):
    """65,536 is far more than a test wants; the rule is the same."""
    full = encode_mixture(evidence(), scene_atoms=5)
    monkeypatch.setattr(encoding, "MAX_ATOMS", 25)
    fewer = encode_mixture(evidence(), scene_atoms=5)
    assert len(fewer.atoms) <= 25 < len(full.atoms)
    kept = fewer.atoms.masks[fewer.atoms.masks >= 0]
    assert len(kept) == len(set(kept))
    features = evidence().features(0, 900)
    fits = [np.einsum("nd,nd->n", c.decode(slice(None)), features).mean() for c in (fewer, full)]
    assert 0.6 < fits[0] < fits[1]


def test_what_cannot_be_coded_is_refused():
    nothing = evidence().rows(np.arange(0))
    with refused("0 rows"):
        encode_mixture(nothing)
    for per_row in (0, 17):
        with refused("1 to 16 atoms"):
            encode_mixture(evidence(), per_row)
    for atoms in (-1, 40_000):
        with refused("scene atoms"):
            encode_mixture(evidence(), scene_atoms=atoms)


def test_rows_without_any_mask_are_zero():
    empty = evidence().rows(np.flatnonzero(np.diff(evidence().weights.indptr) == 0))
    found = encode_mixture(empty, scene_atoms=3)
    assert len(found) == len(empty) > 0
    assert not found.decode(slice(None)).any()
    assert not found.scores(unit_rows(default_rng(6), 2, 32)).any()


def test_the_masks_behind_a_score_are_named():
    query = unit_rows(default_rng(7), 1, 32)[0]
    row = int(code().top(query, 1).rows[0])
    parts = code().parts(row, query, top=10)
    assert parts
    assert sum(part.share for part in parts) == pytest.approx(1)
    assert [p.share for p in parts] == sorted((p.share for p in parts), reverse=True)
    own = evidence().weights[[row]].indices
    assert {part.mask for part in parts} <= {*own, -1}
    one = encode_mixture(evidence(), 1, scene_atoms=0)
    strongest = one.top(query, 1).rows[0]
    assert one.parts(int(strongest), query)[0].share == 1
    with refused("row 900"):
        code().parts(900, query)


def test_some_rows_are_a_code_of_their_own():
    index = np.array([5, 899, 0, 5, 64])
    part = code().rows(index)
    assert_array_equal(part.decode(slice(None)), code().decode(index))
    query = unit_rows(default_rng(8), 1, 32)
    assert_array_equal(part.scores(query), code().scores(query)[:, index])
    assert len(code().rows(slice(0, 0)).top(query[0], 3).rows) == 0


def test_it_can_always_become_a_product_quantised_code():
    decoded = code().decode(slice(None))
    directed = decoded[decoded.any(axis=1)]
    plain = train_codebook(directed, 8, encoder=TOY)
    residual = Codebook(plain.centroids, unit_rows(default_rng(9), 6, 32), TOY)
    for book in (plain, residual):
        found, expected = recoded(code(), book), book.encode(decoded)
        assert_array_equal(found.codes().codes, expected.codes)
    assert official_bytes(recoded(code(), residual).codes()).shape == (900, 10)
    other = train_codebook(unit_rows(default_rng(0), 9, 16), 4, encoder=SMALL)
    with refused("16 numbers for features of 32"):
        recoded(code(), other)


def test_missing_arrays_are_named():
    for name in code().tensors():
        others = {key: array for key, array in code().tensors().items() if key != name}
        with malformed(name):
            mixture_from_tensors(others, "a")


@pytest.mark.slow
def test_encoding_never_holds_all_features():
    rng = default_rng(11)
    large = random_evidence(rng, rows=60_000, columns=50, dim=512)  # 123 MB of features
    encode_mixture(large.rows(np.arange(9000)), scene_atoms=30, threads=1)  # what stays loaded
    with bounded_allocations(80 << 20):
        found = encode_mixture(large, scene_atoms=30, threads=1)
    assert len(found) == 60_000


def test_the_smaller_code_is_chosen():
    assert choose_code(1_000_000, 30_000, 512).name == "mixture"
    assert choose_code(100_000, 30_000, 512).name == "pq"
    assert choose_code(5_000, 300, 512).name == "mixture"
    few, many = choose_code(120_000, 30_000, 512), choose_code(180_000, 30_000, 512)
    assert (few.name, many.name) == ("pq", "mixture")
    assert few.pq_bytes == 120_000 * 132 + 256 * 512 * 4
    assert many.mixture_bytes == 180_000 * 14 + 34_096 * 520
    with refused("rows"):
        choose_code(-1, 3, 512)
    assert Smaller(8).chosen(1_000_000, 30_000, 512) == Mixture(8)
    assert Smaller().chosen(100_000, 30_000, 512) == PQ()


def test_a_field_takes_the_code_it_is_told():
    assert build_field(evidence(), SCENE, TOY, PQ(4)).codebook.num_subvectors == 4
    assert build_field(evidence(), SCENE, TOY, Mixture(2)).code.atoms_per_row == 2
    assert choose_code(evidence().num_seen, 40, 32).name == "mixture"
    assert build_field(evidence(), SCENE, TOY, Smaller(3)).code.atoms_per_row == 3
    many_masks = random_evidence(default_rng(0), rows=200, columns=4000)
    assert choose_code(many_masks.num_seen, 4000, 32).name == "pq"
    assert build_field(many_masks, SCENE, TOY, Smaller()).code.kind == "pq"
