"""Calls of the extension as nobody should make them: arrays of wrong shapes and types, numbers that are none,
counts beyond all bounds, one past every vector's width.

The extension checks what memory safety needs, and nothing else: a call either answers or raises one of REFUSALS.
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from drsplat import _native
from mutations import seeded

Call = Callable[[], object]
REFUSALS = (ValueError, TypeError, MemoryError)
FEW = (0, 1, 17, 300)
COUNTS = (0, 1, 15, 16, 17, 63, 65, 257, 700)
SIDES = (1, 7, 16, 17, 33, 100)
NUMBERS = (np.nan, np.inf, -np.inf, -0.0, 3.4e38, -3.4e38, 1e-45, 1e30, -1e10, 65504.0, 2.0**31)
LIMITS = (0, 1, 2, 40, 2**31 - 2, 2**31 - 1, 2**31, -1, -(2**31))
THREADS = (0, 1, 2, 3, 7, 300, -1, -(2**31))


class Rogue:
    """A source of arguments, the same for the same seed; every fourth array is spoiled."""

    def __init__(self, seed: int) -> None:
        self.rng = seeded(seed)

    def one(self, choices: tuple) -> object:
        return choices[self.rng.integers(len(choices))]

    def count(self, *choices: int) -> int:
        return int(self.one(choices))

    def counts(self, *choices: tuple[int, ...]) -> list[int]:
        return [self.count(*of) for of in choices]

    def starts(self, low: int, high: int, rows: int) -> np.ndarray:
        """Where each of some rows of a sparse matrix begins, and the last one ends."""
        return np.append(0, np.cumsum(self.rng.integers(low, high, rows)))

    def edges(self, nodes: int, *counts: int) -> np.ndarray:
        """Pairs of nodes, the lower one first."""
        ends = np.sort(self.rng.integers(0, max(nodes, 1), (self.count(*counts), 2)), axis=1).astype("i4")
        return ends[ends[:, 0] < ends[:, 1]]

    def call(self, function: Callable[..., object], *given: object) -> Call:
        return partial(function, *given, *self.how())

    def isa(self) -> str:
        names = (*_native.available_isas(), "")
        return str(self.one(names) if self.rng.random() < 0.98 else "no such")

    def how(self) -> tuple[object, str]:
        return self.one(THREADS), self.isa()

    def floats(self, *shape: int) -> np.ndarray:
        return self.spoiled(self.rng.standard_normal(shape).astype(np.float32))

    def whole(self, low: int, high: int, shape: tuple[int, ...], dtype: str) -> np.ndarray:
        return self.spoiled(self.rng.integers(low, max(high, low + 1), shape).astype(dtype))

    def spoiled(self, array: np.ndarray) -> np.ndarray:
        if self.rng.random() < 0.75:
            return array
        spoil = self.one((self._numbers, self._numbers, self._numbers, self._shape, self._kind))
        return spoil(array.copy())

    def _numbers(self, array: np.ndarray) -> np.ndarray:
        if array.size and array.dtype.kind == "f":
            places = self.rng.integers(0, array.size, 1 + self.rng.integers(min(array.size, 9)))
            array.reshape(-1)[places] = self.one(NUMBERS)
        elif array.size:
            limits = np.iinfo(array.dtype)
            place = self.rng.integers(array.size)
            array.reshape(-1)[place] = self.one((limits.min, limits.max, limits.max // 2))
        return array

    def _shape(self, array: np.ndarray) -> np.ndarray:
        endless = 2**58 if array.ndim > 1 else 0  # which takes no memory where the other sides are 0
        empty = np.empty((endless,) + (0,) * (array.ndim - 1), array.dtype)
        transposed = np.asfortranarray(array)
        return self.one((array[1:], array[..., :-1], array[None], array[..., :0], empty, transposed))

    def _kind(self, array: np.ndarray) -> object:
        return self.one((array.astype(np.float64), array.astype(np.int64), array.tobytes(), None))


def camera(rogue: Rogue, width: int, height: int) -> np.ndarray:
    numbers = np.zeros(17, np.float32)
    numbers[[0, 4, 8]] = 1
    numbers[9:12] = rogue.rng.standard_normal(3)
    numbers[12:14] = rogue.one((width, 50.0, 1e-3, 1e30, -5.0))
    numbers[14:16] = rogue.one(((width / 2, height / 2), (1e30, -1e9), (-5e4, 5e4)))
    numbers[16] = rogue.one((0.2, 0.2, 1e-4, 1e-30, 1e-45, 1e30))
    return rogue.spoiled(numbers)


def scene(rogue: Rogue) -> tuple[np.ndarray, np.ndarray, np.ndarray, bool]:
    n = rogue.count(*COUNTS)
    means = rogue.rng.standard_normal((3, n)).astype(np.float32) * rogue.one((1.0, 1e6))
    means[2] += rogue.one((0, 3, 100))
    axes = rogue.rng.standard_normal((n, 3, 3)) * rogue.one((1e-2, 0.1, 10.0, 1e6, 1e10))
    axes[:, :, 0] *= rogue.one((1.0, 1e4))  # needles, whose determinants are rounding
    full = np.einsum("nij,nkj->ikn", axes, axes)
    covariances = full[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]].astype(np.float32)
    opacities = rogue.rng.uniform(-0.2, 1.3, n).astype(np.float32)
    return rogue.spoiled(means), rogue.spoiled(covariances), rogue.spoiled(opacities), n % 2 == 1


def weights(rogue: Rogue) -> Call:
    width, height = rogue.counts(SIDES, SIDES)
    masks = rogue.whole(-2, rogue.count(1, 5, 300), (height, width), "i4")
    seen = *scene(rogue), camera(rogue, width, height), masks
    return rogue.call(_native.view_weights, *seen, rogue.one(LIMITS), rogue.one(LIMITS))


def contributions(rogue: Rogue) -> Call:
    width, height = rogue.counts((*SIDES, 0, -1, 65536, 65537), (1, 16, 16, 17, 33, 0, -5))
    topk = rogue.one((1, 2, 3, 3, 16, 16, 40, 0, -1, 2**31))
    seen = *scene(rogue), camera(rogue, width, height), width, height
    return rogue.call(_native.topk_contributions, *seen, topk, rogue.one(LIMITS))


def rendering(rogue: Rogue) -> Call:
    width, height = rogue.counts(SIDES, SIDES)
    splats, channels = scene(rogue), rogue.count(0, 1, 3, 4, 16, 17, 33)
    count = len(splats[2]) if isinstance(splats[2], np.ndarray) and splats[2].ndim else 1
    values = rogue.floats(count, channels), rogue.floats(channels)
    seen = *splats, camera(rogue, width, height), width, height
    return rogue.call(_native.render, *seen, *values)


def colors(rogue: Rogue) -> Call:
    n, k = rogue.counts(COUNTS, (0, 1, 4, 9, 16, 25))
    arrays = rogue.floats(n, k, 3), rogue.floats(n, 3), rogue.floats(3)
    return rogue.call(_native.sh_colors, *arrays)


def scan(rogue: Rogue) -> Call:
    n, length = rogue.counts((0, 1, 255, 256, 257, 1000), (1, 2, 7, 16, 128))
    queries, coarse = rogue.counts((0, 1, 1, 5, 17), (0, 1, 3, 1024))
    codes = rogue.whole(0, 256, (-(-n // 256), length, 256), "u1")
    ids = rogue.whole(0, 65536, (n,), "u2") if coarse else None
    rows = codes, rogue.floats(n), ids
    tables = rogue.floats(queries, length, 256), rogue.floats(queries, coarse) if coarse else None
    error, wide = (rogue.one((1e-4, 1e-30, np.inf, np.nan, 0.0)), rogue.one((0, 1, length, 2**32 - 1)))
    floor = rogue.one((None, rogue.floats(n)))
    return partial(
        rogue.one((_native.scan_scores, _native.scan_best, _scan_top, partial(_scan_above, floor))),
        rows, tables, (error, wide, *rogue.how()),
    )  # fmt: skip


def _scan_top(*given: tuple) -> object:
    return _native.scan_top(*given, 2**32 - 1), _native.scan_top(*given, 3)


def _scan_above(floor: np.ndarray | None, *given: tuple) -> object:
    return [_native.scan_above(*given, bar, floor) for bar in (0.1, np.nan, -np.inf)]


def look_up_tables(rogue: Rogue) -> Call:
    length, dim = rogue.counts((0, 1, 4, 128), (0, 1, 3, 64))
    arrays = rogue.floats(length, dim, 256), rogue.floats(rogue.count(0, 1, 5), length * dim)
    return rogue.call(_native.lookup_tables, *arrays)


def mixture(rogue: Rogue) -> Call:
    n, k = rogue.counts((0, 1, 63, 64, 65, 1000), (0, 1, 2, 4, 16, 17))
    atoms, dim = rogue.counts((0, 1, 5, 300, 5000), (1, 3, 16, 33, 512))
    blocks = -(-n // 64), k, 64
    rows = rogue.whole(0, 65536, blocks, "u2"), rogue.whole(0, 256, blocks, "u1")
    parts = *rows, rogue.whole(0, 65536, (n,), "u2"), *dictionary(rogue, atoms, dim)
    one, many = rogue.floats(dim), rogue.floats(rogue.count(0, 1, 5, 130, 300), dim)
    call = rogue.one(
        (
            partial(_native.mixture_scores, parts, many),
            partial(_native.mixture_best, parts, many),
            partial(_native.mixture_top, parts, one, rogue.one((0, 1, 5, 2**63))),
            partial(_native.mixture_select, parts, one, 0.1, rogue.one((None, rogue.floats(n)))),
        )
    )
    return rogue.call(call)


def dictionary(rogue: Rogue, atoms: int, dim: int) -> tuple[np.ndarray, np.ndarray]:
    return rogue.whole(-128, 128, (atoms, dim), "i1"), rogue.spoiled(rogue.rng.uniform(0, 0.01, atoms).astype("f"))


def encoding(rogue: Rogue) -> Call:
    n, atoms = rogue.counts((0, 1, 17, 200), (0, 1, 5, 300))
    dim, further = rogue.counts((1, 3, 6, 16, 512), (0, 1, 5, 64, 65))
    starts = rogue.starts(0, rogue.one((1, 5, 80)), n)
    arrays = (
        *dictionary(rogue, atoms, dim),
        rogue.floats(n, dim),
        rogue.spoiled(starts),
        rogue.whole(0, atoms, (starts[-1],), "i4"),
        rogue.whole(0, atoms, (n, further), "i4"),
    )
    return rogue.call(_native.mixture_encode, *arrays, rogue.one((0, 1, 4, 6, 16, 17)))


def neighbours(rogue: Rogue) -> Call:
    n, dim = rogue.counts((0, 1, 17, 500), (1, 3, 16, 512))
    points = rogue.floats(n, dim)
    if rogue.rng.random() < 0.5:
        centres = rogue.floats(rogue.count(0, 1, 7, 100), dim)
        return rogue.call(_native.nearest_centres, points, centres)
    groups, size = rogue.counts((0, 1, 4), (0, 1, 5, 64, 70))
    members = rogue.whole(0, groups, (n,), "i4"), rogue.whole(0, 50, (groups, size), "i4")
    given = *dictionary(rogue, 50, dim), points, *members, rogue.one((0, 1, 5, 64, 65))
    return rogue.call(_native.nearest_members, *given)


def rows(rogue: Rogue) -> Call:
    n, m, dim = rogue.counts(FEW, (0, 1, 50), (0, 1, 33, 512))
    starts = rogue.starts(0, 9, n)
    entries = rogue.whole(0, m, (starts[-1],), "i4"), rogue.floats(starts[-1])
    given = rogue.spoiled(starts), *entries, rogue.floats(m, dim)
    return rogue.call(_native.weighted_rows, *given)


def dense(rogue: Rogue) -> Call:
    n, k, m = rogue.counts(FEW, (0, 1, 33), (0, 16, 32, 33))
    return rogue.call(_native.dense_rows, rogue.floats(n, k), rogue.floats(k, m))


def keeping(rogue: Rogue) -> Call:
    n, kept, more = rogue.counts(FEW, (1, 9, 256, 257, 0), (0, 1, 8))
    given = rogue.floats(kept, n), rogue.whole(0, 9, (kept, n), "u2"), rogue.floats(more, n)
    return rogue.call(_native.keep_best, *given, rogue.one((0, 8, 65535, 65536, 2**63, -1)))


def convolution(rogue: Rogue) -> Call:
    n, side, c, o = rogue.counts((0, 1, 5), (0, 1, 9), (0, 1, 3), (0, 16, 32, 48, 33))
    images = rogue.floats(n, side, rogue.count(0, 1, 9), c)
    stride = rogue.count(1, 1, 2, 3, 2**31 - 1, 0, -1)
    return rogue.call(_native.convolve, images, rogue.floats(9 * c, o), rogue.floats(o), stride)


def sums_of_codes(rogue: Rogue) -> Call:
    n, parts, dim = rogue.counts(FEW, (0, 1, 17), (0, 1, 4))
    codes = rogue.whole(0, 256, (n, parts), "u1")
    return partial(_native.code_sums, rogue.floats(n, parts * dim), codes, rogue.how()[0])


def labels(rogue: Rogue) -> Call:
    h, w, n = rogue.counts((0, 1, 17, 70), (0, 1, 17, 70), (1, 17, 70))
    ids = rogue.whole(-1, n, (h, w, 8), "i4")
    return partial(_native.heaviest_labels, ids, rogue.floats(h, w, 8), rogue.whole(-1, 9, (n,), "i4"), rogue.how()[0])


def columns(rogue: Rogue) -> Call:
    n, m = rogue.counts(FEW, FEW)
    matrices = []
    for _ in range(2):
        starts = rogue.starts(0, 9, n)
        entries = rogue.whole(0, m, (starts[-1],), "i4"), rogue.floats(starts[-1])
        matrices.append((rogue.spoiled(starts), *entries))
    numbers = rogue.whole(-2, 2 * m, (m,), "i4")
    return partial(_native.changed_columns, *matrices[0], numbers, *matrices[1], rogue.how()[0])


def entries_of_views(rogue: Rogue) -> Call:
    n, rows, room = rogue.counts(FEW, FEW, FEW)
    of_rows, following = rogue.whole(0, rows, (n,), "u4"), rogue.whole(-1, room, (rows,), "i8")
    given = of_rows, rogue.whole(0, 9, (n,), "i4"), rogue.floats(n), rogue.one((0, 1, 2**31 - 1, -(2**31)))
    return partial(_native.place_entries, *given, following, np.zeros(room, "i4"), np.zeros(room, "f4"))


def boxes(rogue: Rogue) -> Call:
    n, sets = rogue.counts(FEW, (0, 1, 5))
    starts = rogue.starts(rogue.one((0, 1)), 9, sets)
    solids = rogue.floats(n, 3), rogue.floats(n, 4), rogue.floats(n, 3), rogue.floats(n)
    members = rogue.spoiled(starts), rogue.whole(0, n, (starts[-1],), "i8")
    up = rogue.one((None, np.array([0, 0.6, 0.8]), np.zeros(3), np.zeros(2), np.full(3, np.nan)))
    rule = [rogue.one((0.003, 0.0, np.nan, 2.0)) for _ in range(3)]
    return partial(_native.boxes, *solids, *members, up, *rule, rogue.how()[0])


def merges(rogue: Rogue) -> Call:
    n, m, dim = rogue.counts(FEW, (0, 1, 50), (0, 1, 6))
    starts = rogue.starts(0, 4 if m else 1, n)
    columns = np.concatenate([np.arange(k) for k in np.diff(starts)], dtype="i4") if n else np.zeros(0, "i4")
    votes = rogue.spoiled(starts), rogue.spoiled(columns), rogue.floats(starts[-1])
    edges = rogue.edges(n, 0, 1, 500)
    given = (
        rogue.spoiled(rogue.rng.permutation(n)),
        *votes,
        np.arange(m, dtype="i4") // 7,
        rogue.floats(m, dim),
        rogue.spoiled(edges),
        np.array([0.9, 0.5, 0.1]),
    )
    rule = rogue.spoiled(np.array([0.5, 2, 0.15, 0.5, 0.3, 0.15, 0.7, 0.02, 2, 3, 0.5]))
    return partial(_native.agglomerate, *given, rule, rogue.how()[0])


def photos(rogue: Rogue) -> Call:
    height, width = rogue.counts((0, 1, 2, 33), (1, 5, 40))
    if rogue.rng.random() < 0.5:
        image = rogue.whole(0, 256, (height, width, rogue.count(3, 3, 3, 2)), "u1")
        widths = [12, *(rogue.count(1, 5, 16) for _ in range(7))]
        inputs = [9 * n for n in widths[:5]] + [9 * (widths[3] + widths[5]), 9 * widths[6], widths[7]]
        shapes = zip(inputs, [*widths[1:], rogue.count(36, 36, 36, 37)], strict=True)
        layers = tuple(rogue.floats(*part) for shape in shapes for part in (shape, shape[1:]))
        how = rogue.how()
        return rogue.one((partial(_native.look, image, layers, *how), partial(_native.lab_colors, image, *how)))
    lab, borders = rogue.whole(-2000, 2000, (height, width, 3), "i4"), rogue.whole(0, 256, (height, width), "i4")
    labels = rogue.whole(0, rogue.count(1, 3, 300), (height, width), "i4")
    seen = labels, lab, borders, rogue.whole(-4000, 4000, (height, width, 8), "i4")
    scale, least = rogue.one((0.0, 15.0, 1e30, np.nan, -1.0)), rogue.one(LIMITS)
    small, graph = partial(_native.small_regions, lab, scale, least), partial(_native.photo_graph, *seen)
    return rogue.one((small, graph, partial(_native.flooded, borders, labels)))


def things(rogue: Rogue) -> Call:
    n, units = rogue.counts((0, 1, 2, 20, 60), (0, 1, 8, 9, 56))
    pairs = np.unique(rogue.edges(n, 0, 1, 50, 200), axis=0)
    sums = rogue.rng.integers(0, rogue.one((1, 2, 300)), (n, 55)).astype(float)
    borders = rogue.rng.integers(0, rogue.one((2, 90)), (len(pairs), 5)).astype(float)
    boxes = rogue.rng.integers(-9, 9, (n, 4)).astype(float)
    graph = tuple(map(rogue.spoiled, (sums, boxes, pairs, borders)))
    shapes = (42,), (42,), (42, units), (units,), (units,), (1,)
    rule = tuple(rogue.spoiled(rogue.rng.standard_normal(shape)) for shape in shapes)
    limits = rogue.one((0.0, 0.5, -1.0, np.nan)), rogue.one((0.0, 60.0, np.inf)), rogue.one((0.0, 2.5, np.nan))
    pixels = rogue.one((1.0, 900.0, 0.0, -1.0))
    call = rogue.one((_native.merged_regions, _native.pair_likelihoods, _native.merge_order))
    return partial(call, graph, pixels, rule, *(limits if call is _native.merged_regions else ()), rogue.isa())


def codes(rogue: Rogue) -> Call:
    n, length, dim = rogue.counts(FEW, (0, 1, 4, 128), (0, 1, 3, 64))
    given = rogue.floats(n, length * dim), rogue.floats(length, 256, dim)
    return rogue.call(_native.pq_encode, *given)


def training(rogue: Rogue) -> Call:
    n, k = rogue.counts((0, 1, 15, 16, 17, 300), (1, 4, 9, 16))
    width, height = rogue.counts(SIDES, SIDES)
    means = rogue.rng.standard_normal((n, 3)).astype(np.float32) + np.float32([0, 0, 3])
    scales = rogue.rng.uniform(-5, 1, (n, 3)).astype(np.float32)
    scene = rogue.spoiled(means), rogue.spoiled(scales), rogue.floats(n, 4), rogue.floats(n)
    given = *scene, rogue.floats(n, k, 3), n % 2 == 1, camera(rogue, width, height), width, height
    gradient = rogue.floats(height, width, 3)
    order = rogue.one(("fb", "b", "ffb", "fbb", "fbf", "bfb", "f", "fs", "s", "fsb"))
    moments = rogue.floats(n, k, 3), rogue.floats(n, rogue.one((k, 1)), 3)

    def call() -> None:
        view = _native.training_pass(*given, rogue.one((0, 1, k, k + 1)), np.ones(3, "f"), *rogue.how())
        image = gradients = None
        for step in order:
            try:
                if step == "f":
                    image, _ = view.forward()
                elif step == "s":
                    slope = gradient if image is None else image, gradient
                    gradients = view.backward_and_step(*slope, given[4], *moments, 1e-3, 1, 0.9, 0.999, 1e-15, 1e-2)
                else:
                    gradients = view.backward(gradient if image is None else image, gradient)
            except REFUSALS:
                pass
        del view, image
        for column in gradients or ():
            column.sum()

    return call


def loss(rogue: Rogue) -> Call:
    width, height = rogue.counts((0, 1, 5, 16, 17, 100), (0, 1, 5, 11, 33))
    images = rogue.floats(height, width, 3), rogue.floats(height, width, 3)
    return rogue.call(_native.photometric_loss, *images, rogue.one((0.2, 1.0, np.nan)))


def optimizer(rogue: Rogue) -> Call:
    n = rogue.count(0, 1, 15, 48, 480, 1000)
    arrays = [rogue.floats(n) for _ in range(4)]
    step, row = rogue.one((1, 100, 0, -1, 2**62)), rogue.one((0, 3, 12, 48, 1, 2**28, 2**32 - 1))
    rates = 1e-3, step, 0.9, 0.999, 1e-15, 1e-3, row
    return rogue.call(_native.adam_step, *arrays, *rates)


TWICE = weights, contributions, scan, mixture, encoding, photos, things, training
FAMILIES = (
    *TWICE, *TWICE, rendering, colors, look_up_tables, neighbours, rows, dense, keeping, convolution, sums_of_codes,
    labels, boxes, columns, entries_of_views, merges, codes, loss, optimizer,
)  # fmt: skip


def refused_or_answered(seed: int) -> tuple[str, bool]:
    """Make one call; of which family it is, and whether it was refused. Any other end is a defect."""
    rogue = Rogue(seed)
    family = FAMILIES[rogue.rng.integers(len(FAMILIES))]
    with np.errstate(all="ignore"):
        call = family(rogue)
        try:
            call()
        except REFUSALS:
            return family.__name__, True
    return family.__name__, False
