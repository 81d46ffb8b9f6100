"""Search on a GPU: its kernels, run on the CPU, beside the native ones and the float64 twin."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from test_mixture import code as mixture_code
from test_scan import drawn

from cuda_on_cpu import CpuEngine, compiled
from drsplat import EncoderIdentity, LanguageField, load_field, open_scene
from drsplat.errors import MissingExtraError
from drsplat.field.codes import Codebook, Codes, PQCode, device_code, pq_code
from drsplat.fronts.serving.scene_folder import SceneFolder, Sources
from drsplat.kernels import scan
from drsplat.kernels.cuda import devices, scanning
from drsplat.kernels.cuda.engine import Engine, cuda_engine, unavailable
from drsplat.kernels.scan import MAX_SCORE_ERROR, GroupedRows, QueryTables
from refusing import refused
from twins import scan as reference_scan

HOPPER, ADA = 227 << 10, 99 << 10  # shared memory of a block


@pytest.fixture(
    scope="module",
    params=[HOPPER, ADA, pytest.param(None, marks=pytest.mark.gpu)],
    ids=["all sub-vectors at once", "64 at once", "a GPU"],
)
def engine(request) -> Engine:
    if request.param is not None:
        return CpuEngine(compiled(), request.param)
    reason = unavailable()
    if reason is not None:
        pytest.skip(reason)
    return cuda_engine()


def first_query(tables: QueryTables) -> QueryTables:
    return QueryTables(*(None if part is None else part[:1] for part in tables))


def check_everything(engine: Engine, rows: GroupedRows, tables: QueryTables) -> None:
    """Scores near the twin's, and every other answer what these scores say."""
    device, exact = scanning.sent_rows(engine, rows), reference_scan.scan_scores(rows, tables)
    scores = scanning.scan_scores(device, tables)
    assert scores.dtype == np.float32
    assert_allclose(scores, exact, rtol=0, atol=MAX_SCORE_ERROR / 10)
    assert_allclose(scores, scan.scan_scores(rows, tables), rtol=0, atol=1.1 * MAX_SCORE_ERROR)
    best = scanning.scan_best(device, tables)
    for mine, native, twin in zip(best, scan.scan_best(rows, tables), reference_scan.best(scores), strict=True):
        assert mine.dtype == native.dtype
        assert_array_equal(mine, twin)
    one, (first,) = first_query(tables), scores[:1]
    threshold, floor = float(np.median(first)), scores[-1]
    for lowest in (None, floor):
        matches, theirs = scanning.scan_above(device, one, threshold, lowest)
        assert (matches.dtype, theirs.dtype) == (np.int64, np.float32)
        assert_array_equal(matches, reference_scan.above(first, threshold, 0.0 if lowest is None else lowest))
        assert_array_equal(theirs, first[matches])
    for count in (1, 9, len(first) + 5):
        matches, theirs = scanning.scan_top(device, one, count)
        assert (matches.dtype, theirs.dtype) == (np.int64, np.float32)
        assert_array_equal(matches, reference_scan.top(first, count))
        assert_array_equal(theirs, first[matches])


@pytest.mark.slow
@pytest.mark.parametrize("subvectors", [1, 7, 32, 33, 64, 65, 128, 200])
@pytest.mark.parametrize(("count", "queries"), [(1, 1), (31, 3), (257, 2)])
def test_answers_are_those_of_the_scores_and_scores_those_of_the_twin(engine, subvectors, count, queries):
    check_everything(engine, *drawn(subvectors, count, subvectors, queries, coarse=subvectors % 2 * 5))


def test_more_rows_than_blocks_score_at_once(engine):
    check_everything(engine, *drawn(1, 1100, 128, 1, coarse=3))


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1), st.integers(1, 150), st.integers(1, 700), st.integers(1, 3))
@settings(max_examples=15)
def test_laws(engine, seed, subvectors, count, queries):
    check_everything(engine, *drawn(seed, count, subvectors, queries, coarse=seed % 2 * 3))


