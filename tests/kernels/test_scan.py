"""The scan kernels: closed forms, the float64 twin, every instruction set, any shape, any thread."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from drsplat.kernels import (
    GroupedRows,
    QueryTables,
    Scanning,
    available_isas,
    group_codes,
    lookup_tables,
    rows_of_groups,
    scan_above,
    scan_best,
    scan_scores,
    scan_top,
)
from refusing import refused
from twins import scan as reference_scan

every_isa = pytest.mark.parametrize("isa", available_isas())
FUSED = [isa for isa in available_isas() if isa in ("v3", "v4", "v4_vbmi")]  # multiply and add with one rounding
HYBRID = Scanning(error=2e-3, wide=16)


def drawn(seed: int, count: int, subvectors: int, queries: int = 1, coarse: int = 0) -> tuple[GroupedRows, QueryTables]:
    """Rows and tables of cosines: a table's range falls with the number of sub-vectors."""
    rng = default_rng(seed)
    codes = rng.integers(0, 256, (count, subvectors), np.uint8)
    norms = rng.uniform(0.5, 1.0, count).astype(np.float32)
    luts = rng.normal(size=(queries, subvectors, 256)) / max(subvectors, 4)
    luts *= rng.gamma(2.0, 0.5, (queries, subvectors, 1))
    ids = rng.integers(0, coarse, count).astype(np.uint16) if coarse else None
    terms = rng.normal(size=(queries, coarse)).astype(np.float32) if coarse else None
    return (GroupedRows(group_codes(codes), norms, ids), QueryTables(luts.astype(np.float32), terms))


def test_groups_hold_the_rows_and_zeros_after_them():
    codes = np.arange(300 * 3, dtype=np.uint32).astype(np.uint8).reshape(300, 3) + np.uint8(1)
    grouped = group_codes(codes)
    assert grouped.shape == (2, 3, 256)
    assert grouped[1, 2, 7] == codes[263, 2]
    assert not grouped[1, :, 44:].any()
    rows = np.array([0, 299, 255, 256, 3])
    assert_array_equal(rows_of_groups(grouped, rows), codes[rows])
    assert group_codes(codes[:0]).shape == (0, 3, 256)


@every_isa
def test_a_closed_form(isa):
    """lut[m, c] = c + 1000 m: a sum is that of the bytes, plus a constant."""
    rng = default_rng(0)
    codes = rng.integers(0, 256, (777, 5), np.uint8)
    lut = (np.arange(256) + 1000.0 * np.arange(5)[:, None]).astype(np.float32)
    rows = GroupedRows(group_codes(codes), np.full(777, 0.5, np.float32))
    found = scan_scores(rows, QueryTables(lut[None]), Scanning(0.25, isa=isa))
    exact = (codes.sum(axis=1, dtype=np.int64) + 10000) / 2
    assert_allclose(found[0], exact, rtol=0, atol=0.125)


@every_isa
@pytest.mark.parametrize("subvectors", [1, 3, 8, 32, 33, 64, 128, 256, 257, 300])
@pytest.mark.parametrize("queries", [1, 5, 20])
def test_scores_are_those_of_the_twin(isa, subvectors, queries):
    rows, tables = drawn(subvectors, 700, subvectors, queries, coarse=queries)
    exact = reference_scan.scan_scores(rows, tables)
    assert_allclose(scan_scores(rows, tables, Scanning(isa=isa)), exact, rtol=0, atol=1e-4)
    rough = scan_scores(rows, tables, HYBRID._replace(isa=isa))
    assert_allclose(rough, exact, rtol=0, atol=2e-3)


@pytest.mark.skipif(len(FUSED) < 2, reason="this machine has at most one of them")
@pytest.mark.parametrize("how", [Scanning(), HYBRID])
@pytest.mark.parametrize(("subvectors", "queries"), [(7, 1), (128, 3), (128, 20), (300, 5), (290, 19)])
def test_instruction_sets_agree_to_the_bit(how, subvectors, queries):
    """Bytes by shuffles, and whole numbers by loads: sums of steps are exact, whichever way they are added up."""
    rows, tables = drawn(subvectors, 1000, subvectors, queries, coarse=queries)
    tables.luts[:, 3] *= 50
    answers = [
        (scan_scores(rows, tables, how._replace(isa=isa)), *scan_best(rows, tables, how._replace(isa=isa)))
        for isa in FUSED
    ]
    for answer in answers[1:]:
        for a, b in zip(answers[0], answer, strict=True):
            assert_array_equal(a, b)


