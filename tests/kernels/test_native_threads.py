"""Every function of the extension from several Python threads at once: the bits of one thread alone.

Run under the thread sanitizer by scripts/sanitize.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_array_equal

from drsplat import _native

PYTHON_THREADS, ROUNDS, INSIDE = 6, 4, 3
WIDTH, HEIGHT = 60, 44
SEEN = np.zeros(17, np.float32)
SEEN[[0, 4, 8]], SEEN[12:14], SEEN[14:] = 1, 50, (30, 22, 0.2)


def floats(*shape: int) -> np.ndarray:
    return default_rng(shape).standard_normal(shape).astype(np.float32)


def splats() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    means = floats(3, 900)
    means[2] += 4
    covariances = np.repeat(np.array([0.02, 0, 0, 0.03, 0, 0.01], "f")[:, None], 900, axis=1)
    return means, covariances, np.full(900, 0.6, np.float32)


def trained() -> list[np.ndarray]:
    """Image and gradients of one step, and what Adam makes of one of them."""
    arrays = [floats(500, 3), floats(500, 3) - 3, floats(500, 4), floats(500), floats(500, 4, 3)]
    arrays[0][:, 2] += 4
    how = True, SEEN, WIDTH, HEIGHT, 4, np.zeros(3, "f"), INSIDE, ""
    view = _native.training_pass(*arrays, *how)
    image, alpha = view.forward()
    _, _, slope = _native.photometric_loss(image, np.zeros_like(image), 0.2, INSIDE, "")
    gradients = [np.array(column) for column in view.backward(image, slope)]
    moments = np.zeros(1500, "f"), np.zeros(1500, "f")
    stepped, sh, sh_moments = (
        arrays[0].reshape(-1).copy(),
        arrays[4].copy(),
        (np.zeros((500, 4, 3), "f"), floats(500, 4, 3) ** 2),
    )
    view = _native.training_pass(*arrays[:4], sh, *how)
    view.forward()
    view.backward_and_step(image, slope, sh, *sh_moments, 1e-3, 1, 0.9, 0.999, 1e-15, 1e-2)
    rates = 1e-3, 1, 0.9, 0.999, 1e-15, 0.0, 0
    _native.adam_step(stepped, gradients[0].reshape(-1), *moments, *rates, INSIDE, "")
    return [image, alpha, *gradients, stepped, *moments, sh, *sh_moments]


def photographed() -> list[np.ndarray]:
    """All that becomes of a photo."""
    image = default_rng(0).integers(0, 256, (40, 50, 3), np.uint8)
    lab = _native.lab_colors(image, INSIDE, "")
    labels = _native.small_regions(lab, 4.0, 9).reshape(40, 50)
    sizes = [(108, 8), (72, 8), (72, 8), (72, 8), (72, 8), (144, 8), (72, 8), (8, 36)]
    layers = tuple(floats(*part) for size in sizes for part in (size, size[1:]))
    sight = _native.look(image, layers, INSIDE, "")
    sums, boxes, pairs, borders = _native.photo_graph(labels, lab, *sight)
    graph = sums.reshape(-1, 55), boxes.reshape(-1, 4), pairs.reshape(-1, 2), borders.reshape(-1, 5)
    rule = tuple(floats(*shape).astype(float) for shape in ((42,), (42,), (42, 9), (9,), (9,), (1,)))
    order, flood = _native.merge_order(graph, 2000.0, rule, ""), _native.flooded(sight[0], labels)
    return [lab, labels, *sight, *graph, order, flood, _native.merged_regions(graph, 2000.0, rule, 0.5, 60.0, 2.5, "")]


def kept(found: np.ndarray, threads: int, isa: str) -> tuple[np.ndarray, np.ndarray]:
    """The best three of eight scores of each row, and which."""
    best = np.full((3, found.shape[1]), -np.inf, np.float32), np.zeros((3, found.shape[1]), np.uint16)
    _native.keep_best(*best, found, 0, threads, isa)
    return best


def placed(weights: np.ndarray) -> tuple[np.ndarray, ...]:
    """Where a view's entries go in rows of five."""
    rows, following = np.arange(len(weights), dtype=np.uint32), 5 * np.arange(len(weights))
    columns, all_weights = np.zeros(5 * len(weights), np.int32), np.zeros(5 * len(weights), np.float32)
    _native.place_entries(rows, rows.astype(np.int32), weights, 3, following, columns, all_weights)
    return following, columns, all_weights


