"""A thing is on another where its foot touches Gaussians that lie around or under its middle."""

from itertools import pairwise

import numpy as np
import pytest

from drsplat import Gaussians
from drsplat.kernels.boxes import box_of
from drsplat.query import Match
from drsplat.query.relations import contacts, lies_next_to, rests_on, widest_gap

UP = np.array([0.0, 0, 1])
THICK = 0.005


def block(low: tuple[float, float, float], high: tuple[float, float, float], count: int = 1500) -> np.ndarray:
    """The surface of a cuboid but for its underside, which no photo sees."""
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 1, (count, 3))
    side = rng.integers(0, 5, count)
    points[np.arange(count), [0, 0, 1, 1, 2] @ np.eye(5, dtype=int)[side].T] = np.array([0, 1, 0, 1, 1])[side]
    return low + points * (np.array(high) - low)


def scene_of(*things: np.ndarray, turn: np.ndarray | None = None) -> tuple[Gaussians, list[np.ndarray]]:
    """Round Gaussians, and the rows of each thing."""
    points = np.concatenate(things) @ (np.eye(3) if turn is None else turn).T
    n, ends = len(points), np.cumsum([0, *map(len, things)])
    gaussians = Gaussians(
        points.astype(np.float32),
        np.tile(np.float32([1, 0, 0, 0]), (n, 1)),
        np.full((n, 3), THICK, np.float32),
        np.full(n, 0.9, np.float32),
        np.zeros((n, 1, 3), np.float32),
    )
    return gaussians, [np.arange(*pair) for pair in pairwise(ends)]


def is_on(thing: np.ndarray, other: np.ndarray) -> bool:
    gaussians, (own, support) = scene_of(thing, other)
    return rests_on(gaussians, own, support, UP)


TABLE = block((-0.8, -0.5, 0.7), (0.8, 0.5, 0.75), 20_000)
TABLE = TABLE[np.linalg.norm(TABLE[:, :2], axis=1) > 0.05]  # nor does a photo see the table under a vase
SOFA = np.concatenate(
    [block((-0.8, -0.4, 0.0), (0.8, 0.4, 0.44), 20_000), block((-0.8, 0.4, 0), (0.8, 0.5, 0.9), 6_000)]
)


@pytest.mark.parametrize("above", [-0.01, 0.0, 0.01])
def test_a_vase_is_on_a_table_that_it_overlaps_or_hovers_over(above):
    vase = block((-0.05, -0.05, 0.75 + above), (0.05, 0.05, 1.05))
    assert is_on(vase, TABLE)
    assert not is_on(TABLE, vase)


def test_nothing_is_on_itself():
    gaussians, (table,) = scene_of(TABLE)
    assert not rests_on(gaussians, table, table, UP)


@pytest.mark.parametrize("above", [0.06, 0.3])
def test_what_hangs_higher_than_a_splat_is_thick_is_not_on_it(above):
    assert not is_on(block((-0.05, -0.05, 0.75 + above), (0.05, 0.05, 1.05 + above)), TABLE)


@pytest.mark.parametrize("above", [0.0, 0.012])
def test_a_plate_is_on_the_table_and_not_the_table_on_it(above):
    """It hovers by more than half of its height, which was the limit of boxes."""
    plate = block((0.2, -0.1, 0.75 + above), (0.4, 0.1, 0.77 + above))
    assert is_on(plate, TABLE)
    assert not is_on(TABLE, plate)


@pytest.mark.parametrize("seed", range(12))
def test_a_flat_book_of_few_gaussians_is_on_the_seat(seed):
    """A tenth of its height holds one or two, on the side that photos see; its foot is as thick as they are apart."""
    rng = np.random.default_rng(seed)
    top = rng.uniform((-0.12, -0.07, 0.474), (0.12, 0.07, 0.475), (50, 3))
    book = np.concatenate([top, rng.uniform((-0.12, -0.07, 0.44), (0.12, -0.068, 0.475), (20, 3))])
    assert is_on(book, SOFA)
    assert not is_on(book + np.array([0, 0, 0.12]), SOFA)


