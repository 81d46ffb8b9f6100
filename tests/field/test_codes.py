"""Codebooks: what coding keeps, and the authors' own index."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from drsplat.errors import MismatchError
from drsplat.field.codes import (
    Code,
    Codebook,
    Codes,
    from_official_bytes,
    load_codebook,
    official_bytes,
    pq_code,
    read_faiss_codebook,
    save_codebook,
    train_codebook,
)
from drsplat.scene.encoders import EncoderIdentity
from fields import OFFICIAL_INDEX, unit_rows
from refusing import malformed, refused
from twins import algebra as reference_algebra
from twins import scan as reference_scan

CLIP = EncoderIdentity("ViT-B-16/laion2b_s34b_b88k", 512)
SMALL = EncoderIdentity("small", 24)
few = settings(derandomize=True, max_examples=30)


def clustered(rng: np.random.Generator, count: int, dim: int) -> np.ndarray:
    rows = unit_rows(rng, 30, dim)[rng.integers(0, 30, count)]
    rows += 0.03 * rng.standard_normal(rows.shape).astype(np.float32)
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


@lru_cache
def small_codebook(residual: bool = False) -> Codebook:
    rng = default_rng(0)
    points = clustered(rng, 2000, 24)
    if not residual:
        return train_codebook(points, 6, encoder=SMALL)
    coarse = np.concatenate([unit_rows(rng, 9, 24), np.zeros((3, 24), np.float32)])
    left = points - coarse[(points @ coarse.T).argmax(axis=1)]
    return Codebook(train_codebook(left, 6, encoder=SMALL).centroids, coarse, SMALL)


both_kinds = pytest.mark.parametrize("residual", [False, True])


def random_codes(rng: np.random.Generator, codebook: Codebook, count: int) -> Codes:
    codes = rng.integers(0, 256, (count, codebook.num_subvectors), np.uint8)
    lists = codebook.coarse
    return Codes(codes, None if lists is None else rng.integers(0, len(lists), count, np.uint16))


@both_kinds
def test_scores_are_cosines_of_what_is_decoded(residual):
    book, rng = small_codebook(residual), default_rng(1)
    codes, query = random_codes(rng, book, 500), unit_rows(rng, 1, 24)[0]
    decoded = reference_algebra.pq_decode(codes.codes, book.centroids)
    if book.coarse is not None:
        decoded += book.coarse[codes.coarse_ids]
    assert_allclose(book.decode(codes), decoded, atol=1e-6)
    norms = np.linalg.norm(decoded, axis=1)
    assert_allclose(book.inverse_norms(codes), 1 / norms, rtol=1e-5)
    code = pq_code(book, codes)
    assert_allclose(code.scores(query[None])[0], decoded @ query / norms, atol=1e-4)
    assert_allclose(code.decode(np.arange(500)), decoded / norms[:, None], atol=1e-6)


@both_kinds
@pytest.mark.parametrize("queries", [1, 3, 20, 300])
def test_all_answers_of_a_code_are_of_one_mind(residual, queries):
    book, rng = small_codebook(residual), default_rng(2)
    code, asked = pq_code(book, random_codes(rng, book, 700)), unit_rows(rng, queries, 24)
    assert isinstance(code, Code)
    assert (len(code), code.dim) == (700, 24)
    assert code.nbytes == 3 * 256 * 6 + 700 * (6 if residual else 4)
    scores = code.scores(asked)
    index, best, runner_up = reference_scan.best(scores)
    found = code.best(asked)
    few = queries <= 16
    assert_allclose(found.scores, best, rtol=0, atol=0 if few else 2e-3)
    assert_allclose(found.runner_up, runner_up, rtol=0, atol=0 if few else 2e-3)
    clear = best - runner_up > (0 if few else 4e-3)
    assert clear.mean() > 0.9
    assert_array_equal(found.index[clear], index[clear])
    rows, theirs = code.select(asked[0], 0.1)
    assert_array_equal(rows, np.flatnonzero(scores[0] > 0.1))
    assert_array_equal(theirs, scores[0, rows])
    floor = scores[-1]
    rows, _ = code.select(asked[0], 0.1, floor)
    assert_array_equal(rows, np.flatnonzero(scores[0] - floor > np.float32(0.1)))
    assert_array_equal(code.top(asked[0], 33).rows, reference_scan.top(scores[0], 33))
    some = np.array([699, 3, 3, 256])
    assert_allclose(code.rows(some).scores(asked), scores[:, some], rtol=0, atol=1e-4)
    assert code.scores(asked[:0]).shape == (0, 700)
    with refused("one or more queries"):
        code.best(asked[:0])


def test_any_number_of_coarse_centroids():
    plain, rng = small_codebook(), default_rng(6)
    for count in (1, 256, 257, 600):
        book = Codebook(plain.centroids, unit_rows(rng, count, 24), plain.encoder)
        queries = unit_rows(rng, 3, 24)
        terms = book.tables(queries).coarse
        assert terms is not None
        assert_allclose(terms, queries @ unit_coarse(book).T, atol=1e-6)


def unit_coarse(book: Codebook) -> np.ndarray:
    assert book.coarse is not None
    return book.coarse


def test_codes_in_groups_are_the_same_codes():
    book, rng = small_codebook(True), default_rng(3)
    codes = random_codes(rng, book, 300)
    code = pq_code(book, codes)
    assert_array_equal(code.codes().codes, codes.codes)
    assert_array_equal(official_bytes(code.codes()), official_bytes(codes))
    assert code.codes().coarse_ids is not None
    dirty = code.grouped.copy()
    dirty[-1, :, 44:] = 255
    marked = replace(code, grouped=dirty)  # what lies past the last row means nothing
    query = unit_rows(rng, 1, 24)
    assert_array_equal(marked.scores(query), code.scores(query))
    assert_array_equal(marked.top(query[0], 1000).rows, code.top(query[0], 1000).rows)


def test_a_code_that_does_not_fit_its_codebook_is_refused():
    book, rng = small_codebook(True), default_rng(4)
    code = pq_code(book, random_codes(rng, book, 300))
    ids = code.coarse_ids
    assert ids is not None
    bad = [
        ({"grouped": code.grouped[:1]}, "grouped codes: expected uint8"),
        ({"grouped": code.grouped[:, :5]}, "grouped codes: expected uint8"),
        ({"inverse_norms": -code.inverse_norms}, "0 or more"),
        ({"inverse_norms": code.inverse_norms * np.float32(np.nan)}, "finite"),
        ({"coarse_ids": None}, "belong with a residual"),
        ({"coarse_ids": ids + np.uint16(60000)}, "coarse id 6"),
    ]
    for changes, message in bad:
        with refused(message):
            replace(code, **changes)


@pytest.mark.parametrize("worst", [np.nan, np.inf, 1e30])
def test_centroids_whose_norms_are_no_float32_are_refused(worst):
    book = small_codebook(True)
    assert book.coarse is not None
    for name in ("centroids", "coarse"):
        spoiled = getattr(book, name).copy()
        spoiled[-1, -1] = worst
        with refused("finite, and not beyond 1e"):
            replace(book, **{name: spoiled})


def test_short_rows_get_finer_tables():
    """Scores are divided by norms: of a row ten times too short the error would be ten times as large."""
    book, rng = small_codebook(), default_rng(5)
    small = Codebook(book.centroids / 10, None, book.encoder)
    code = pq_code(small, random_codes(rng, small, 2000))
    query = unit_rows(rng, 1, 24)
    decoded = code.codebook.decode(code.codes()).astype(np.float64)
    exact = decoded @ query[0] / np.linalg.norm(decoded, axis=1)
    assert_allclose(code.scores(query)[0], exact, rtol=0, atol=1e-4)


@few
@given(st.integers(0, 2**32))
def test_coding_what_was_decoded_changes_nothing(seed):
    book = small_codebook()
    codes = random_codes(default_rng(seed), book, 20)
    decoded = book.decode(codes)
    again = book.encode(decoded)
    assert_array_equal(book.decode(again), decoded)  # codes may differ where centroids are equal
    assert_array_equal(book.encode(book.decode(again)).codes, again.codes)


@both_kinds
def test_a_row_is_coded_alike_alone_and_among_others(residual):
    book, points = small_codebook(residual), clustered(default_rng(2), 9000, 24)
    together, alone = book.encode(points), book.encode(points[8500:8501])
    assert_array_equal(together.codes[8500], alone.codes[0])
    assert_array_equal(together.rows(slice(8500, 8501)).coarse_ids, alone.coarse_ids)


def faiss_index(book: Codebook):
    """Return an IndexPQ of FAISS's with our centroids."""
    import faiss

    index = faiss.IndexPQ(book.encoder.dim, book.num_subvectors, 8)
    faiss.copy_array_to_vector(book.centroids.ravel(), index.pq.centroids)
    index.is_trained = True
    return index