@every_isa
@pytest.mark.parametrize("count", [0, 1, 255, 256, 257, 512, 513, 1000])
def test_any_number_of_rows(isa, count):
    rows, tables = drawn(1, count, 7, 3)
    exact, how = reference_scan.scan_scores(rows, tables), Scanning(isa=isa)
    scores = scan_scores(rows, tables, how)
    assert scores.shape == (3, count)
    assert_allclose(scores, exact, rtol=0, atol=1e-4)
    one = QueryTables(tables.luts[:1])
    found, theirs = scan_above(rows, one, 0.0, how=how)
    assert_array_equal(found, reference_scan.above(scores[0], 0.0))
    assert_array_equal(theirs, scores[0, found])
    if count:
        found, theirs = scan_top(rows, one, 11, how)
        assert_array_equal(found, reference_scan.top(scores[0], 11))
        assert_array_equal(theirs, scores[0, found])
    for given_, expected in zip(scan_best(rows, tables, how), reference_scan.best(scores), strict=True):
        assert_array_equal(given_, expected)


@every_isa
@pytest.mark.parametrize("coarse", [0, 5])
def test_the_best_of_many_queries_is_that_of_their_scores(isa, coarse):
    """Of more queries than are summed together, and rows that do not fill a register; of equal scores the first."""
    rows, tables = drawn(5, 523, 8, 40, coarse)
    for part in tables:
        if part is not None:
            part[33] = part[2]
    how = HYBRID._replace(isa=isa)
    expected = reference_scan.best(scan_scores(rows, tables, how))
    for found, wanted in zip(scan_best(rows, tables, how), expected, strict=True):
        assert_array_equal(found, wanted)


@every_isa
def test_bytes_after_the_last_row_are_never_reported(isa):
    rows, tables = drawn(2, 300, 4)
    dirty = rows.codes.copy()
    dirty[1, :, 44:] = np.arange(256, dtype=np.uint8)[44:]
    tables.luts[0, :, 44:] += 10
    dirty_rows, how = rows._replace(codes=dirty), Scanning(isa=isa)
    assert_array_equal(scan_scores(dirty_rows, tables, how), scan_scores(rows, tables, how))
    assert scan_top(dirty_rows, tables, 1000, how)[0].max() == 299
    assert scan_above(dirty_rows, tables, -np.inf, how=how)[0].tolist() == list(range(300))


@every_isa
@pytest.mark.parametrize("wide", [0, 16])
def test_one_outlier_does_not_coarsen_the_others(isa, wide):
    """As CLIP's: one sub-vector spans a hundred times the range of the rest."""
    rows, tables = drawn(3, 2000, 128)
    tables.luts[0, 17] *= 100
    tables.luts[0, 90, 3] = 0.9
    exact = reference_scan.scan_scores(rows, tables)
    found = scan_scores(rows, tables, Scanning(2e-3 if wide else 1e-4, wide, isa=isa))
    assert abs(found - exact).max() < (2e-3 if wide else 1e-4)


@every_isa
def test_hostile_tables_give_no_harm(isa):
    """Ranges of nothing, and far beyond any cosine: as right as float32 is."""
    rows, tables = drawn(4, 300, 9)
    for scale in (0.0, 1e-30, 1e6, 1e30):
        scaled = QueryTables(tables.luts * np.float32(scale))
        exact = reference_scan.scan_scores(rows, scaled)
        for wide in (0, 16):
            found = scan_scores(rows, scaled, Scanning(wide=wide, isa=isa))
            assert_allclose(found, exact, rtol=0, atol=2e-3 + 1e-5 * scale)
    constant = QueryTables(np.full((1, 9, 256), 0.125, np.float32))
    sums = scan_scores(rows, constant, Scanning(isa=isa))[0]
    assert_allclose(sums, 9 * 0.125 * rows.inverse_norms, rtol=1e-6)


@every_isa
def test_rows_without_a_norm_score_zero(isa):
    rows, tables = drawn(5, 400, 8, 3, coarse=2)
    norms = rows.inverse_norms.copy()
    norms[[0, 17, 399]] = 0
    rows, how = rows._replace(inverse_norms=norms), Scanning(isa=isa)
    assert not scan_scores(rows, tables, how)[:, [0, 17, 399]].any()
    index, scores, runner_up = scan_best(rows, tables, how)
    assert not index[[0, 17, 399]].any()
    assert not scores[[0, 17, 399]].any()
    assert not runner_up[[0, 17, 399]].any()


@every_isa
@pytest.mark.parametrize("queries", [1, 2, 7, 8, 16, 17, 40])
def test_a_query_scores_the_same_alone_and_among_others(isa, queries):
    rows, tables = drawn(6, 600, 35, queries)
    together = scan_scores(rows, tables, Scanning(isa=isa))
    for query in range(queries):
        alone = scan_scores(rows, QueryTables(tables.luts[query : query + 1]), Scanning(isa=isa))
        assert_array_equal(alone[0], together[query])