def test_what_stands_beside_a_thing_is_not_on_it():
    """Mug and book touch, on one table."""
    mug, book = block((0.0, 0.0, 0.75), (0.08, 0.08, 0.85)), block((0.081, -0.05, 0.75), (0.11, 0.15, 0.98))
    assert not is_on(mug, book)
    assert not is_on(book, mug)
    assert is_on(mug, TABLE)


def test_things_are_next_to_each_other_by_their_surfaces():
    """Gaussians that are 2 cm apart stand for surfaces that go on for one more between two things."""
    grid = np.stack(np.meshgrid(*[np.arange(0, 0.081, 0.02)] * 3), axis=-1).reshape(-1, 3)
    for gap, expected in ((0.09, True), (0.115, True), (0.13, False), (0.3, False)):
        gaussians, rows = scene_of(grid, grid + np.array([0.08 + gap, 0, 0]))
        one, other = (Match(*box_of(gaussians, ids, UP), 1.0, ids) for ids in rows)
        assert max(one.extent.max(), other.extent.max()) < 0.105
        assert lies_next_to(gaussians, one, other, UP) is expected, gap


def test_what_hangs_on_a_wall_is_not_on_it():
    wall = block((-2.0, 1.0, 0.0), (2.0, 1.1, 2.5), 20_000)
    assert not is_on(block((-0.2, 0.97, 1.2), (0.2, 1.0, 1.6)), wall)


def test_a_book_that_leans_in_a_shelf_is_on_the_board_below_its_middle():
    """Its foot touches the back alone: the board under it is a little too low, as where no photo sees it well."""
    board, back = block((-0.4, -0.2, -0.02), (0.4, 0.2, 0.0), 6_000), block((-0.4, 0.2, 0.0), (0.4, 0.22, 0.4), 6_000)
    book = block((-0.4, 0.0, 0.06), (-0.36, 0.195, 0.31))
    gaussians, (own, shelf) = scene_of(book, np.concatenate([board, back]))
    assert not rests_on(gaussians, own, shelf, UP)
    assert rests_on(gaussians, own, shelf, UP, inside=True)
    gaussians, (own, wall) = scene_of(book, back)
    assert not rests_on(gaussians, own, wall, UP, inside=True)


def test_nothing_is_on_what_begins_above_its_ankle():
    """Legs of a chair that stand between those of a table."""
    top = TABLE[TABLE[:, 2] > 0.72]
    legs = np.concatenate(
        [block((x, y, 0.2), (x + 0.05, y + 0.05, 0.72), 800) for x in (-0.1, 0.1) for y in (-0.1, 0.1)]
    )
    chair = block((-0.04, -0.04, 0.0), (0.09, 0.09, 1.0))
    assert not is_on(chair, np.concatenate([top, legs]))


def test_contact_is_told_by_size_and_spacing():
    """Rows a tenth apart, so that the third neighbour is two tenths away, and two deviations of both are 0.02."""
    row = np.arange(9.0)[:, None] * [0.1, 0, 0]
    for height, touches in ((0.215, True), (0.225, False)):
        gaussians, (one, two) = scene_of(row, row + np.array([0, 0, height]))
        touching, touched = contacts(gaussians, one, one, two)
        assert touching.tolist() == one.tolist() * touches
        assert touched.tolist() == two.tolist() * touches


def test_gaps_are_meant_from_above():
    places = np.array([[1.0, 0, 5], [0, 1.0, -5], [-1.0, 0, 0]])
    assert widest_gap(places, np.zeros(3), UP) == pytest.approx(np.pi)
    assert widest_gap(places[:2], np.zeros(3), UP) == pytest.approx(1.5 * np.pi)
    assert widest_gap(places[:1], np.zeros(3), UP) == pytest.approx(2 * np.pi)


def test_up_may_be_any_direction():
    turn = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    gaussians, (vase, table) = scene_of(block((-0.05, -0.05, 0.75), (0.05, 0.05, 1.05)), TABLE, turn=turn)
    assert rests_on(gaussians, vase, table, turn @ UP)
    assert not rests_on(gaussians, vase, table, UP)


def test_things_of_a_few_gaussians_touch_nothing():
    assert not is_on(np.array([[0.3, 0, 0.76]]), TABLE)
    assert not is_on(block((-0.05, -0.05, 0.75), (0.05, 0.05, 1.05)), np.array([[0.0, 0, 0.74]]))