@pytest.mark.oracle
def test_our_codebook_serves_as_an_index_of_faiss(tmp_path):
    """It codes, decodes and searches alike there, and comes back from its file to the bit."""
    faiss = pytest.importorskip("faiss")
    rng = default_rng(13)
    points, book = clustered(rng, 2000, 24), small_codebook()
    index = faiss_index(book)
    ours, theirs = book.encode(points), index.sa_encode(points)
    clear = clear_cut(book, points)
    assert clear.mean() > 0.99
    assert_array_equal(ours.codes[clear], theirs[clear])
    assert_allclose(book.decode(ours), index.sa_decode(ours.codes), rtol=0, atol=1e-7)

    index.add(points)
    distances, rows = index.search(points[:5], 3)
    errors = ((points[:5, None] - book.decode(Codes(theirs, None))[None]) ** 2).sum(-1)
    assert_allclose(np.sort(errors, axis=1)[:, :3], distances, atol=1e-5)
    assert_allclose(np.take_along_axis(errors, rows, 1), distances, atol=1e-5)

    faiss.write_index(index, str(tmp_path / "own.faiss"))
    assert read_faiss_codebook(tmp_path / "own.faiss", SMALL).hash == book.hash


def clear_cut(book: Codebook, points: np.ndarray) -> np.ndarray:
    """Return in which parts the nearest centroid is nearer than the next by more than rounding."""
    parts = points.reshape(len(points), book.num_subvectors, -1).astype(np.float64)
    errors = np.sort(((parts[:, :, None] - book.centroids[None].astype(np.float64)) ** 2).sum(-1), axis=-1)
    return np.asarray(errors[..., 1] - errors[..., 0] > 1e-6)