def test_each_run_gives_the_same_bits_on_any_number_of_blocks(engine, monkeypatch):
    rows, tables = drawn(2, 3000, 35, coarse=4)
    device = scanning.sent_rows(engine, rows)
    first = scanning.scan_scores(device, tables)
    for blocks in (1, 3):
        monkeypatch.setattr(scanning, "EMULATED_BLOCKS", blocks)
        assert_array_equal(scanning.scan_scores(device, tables), first)


def test_ties_go_to_the_first(engine):
    rows, tables = drawn(8, 2000, 3)
    few = rows._replace(codes=rows.codes % 2, inverse_norms=np.ones(2000, np.float32))
    device = scanning.sent_rows(engine, few)
    scores = scanning.scan_scores(device, tables)[0]
    assert len(set(scores.tolist())) <= 8
    assert_array_equal(scanning.scan_top(device, tables, 700)[0], reference_scan.top(scores, 700))
    index, best, runner_up = scanning.scan_best(device, QueryTables(np.repeat(tables.luts, 3, axis=0)))
    assert not index.any()
    assert_array_equal(best, runner_up)


def test_zeros_of_either_sign_are_equal(engine):
    rows, tables = drawn(5, 400, 8)
    device = scanning.sent_rows(engine, rows._replace(inverse_norms=np.zeros(400, np.float32)))
    assert np.signbit(scanning.scan_scores(device, tables)).any()
    assert_array_equal(scanning.scan_top(device, tables, 400)[0], np.arange(400))


def test_bytes_after_the_last_row_are_never_reported(engine):
    rows, tables = drawn(2, 300, 4)
    rows.codes[1, :, 44:] = np.arange(256, dtype=np.uint8)[44:]
    tables.luts[0, :, 44:] += 10
    device = scanning.sent_rows(engine, rows)
    assert scanning.scan_top(device, tables, 1000)[0].max() == 299
    assert_array_equal(scanning.scan_above(device, tables, -np.inf)[0], np.arange(300))


def test_of_no_rows_there_is_nothing(engine):
    rows, tables = drawn(3, 0, 5)
    device = scanning.sent_rows(engine, rows)
    assert scanning.scan_scores(device, tables).shape == (1, 0)
    for arrays in (scanning.scan_above(device, tables, 0.0), scanning.scan_top(device, tables, 3)):
        assert [len(array) for array in arrays] == [0, 0]
    assert [len(array) for array in scanning.scan_best(device, tables)] == [0, 0, 0]


def test_what_does_not_fit_is_refused(engine):
    rows, tables = drawn(10, 300, 4, 2, coarse=3)
    device, one = scanning.sent_rows(engine, rows), first_query(tables)
    with refused("expected tables"):
        scanning.scan_scores(device, tables._replace(luts=tables.luts[:, :3]))
    with refused("coarse ids belong"):
        scanning.scan_best(device, tables._replace(coarse=None))
    with refused("coarse id 2 of 1"):
        scanning.scan_best(device, tables._replace(coarse=tables.coarse[:, :1]))
    with refused("one query"):
        scanning.scan_top(device, tables, 1)
    with refused("one query"):
        scanning.scan_above(device, tables, 0.0)
    with refused("count of 1 or more"):
        scanning.scan_top(device, one, 0)
    with refused("a floor per row"):
        scanning.scan_above(device, one, 0.0, np.zeros(3, np.float32))


def test_a_full_device_is_refused_with_what_is_needed(engine, monkeypatch):
    monkeypatch.setattr(type(engine), "free_bytes", lambda self: 1_000_000)
    rows, _ = drawn(11, 100_000, 7)
    with refused(r"needs 4 MB.* 100,000 rows, of which 1 MB are free.*device 'cpu'"):
        scanning.sent_rows(engine, rows)


@pytest.fixture
def toy_code() -> PQCode:
    rng = default_rng(12)
    codebook = Codebook(rng.normal(size=(4, 256, 3)).astype(np.float32), None, EncoderIdentity("toy", 12))
    return pq_code(codebook, Codes(rng.integers(0, 256, (700, 4), np.uint8), None))