def calls() -> list[Callable[[], object]]:
    given, rng, how = (*splats(), True), default_rng(0), (INSIDE, "")
    segments = rng.integers(-1, 9, (HEIGHT, WIDTH)).astype(np.int32)
    rows = rng.integers(0, 256, (4, 16, 256)).astype("u1"), np.ones(900, "f"), None
    tables, error = (floats(3, 16, 256), None), (1e-4, 0, *how)
    one = floats(1, 16, 256), None
    ids = rng.integers(0, 300, (15, 4, 64)).astype("u2")
    atoms = rng.integers(-127, 128, (300, 32)).astype("i1"), np.full(300, 0.002, "f")
    weights = rng.integers(0, 256, (15, 4, 64)).astype("u1")
    code = ids, weights, np.full(900, 0.004, np.float16).view("u2"), *atoms
    found = floats(8, 9000)
    starts, columns = np.arange(0, 4001, 5), rng.integers(0, 300, 4000).astype("i4")
    further = rng.integers(0, 300, (800, 4)).astype("i4")
    return [
        lambda: _native.view_weights(*given, SEEN, segments, 40, 0, *how)[:3],
        lambda: _native.topk_contributions(*given, SEEN, WIDTH, HEIGHT, 8, 0, *how),
        lambda: _native.render(*given, SEEN, WIDTH, HEIGHT, floats(900, 5), floats(5), *how),
        lambda: [_native.sh_colors(floats(900, 4, 3), floats(900, 3), floats(3), *how)],
        lambda: [_native.scan_scores(rows, tables, error)],
        lambda: _native.scan_best(rows, tables, error),
        lambda: _native.scan_top(rows, one, error, 50),
        lambda: _native.scan_above(rows, one, error, 0.1, None),
        lambda: [_native.lookup_tables(floats(16, 64, 256), floats(9, 1024), *how)],
        lambda: [_native.mixture_scores(code, floats(9, 32), *how)],
        lambda: _native.mixture_best(code, floats(9, 32), *how),
        lambda: _native.mixture_top(code, floats(32), 30, *how),
        lambda: _native.mixture_select(code, floats(32), 0.1, None, *how),
        lambda: _native.mixture_encode(*atoms, floats(800, 32), starts, columns, further, 4, *how),
        lambda: [_native.nearest_centres(floats(800, 32), floats(50, 32), *how)],
        lambda: [_native.weighted_rows(starts, columns, floats(4000), floats(300, 32), *how)],
        lambda: [_native.dense_rows(floats(800, 33), floats(33, 48), *how)],
        lambda: kept(found, *how),
        lambda: placed(floats(800)),
        lambda: [_native.convolve(floats(9, 8, 8, 3), floats(27, 16), floats(16), 1, *how)],
        lambda: _native.code_sums(floats(800, 64), rows[0].reshape(-1)[:12800].reshape(800, 16), INSIDE),
        lambda: [_native.heaviest_labels(further.reshape(40, 10, 8), floats(40, 10, 8), columns[:300], INSIDE)],
        lambda: [_native.pq_encode(floats(800, 32), floats(8, 256, 4), *how)],
        photographed,
        trained,
    ]


def test_python_threads_at_once_change_no_bit():
    every = calls()
    expected = [[np.array(part) for part in call()] for call in every]

    def work(seed):
        order = default_rng(seed)
        for place in np.concatenate([order.permutation(len(every)) for _ in range(ROUNDS)]):
            for part, wanted in zip(every[place](), expected[place], strict=True):
                assert_array_equal(np.asarray(part), wanted)

    with ThreadPoolExecutor(PYTHON_THREADS) as pool:
        list(pool.map(work, range(PYTHON_THREADS)))


def test_one_pass_that_threads_share_is_gone_through_once():
    arrays = [floats(500, 3), floats(500, 3) - 3, floats(500, 4), floats(500), floats(500, 4, 3)]
    arrays[0][:, 2] += 4
    view = _native.training_pass(*arrays, False, SEEN, WIDTH, HEIGHT, 4, np.zeros(3, "f"), INSIDE, "")
    image = np.ones((HEIGHT, WIDTH, 3), np.float32)

    def step(place):
        try:
            (view.forward if place % 2 else lambda: view.backward(image, image))()
        except ValueError:
            return False
        return True

    with ThreadPoolExecutor(PYTHON_THREADS) as pool:
        done = list(pool.map(step, range(24)))
    assert sum(done[::2]) <= 1
    assert any(done[1::2])