def test_training_is_as_good_as_that_of_faiss():
    faiss = pytest.importorskip("faiss")
    rng = default_rng(4)
    points, unseen = clustered(rng, 6000, 32), clustered(rng, 2000, 32)
    ours = train_codebook(points, 8, encoder=EncoderIdentity("toy", 32))
    quantizer = faiss.ProductQuantizer(32, 8, 8)
    quantizer.cp.niter, quantizer.cp.min_points_per_centroid = 12, 1
    quantizer.train(points)
    centroids = faiss.vector_to_array(quantizer.centroids).reshape(8, 256, 4).copy()
    theirs = Codebook(centroids, None, ours.encoder)
    errors = [((b.decode(b.encode(unseen)) - unseen) ** 2).mean() for b in (ours, theirs)]
    assert errors[0] <= 1.05 * errors[1]


def test_training_gives_the_same_bits_for_any_number_of_threads():
    points = clustered(default_rng(5), 3000, 24)
    books = [train_codebook(points, 6, encoder=SMALL, threads=t) for t in (1, 2, 3)]
    assert len({book.hash for book in books}) == 1
    assert train_codebook(points, 6, encoder=SMALL, seed=1).hash != books[0].hash


def test_more_points_than_are_used_are_sampled_over_all_of_them():
    points = np.repeat(unit_rows(default_rng(6), 2, 24), 20_000, axis=0)
    book = train_codebook(points, 6, encoder=SMALL)
    assert_array_equal(book.decode(book.encode(points[[0, -1]])), points[[0, -1]])


@few
@given(st.integers(1, 256), st.integers(0, 2**32))
def test_few_distinct_points_are_coded_without_loss(count, seed):
    rng = default_rng(seed)
    points = unit_rows(rng, count, 24)[rng.integers(0, count, 2 * count)]
    book = train_codebook(points, 6, encoder=SMALL)
    assert_array_equal(book.decode(book.encode(points)), points)


@both_kinds
def test_a_codebook_comes_back_from_disk_to_the_bit(residual, tmp_path):
    book, path = small_codebook(residual), tmp_path / "a.codebook"
    save_codebook(book, path)
    again = load_codebook(path)
    assert again.hash == book.hash
    assert again.encoder == book.encoder
    assert not again.centroids.flags.writeable
    assert_array_equal(again.centroids, book.centroids)
    with refused("overwrite"):
        save_codebook(book, path)


def test_the_hash_covers_everything():
    book = small_codebook(True)
    other = EncoderIdentity("another", 24)
    changed = book.centroids.copy()
    changed[-1, -1, -1] += 1
    hashes = {
        book.hash,
        Codebook(changed, book.coarse, SMALL).hash,
        Codebook(book.centroids, None, SMALL).hash,
        Codebook(book.centroids, book.coarse[::-1].copy(), SMALL).hash,
        Codebook(book.centroids, book.coarse, other).hash,
        Codebook(book.centroids.reshape(12, 256, 2), book.coarse, SMALL).hash,
    }
    assert len(hashes) == 6


def test_what_does_not_belong_together_is_refused():
    plain, residual = small_codebook(), small_codebook(True)
    codes = random_codes(default_rng(8), residual, 5)
    with pytest.raises(MismatchError, match="encoder"):
        Codebook(plain.centroids, None, CLIP)
    with refused("coarse ids"):
        plain.decode(codes)
    with refused("coarse id 65535"):
        residual.decode(Codes(codes.codes, np.full(5, 65535, np.uint16)))
    with refused("queries of 24 numbers, got 23"):
        plain.tables(np.zeros((1, 23), np.float32))
    with refused(r"cannot train 7 .* divides 24"):
        train_codebook(unit_rows(default_rng(0), 9, 24), 7, encoder=SMALL)
    with refused("official"):
        official_bytes(plain.encode(unit_rows(default_rng(0), 9, 24)))