def unit_vectors(count: int, dim: int) -> np.ndarray:
    vectors = default_rng(13).normal(size=(count, dim)).astype(np.float32)
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def test_a_code_on_a_gpu_answers_as_on_the_cpu(engine, toy_code):
    on_gpu, queries = device_code.on_engine(toy_code, engine), unit_vectors(20, 12)
    assert_allclose(on_gpu.scores(queries), toy_code.scores(queries), rtol=0, atol=1.1 * MAX_SCORE_ERROR)
    exact = toy_code.decode(np.arange(700)).astype(np.float64) @ queries.T.astype(np.float64)
    assert_allclose(on_gpu.best(queries).scores, exact.max(axis=1), rtol=0, atol=1e-5)
    assert_array_equal(on_gpu.top(queries[0], 9).rows, reference_scan.top(on_gpu.scores(queries[:1])[0], 9))
    floor = on_gpu.scores(queries[1:2])[0]
    hits = on_gpu.select(queries[0], 0.1, floor)
    assert_array_equal(hits.rows, reference_scan.above(on_gpu.scores(queries[:1])[0], 0.1, floor))
    assert len(hits.rows)


def test_rows_are_sent_once_and_at_the_first_search(engine, toy_code, monkeypatch):
    sent = []
    send = scanning.sent_rows
    monkeypatch.setattr(scanning, "sent_rows", lambda engine, rows: sent.append(rows) or send(engine, rows))
    on_gpu = device_code.on_engine(toy_code, engine)
    assert not sent
    on_gpu.top(unit_vectors(1, 12)[0], 3)
    on_gpu.best(unit_vectors(3, 12))
    assert len(sent) == 1


def test_a_field_is_searched_where_it_is_opened_to_be(engine, toy_code, tmp_path, monkeypatch):
    ids = np.arange(700, dtype=np.uint32)
    LanguageField(ids, toy_code, toy_code.codebook.encoder, "toy", 700).save(tmp_path / "toy.field")
    monkeypatch.setattr(devices, "unavailable", lambda: None)
    monkeypatch.setattr(device_code, "cuda_engine", lambda: engine)
    query = unit_vectors(1, 12)[0]
    on_cpu = load_field(tmp_path / "toy.field")
    assert type(on_cpu.code) is PQCode
    for device in ("cuda", "auto"):
        on_gpu = open_scene(tmp_path / "toy.field", search_device=device).field
        assert isinstance(on_gpu.code, device_code.DevicePQCode)
        assert_allclose(on_gpu.scores(query), on_cpu.scores(query), rtol=0, atol=1.1 * MAX_SCORE_ERROR)
        assert on_gpu.equals(on_cpu)
    on_gpu.save(tmp_path / "again.field")
    assert type(load_field(tmp_path / "again.field").code) is PQCode


def test_without_a_gpu_cuda_is_refused_with_its_reason_and_auto_is_the_cpu(toy_code, tmp_path, monkeypatch):
    monkeypatch.setattr(devices, "unavailable", lambda: "device 'cuda' needs CuPy")
    with pytest.raises(MissingExtraError, match="needs CuPy"):
        device_code.searched_on(toy_code, "cuda")
    with refused("expected one of"):
        device_code.searched_on(toy_code, "mps")
    assert device_code.searched_on(toy_code, "auto") is toy_code
    with pytest.raises(MissingExtraError, match="needs CuPy"):
        SceneFolder(tmp_path, Sources(search_device="cuda")).check_sources()


def test_codes_of_another_kind_stay_on_the_cpu(engine, monkeypatch):
    monkeypatch.setattr(devices, "unavailable", lambda: None)
    monkeypatch.setattr(device_code, "cuda_engine", lambda: engine)
    code = mixture_code()
    with refused("kept as 'pq', got 'mixture'"):
        device_code.searched_on(code, "cuda")
    assert device_code.searched_on(code, "auto") is code
