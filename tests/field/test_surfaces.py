"""Which objects are surfaces, by their shape."""

import numpy as np
import pytest

import drsplat as ds
from drsplat.field.objects.surfaces import surfaces

SIZE = 10.0  # of the scene
RNG = np.random.default_rng(5)


def scene_of(*things: np.ndarray) -> tuple[ds.Gaussians, np.ndarray]:
    """Gaussians at places of things, and the number of each one's thing."""
    means = np.concatenate(things).astype(np.float32)
    count = len(means)
    quats, scales = np.tile(np.float32([1, 0, 0, 0]), (count, 1)), np.full((count, 3), 0.01, np.float32)
    gaussians = ds.Gaussians(means, quats, scales, np.full(count, 0.9, np.float32), np.zeros((count, 1, 3), np.float32))
    return gaussians, np.repeat(np.arange(len(things), dtype=np.int32), [len(thing) for thing in things])


def sheet(width: float, depth: float, thick: float = 0.02, count: int = 800) -> np.ndarray:
    return RNG.uniform(-0.5, 0.5, (count, 3)) * (width, depth, thick)


def tilted(points: np.ndarray) -> np.ndarray:
    turn = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
    return points @ turn.T + 3


def told(*things: np.ndarray) -> list[bool]:
    gaussians, numbers = scene_of(*things)
    return surfaces(numbers, len(things), gaussians, SIZE)


def test_floors_and_table_tops_are_surfaces_and_books_boxes_and_balls_are_not():
    floor, table, book = sheet(8, 6), sheet(2, 1.5, 0.05), sheet(0.4, 0.3)
    box, ball = sheet(2, 1.5, 1), RNG.normal(size=(500, 3))
    assert told(*map(tilted, (floor, table, book, box, ball))) == [True, True, False, False, False]


def test_the_legs_of_a_table_and_what_lies_on_it_leave_its_top_a_surface():
    top = sheet(2, 1.5, 0.05)
    corners = [np.array([x, y, 0]) for x in (-0.9, 0.9) for y in (-0.7, 0.7)]
    legs = np.concatenate([RNG.uniform(0, 1, (30, 3)) * (0.1, 0.1, -1.2) + corner for corner in corners])
    assert told(tilted(np.concatenate([top, legs]))) == [True]


def test_walls_around_a_room_are_a_surface_though_no_plane_holds_them():
    sides = [sheet(0.05, 8, 3) + np.array([x, 4, 0]) for x in (-4, 4)]
    walls = np.concatenate([sheet(8, 0.05, 3), *sides])
    assert told(tilted(walls)) == [True]
    assert told(tilted(walls / 4)) == [False]


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_few_gaussians_and_none_are_no_surface(count):
    gaussians, numbers = scene_of(np.zeros((count, 3)))
    assert surfaces(numbers, 1, gaussians, SIZE) == [False]
    assert surfaces(np.full(count, -1, np.int32), 0, gaussians, SIZE) == []


def test_gaussians_too_faint_to_be_seen_do_not_count():
    floor, haze = sheet(8, 6), RNG.uniform(-4, 4, (3000, 3))
    gaussians, numbers = scene_of(np.concatenate([floor, haze]))
    gaussians.opacities[len(floor) :] = 0.01
    assert surfaces(numbers, 1, gaussians, SIZE) == [True]