def test_official_rows_without_a_feature_are_left_out_and_bad_ones_refused():
    book = small_codebook(True)
    codes = random_codes(default_rng(9), book, 6)
    codes.codes[4] = 255  # a legal code: only all 8 bytes 255 mark absence
    rows = official_bytes(codes)
    rows[2] = 255
    found = from_official_bytes(rows, book)
    kept = [0, 1, 3, 4, 5]
    assert_array_equal(found.ids, kept)
    assert_array_equal(found.codes.codes, codes.codes[kept])
    assert_array_equal(found.codes.coarse_ids, codes.coarse_ids[kept])
    rows[3, :2] = 12, 0
    with malformed("row 3 names list 12 of 12"):
        from_official_bytes(rows, book)
    with malformed("rows of 8 bytes"):
        from_official_bytes(rows[:, :7].copy(), book)


@lru_cache
def official() -> Codebook:
    if not OFFICIAL_INDEX.exists():
        pytest.skip("the authors' index is not here")
    return read_faiss_codebook(OFFICIAL_INDEX, CLIP)


@pytest.mark.data
def test_the_authors_index_is_read_as_faiss_reads_it():
    faiss = pytest.importorskip("faiss")
    book, rng = official(), default_rng(10)
    assert book.centroids.shape == (128, 256, 4)
    dead = ~book.coarse.any(axis=1)
    assert (len(book.coarse), int(dead.sum())) == (1024, 170)
    codes = random_codes(rng, book, 400)
    codes.coarse_ids[:170] = np.flatnonzero(dead)
    index = faiss.read_index(str(OFFICIAL_INDEX))
    assert_allclose(book.decode(codes), index.sa_decode(official_bytes(codes)), atol=1e-7)


@pytest.mark.data
def test_features_are_coded_as_with_the_authors_index():
    faiss = pytest.importorskip("faiss")
    book, rng = official(), default_rng(11)
    features = book.decode(random_codes(rng, book, 300))
    features += 0.02 * rng.standard_normal(features.shape).astype(np.float32)
    ours = official_bytes(book.encode(features))
    theirs = faiss.read_index(str(OFFICIAL_INDEX)).sa_encode(features)
    assert (ours == theirs).mean() > 0.9999
    assert_array_equal(from_official_bytes(theirs, book).ids, np.arange(300))


@pytest.mark.parametrize("kind", ["PQ", "IVFPQ", "IVFPQ with vectors", "IVFPQ, L2, no residual"])
def test_indices_that_faiss_writes_are_read(kind, tmp_path):
    faiss = pytest.importorskip("faiss")
    points, path = clustered(default_rng(12), 2000, 24), tmp_path / "a.faiss"
    if kind == "PQ":
        index = faiss.IndexPQ(24, 6, 8)
        index.do_polysemous_training = False
    else:
        metric = faiss.METRIC_L2 if "L2" in kind else faiss.METRIC_INNER_PRODUCT
        coarse = faiss.IndexFlatL2(24) if "L2" in kind else faiss.IndexFlatIP(24)
        index = faiss.IndexIVFPQ(coarse, 24, 16, 6, 8, metric)
        index.by_residual = "no residual" not in kind
        index.cp.min_points_per_centroid = 1
    index.pq.cp.min_points_per_centroid = 1
    index.train(points)
    if "vectors" in kind:
        index.add(points[:50])
        index.make_direct_map()
    faiss.write_index(index, str(path))
    book = read_faiss_codebook(path, SMALL)
    assert_array_equal(book.centroids.ravel(), faiss.vector_to_array(index.pq.centroids))
    assert (book.coarse is not None) == (kind in ("IVFPQ", "IVFPQ with vectors"))
    if book.coarse is not None:
        assert_array_equal(book.coarse, index.quantizer.reconstruct_n(0, 16))


def test_other_indices_are_refused_by_name(tmp_path):
    faiss = pytest.importorskip("faiss")
    path = tmp_path / "flat.faiss"
    faiss.write_index(faiss.IndexFlatIP(24), str(path))
    with malformed("IndexPQ"):
        read_faiss_codebook(path, SMALL)
    faiss.write_index(faiss.IndexPQ(24, 6, 4), str(path))
    with malformed("8 bits"):
        read_faiss_codebook(path, SMALL)
    with refused("no such file"):
        read_faiss_codebook(tmp_path / "none", SMALL)