@every_isa
def test_any_number_of_threads_gives_the_same_bits(isa):
    rows, tables = drawn(7, 70_001, 12, 20, coarse=3)
    one = QueryTables(tables.luts[:1], tables.coarse[:1] if tables.coarse is not None else None)
    floor = np.linspace(-0.5, 0.5, 70_001).astype(np.float32)

    def everything(threads):
        how = Scanning(threads=threads, isa=isa)
        rough = HYBRID._replace(threads=threads, isa=isa)
        return [
            scan_scores(rows, tables, how),
            *scan_above(rows, one, 0.1, floor, how),
            *scan_top(rows, one, 500, how),
            *scan_best(rows, tables, rough),
        ]

    first = everything(1)
    for threads in (2, 3, 7):
        for a, b in zip(first, everything(threads), strict=True):
            assert_array_equal(a, b)


@every_isa
def test_ties_go_to_the_first(isa):
    rows, tables = drawn(8, 2000, 3)
    few = rows._replace(codes=rows.codes % 2, inverse_norms=np.ones(2000, np.float32))
    how = Scanning(isa=isa)
    scores = scan_scores(few, tables, how)[0]
    assert len(set(scores.tolist())) <= 8
    found, _ = scan_top(few, tables, 700, how)
    assert_array_equal(found, reference_scan.top(scores, 700))
    twice = QueryTables(np.repeat(tables.luts, 3, axis=0))
    index, best, runner_up = scan_best(few, twice, how)
    assert not index.any()
    assert_array_equal(best, runner_up)


@given(st.integers(0, 2**32 - 1), st.integers(1, 40), st.integers(1, 600), st.integers(1, 20))
def test_laws(seed, subvectors, count, queries):
    """Of any drawn case and any instruction set: near the twin, and all answers of one mind."""
    rows, tables = drawn(seed, count, subvectors, queries, coarse=seed % 2 * 3)
    exact = reference_scan.scan_scores(rows, tables)
    for isa in available_isas():
        how = Scanning(isa=isa)
        scores = scan_scores(rows, tables, how)
        assert_allclose(scores, exact, rtol=0, atol=1e-4)
        for a, b in zip(scan_best(rows, tables, how), reference_scan.best(scores), strict=True):
            assert_array_equal(a, b)
        only = QueryTables(*(None if part is None else part[:1] for part in tables))
        threshold = float(np.median(scores[0]))
        floor = scores[-1]
        found, _ = scan_above(rows, only, threshold, floor, how)
        assert_array_equal(found, reference_scan.above(scores[0], threshold, floor))
        assert_array_equal(scan_top(rows, only, 9, how)[0], reference_scan.top(scores[0], 9))


@every_isa
@pytest.mark.parametrize(("subvectors", "dim"), [(1, 512), (4, 1), (128, 4), (16, 3)])
def test_tables_are_inner_products(isa, subvectors, dim):
    rng = default_rng(9)
    centroids = rng.normal(size=(subvectors, dim, 256)).astype(np.float32)
    queries = rng.normal(size=(5, subvectors * dim)).astype(np.float32)
    found = lookup_tables(centroids, queries, isa=isa, threads=2)
    assert_allclose(found, reference_scan.lookup_tables(centroids, queries), atol=1e-4)
    assert_array_equal(found, lookup_tables(centroids, queries, isa=isa, threads=1))


def test_what_does_not_fit_is_refused():
    rows, tables = drawn(10, 300, 4, 2, coarse=3)
    ids, coarse = rows.coarse_ids, tables.coarse
    bad = [
        (rows._replace(codes=rows.codes[:1]), tables, r"expected codes \(2, L, 256\)"),
        (rows._replace(codes=rows.codes[:, :0]), tables, "expected codes"),
        (rows, tables._replace(luts=tables.luts[:, :3]), "expected tables"),
        (rows, tables._replace(luts=tables.luts[:0]), "1 to 65536 queries"),
        (rows._replace(coarse_ids=None), tables, "coarse ids belong"),
        (rows, tables._replace(coarse=None), "coarse ids belong"),
        (rows._replace(coarse_ids=ids[1:]), tables, "300 coarse ids"),
        (rows, tables._replace(coarse=coarse[:1]), "300 coarse ids"),
        (rows._replace(coarse_ids=np.full(300, 65535, np.uint16)), tables, "coarse id 65535 of 3"),
    ]
    for some_rows, some_tables, message in bad:
        with refused(message):
            scan_best(some_rows, some_tables)
    with refused("one query"):
        scan_top(rows, tables, 1)
    one = QueryTables(tables.luts[:1], coarse[:1])
    with refused("one query"):
        scan_above(rows, tables, 0.0)
    with refused("count of 1 or more"):
        scan_top(rows, one, 0)
    with refused("a floor per row"):
        scan_above(rows, one, 0.0, np.zeros(3, np.float32))
    with refused("an error above 0"):
        scan_scores(rows, one, Scanning(error=0.0))
    with refused("z80"):
        scan_scores(rows, one, Scanning(isa="z80"))
    with refused("do not fit centroids"):
        lookup_tables(np.zeros((2, 3, 256), np.float32), np.zeros((1, 5), np.float32))
