"""Pieces that become things: what depth says at their borders, what is joined, and where that stands in the forest."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_array_equal

from drsplat import Gaussians, View
from drsplat.authoring.filming.looking import looking_at
from drsplat.errors import InputError
from drsplat.field.evidence.provenance import Provenance, cameras_of
from drsplat.field.forest import GROUP, PART, THING, check_forest
from drsplat.field.objects.borders import Borders, borders
from drsplat.field.objects.choosing import Tree
from drsplat.field.objects.joining import (
    MIN_RELIEF,
    RELIEF_PRIOR_PIXELS,
    Joined,
    Outlines,
    PieceSet,
    grown,
    join,
    refined,
    with_joined,
)

SIZE = 200
UP = np.array([0.0, -1, 0])
LENS = np.array([[200.0, 0, SIZE / 2], [0, 200, SIZE / 2], [0, 0, 1]])
UNSURE = np.float32(0.1)


def photo(name: str, eye: np.ndarray, target: np.ndarray) -> View:
    return View(
        name, width=SIZE, height=SIZE, K=LENS, cam_from_world=looking_at(eye, target, UP, (SIZE, SIZE)).cam_from_world
    )


def views_around(target: np.ndarray, distance: float, count: int = 6) -> list[View]:
    """Cameras in a half circle before the target, a little above it."""
    views = []
    for number, angle in enumerate(np.linspace(-1.0, 1.0, count)):
        eye = target + distance * np.array([np.sin(angle), -0.4, -np.cos(angle)])
        views.append(photo(f"{number}.jpg", eye, target))
    return views


def spheres(points: np.ndarray, size: float) -> Gaussians:
    """Small round opaque Gaussians at some points."""
    count = len(points)
    return Gaussians(
        np.ascontiguousarray(points, np.float32),
        np.tile(np.float32([1, 0, 0, 0]), (count, 1)),
        np.full((count, 3), size, np.float32),
        np.full(count, 0.99, np.float32),
        np.zeros((count, 1, 3), np.float32),
    )


def sheet(low: tuple[float, float, float], high: tuple[float, float, float], step: float) -> np.ndarray:
    """Points of a flat rectangle; one of the three lengths is nothing."""
    along = [np.arange(a, b + step / 2, step) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*along, indexing="ij"), -1).reshape(-1, 3)


def ball(radius: float, step: float) -> np.ndarray:
    """Points of a sphere around zero."""
    count = int(4 * np.pi * radius**2 / step**2)
    heights = 1 - 2 * (np.arange(count) + 0.5) / count
    angles = np.arange(count) * np.pi * (3 - np.sqrt(5))
    flat = np.sqrt(1 - heights**2)
    return radius * np.stack([flat * np.cos(angles), heights, flat * np.sin(angles)], 1)


def pairs_of(found: Borders) -> dict[tuple[int, int], np.ndarray]:
    """By nearer and further piece: pixels where depth goes on, and all of their border."""
    counts = np.stack([found.levels, found.lengths], axis=1)
    return {(int(a), int(b)): pair for a, b, pair in zip(found.front, found.back, counts, strict=True)}


def a_ball_before_a_wall() -> tuple[Gaussians, np.ndarray, list[View]]:
    """Pieces: the upper and the lower half of the ball, and the wall, far behind it."""
    points, wall = ball(1.0, 0.05), sheet((-6, -4, 4), (6, 4, 4), 0.12)
    pieces = np.where(points[:, 1] < 0, 0, 1)
    scene = spheres(np.concatenate([points, wall]), 0.04)
    return scene, np.append(pieces, np.full(len(wall), 2)).astype(np.int32), views_around(np.zeros(3), 5.0)


def test_depth_goes_on_between_halves_of_a_ball_and_jumps_to_the_wall():
    scene, pieces, views = a_ball_before_a_wall()
    found = borders(scene, views, pieces)
    pairs = pairs_of(found)
    halves = pairs.get((0, 1), np.zeros(2)) + pairs.get((1, 0), np.zeros(2))
    assert halves[0] > 0.8 * halves[-1] > 100
    for half in (0, 1):
        assert pairs[half, 2][0] < 0.05 * pairs[half, 2][1]
        assert (2, half) not in pairs or pairs[2, half][1] < 0.05 * pairs[half, 2][1]
    assert found.areas.min() > 1000


def test_two_colours_of_a_slanted_wall_have_no_jump():
    """Depth changes from pixel to pixel, by as much on either side of the border."""
    points = sheet((-4, -3, 0), (4, 3, 0), 0.08)
    points[:, 2] = 1.5 * points[:, 0]
    pieces = (points[:, 0] > 0).astype(np.int32)
    view = photo("a.jpg", np.array([0.0, 0, -8]), np.zeros(3))
    counts = sum(pairs_of(borders(spheres(points, 0.06), [view], pieces)).values(), np.zeros(2, np.int64))
    assert counts[0] > 0.9 * counts[-1] > 50


def test_what_stands_on_a_table_touches_it_and_is_no_part_of_it():
    """In the valley between the two depth goes on as well: such pixels are not told as borders."""
    table, box = sheet((-3, 0, -3), (3, 0, 3), 0.08), sheet((-1, -2, 0), (1, -0.04, 0), 0.08)
    scene = spheres(np.concatenate([table, box]), 0.06)
    pieces = np.append(np.zeros(len(table)), np.ones(len(box))).astype(np.int32)
    eye = np.array([0.0, -3, -6])
    view = photo("a.jpg", eye, np.array([0.0, -0.5, 0]))
    pairs = pairs_of(borders(scene, [view], pieces))
    level = sum(counts[0] for counts in pairs.values())
    assert level < 0.2 * sum(counts[-1] for counts in pairs.values())


def test_the_halves_of_a_ball_are_one_thing_and_the_wall_is_another():
    scene, pieces, views = a_ball_before_a_wall()
    (thing,) = join(borders(scene, views, pieces), np.full(3, UNSURE))
    assert thing.members == [0, 1]
    assert thing.relief > 0.9


def test_borders_are_the_same_at_any_number_of_threads():
    scene, pieces, views = a_ball_before_a_wall()
    one, two = (borders(scene, views, pieces, threads=threads) for threads in (1, 2))
    for first, second in zip(one, two, strict=True):
        assert_array_equal(first, second)


def known(pairs: dict[tuple[int, int], tuple[int, int]], areas: list[int]) -> Borders:
    """pairs: by nearer and further piece, pixels where depth goes on, and where it jumps."""
    front, back = (np.int32([pair[k] for pair in pairs]) for k in (0, 1))
    levels, jumps = np.array(list(pairs.values()), np.int64).reshape(-1, 2).T
    return Borders(front, back, levels, levels + jumps, np.array(areas, np.int64))


def joined(
    pairs: dict[tuple[int, int], tuple[int, int]], areas: list[int], whole: int | None = None
) -> list[list[int]]:
    """The sets that pieces are joined to. whole: a piece that masks hold as a whole."""
    sure = np.full(len(areas), UNSURE)
    if whole is not None:
        sure[whole] = 0.8
    return [thing.members for thing in join(known(pairs, areas), sure)]


DOLL = {(0, 1): (500, 0), (1, 2): (300, 0), (0, 3): (50, 1000), (1, 3): (20, 700), (2, 3): (60, 600)}
"""Face, hair and dress, before a wall."""


def test_what_stands_out_together_is_one_thing():
    """Closed form: of face, hair and dress 2300 pixels are in front, 130 level: 2300 / (2430 + 30)."""
    (thing,) = join(known(DOLL, [4000, 3000, 3000, 90_000]), np.full(4, UNSURE))
    assert thing.members == [0, 1, 2]
    assert thing.relief == pytest.approx(2300 / 2460)


def test_what_fills_more_than_half_of_the_photos_is_the_room():
    pairs = {(0, 1): (500, 0), (0, 2): (50, 1000), (1, 2): (20, 700)}
    assert joined(pairs, [4000, 4000, 7000]) == []
    assert joined(pairs, [4000, 4000, 9000]) == [[0, 1]]


def test_what_masks_hold_as_a_whole_stays_a_thing():
    """Every photo has a mask of the third piece: it is left out where it is small, else nothing is joined."""
    assert joined(DOLL, [4000, 3000, 500, 90_000], whole=2) == [[0, 1]]
    pairs = {(0, 1): (500, 0), (0, 2): (50, 1000), (1, 2): (20, 700)}
    assert joined(pairs, [4000, 4000, 90_000]) == [[0, 1]]
    assert joined(pairs, [4000, 4000, 90_000], whole=1) == []


def test_a_table_that_stands_out_does_not_take_the_plates_on_it():
    pairs = {(0, 3): (0, 2000), (1, 0): (200, 20), (2, 0): (150, 20)}
    assert joined(pairs, [40_000, 2000, 1500, 90_000]) == []


HEAD = {(0, 4): (20, 700), (1, 4): (10, 500), (0, 1): (500, 0)}
BODY = {(2, 4): (60, 500), (3, 4): (60, 500), (2, 3): (500, 0)}
CHIN = {(1, 2): (140, 340), (0, 3): (60, 100)}
"""Head and body of two colours each, before a wall: along most of the border between the two depth jumps."""
FOUR = [4500, 4500, 4500, 4500, 90_000]


def test_a_head_and_a_body_are_one_thing_though_depth_jumps_between_them():
    """Closed form: 2200 pixels are in front of the wall, 150 level with it; within, 1200 of 1640 pixels are level."""
    (thing,) = join(known(HEAD | BODY | CHIN, FOUR), np.full(5, UNSURE))
    assert thing.members == [0, 1, 2, 3]
    assert thing.relief == pytest.approx(2200 / 2380)


def test_what_holds_together_by_a_touch_only_stays_apart():
    """Depth has to go on along half of the borders within: here along 1200 of 3200 pixels."""
    jumps = {(1, 2): (140, 1500), (0, 3): (60, 500)}
    assert joined(HEAD | BODY | jumps, FOUR) == [[0, 1], [2, 3]]


def test_a_thing_is_taken_out_of_what_it_stands_on():
    """A mug on a table: the table stands out little, and less than the mug: together they are no thing."""
    pairs = {(0, 1): (200, 300), (1, 2): (300, 700), (0, 2): (10, 600)}
    assert joined(pairs, [3000, 9000, 90_000]) == []


BOW = {(5, 0): (150, 30), (5, 4): (0, 120)}


def test_what_lies_on_a_thing_hides_some_of_its_outline():
    """A bow on the head that masks hold as a whole is no piece of the doll; its own outline counts for the doll's."""
    pairs = HEAD | BODY | CHIN | BOW
    (thing,) = join(known(pairs, [4500, 4500, 4500, 4500, 90_000, 600]), np.array([0.1] * 5 + [0.9], np.float32))
    assert thing.members == [0, 1, 2, 3]
    assert thing.relief == pytest.approx((2200 + 120) / (2200 + 120 + 150 + 30))


def test_a_head_and_a_body_that_are_each_the_best_around_themselves_are_united():
    """No single piece of the body makes the head stand out more, and none of the head the body."""
    halves = {(0, 4): (60, 1000), (1, 4): (60, 1000), (0, 1): (700, 0), (2, 4): (60, 1000), (3, 4): (60, 1000),
              (2, 3): (700, 0), (0, 2): (120, 0), (1, 3): (120, 0)}  # fmt: skip
    head = refined(Outlines.of(known(halves, FOUR), np.float32([UNSURE] * 4 + [1])), np.array([0, 1]))
    assert head.members.tolist() == [0, 1]
    assert joined(halves, FOUR) == [[0, 1, 2, 3]]


def test_what_stands_out_by_itself_stays_a_thing():
    """A bottle beside a laptop of two pieces, level with it at its foot: 1010 of 1140 pixels are in front."""
    laptop = {(0, 3): (30, 700), (1, 3): (40, 600), (0, 1): (600, 0)}
    bottle = {(2, 3): (40, 950), (2, 1): (90, 60)}
    areas = [5000, 5000, 3000, 90_000]
    assert joined(laptop | bottle, areas) == [[0, 1]]
    assert joined(laptop | bottle | {(2, 3): (160, 830)}, areas) == [[0, 1, 2]]


def test_relief_of_a_set_leaves_out_what_is_within():
    outlines = Outlines.of(known(DOLL, [4000, 3000, 3000, 90_000]), np.full(4, UNSURE))
    assert PieceSet(outlines, np.array([0, 1, 2])).relief == pytest.approx(2300 / 2460)
    assert PieceSet(outlines, np.array([0])).relief == pytest.approx(1000 / (1000 + 550 + 30)) == outlines.reliefs[0]


@given(st.integers(0, 10_000), st.integers(2, 10), st.lists(st.integers(0, 9), max_size=30))
def test_a_set_that_changes_is_the_set_counted_anew(seed, count, changes):
    outlines = Outlines.of(a_mesh(default_rng(seed), count), np.full(count + 1, UNSURE))
    changed, members = PieceSet(outlines, np.array([0])), {0}
    for piece in changes:
        if piece < count and members ^ {piece}:
            changed.change(piece)
            members ^= {piece}
    assert changed.members.tolist() == sorted(members)
    assert changed.area == outlines.areas[sorted(members)].sum()
    front, level, inner_front, inner_level = counted(outlines, members)
    assert changed.relief == front / (front + level + RELIEF_PRIOR_PIXELS)
    assert changed.holds == (inner_level >= inner_front)


@given(st.integers(0, 10_000), st.integers(2, 10))
def test_refining_ends_where_no_single_change_helps(seed, count):
    """Whatever set it begins with; and a set is never less than the seed that it is grown from."""
    rng = default_rng(seed)
    outlines = Outlines.of(a_mesh(rng, count), np.full(count + 1, UNSURE))
    vars(outlines)["free"] = np.ones(count + 1, bool)  # also what stands out by itself
    begun = PieceSet(outlines, grown(outlines, int(rng.integers(count))))
    ended = refined(outlines, begun.members)
    assert ended.holds
    assert ended.relief >= begun.relief - 1e-9
    for piece in range(count):
        changed = PieceSet(outlines, np.setxor1d(ended.members, [piece]))
        touches = ended.beside[piece] > 0 or ended.within[piece]
        if len(changed.members) and touches and changed.holds:
            assert changed.relief <= ended.relief + 1e-6


def counted(outlines: Outlines, members: set[int]) -> tuple[float, float, float, float]:
    """Pixels of the outline of some pieces in front and level, and of the borders within, counted one by one."""
    front, level = outlines.front.toarray(), outlines.level.toarray()
    others = set(range(len(front))) - members
    out = [(a, b) for a in members for b in others]
    within = [(a, b) for a in members for b in members]
    return (
        sum(front[a, b] for a, b in out), sum(level[a, b] for a, b in out),
        sum(front[a, b] for a, b in within), sum(level[a, b] for a, b in within) / 2,
    )  # fmt: skip


def a_mesh(rng: np.random.Generator, count: int) -> Borders:
    """Random borders between so many pieces, and a room of ten times their size that touches none."""
    pairs = {
        (int(a), int(b)): (int(rng.integers(0, 400)), int(rng.integers(0, 900)))
        for a, b in rng.integers(0, count, (3 * count, 2))
        if a != b
    }
    return known(pairs, [*rng.integers(250, 5000, count).tolist(), 100_000])


@pytest.mark.slow
@given(st.integers(0, 10_000), st.integers(2, 12))
def test_sets_are_disjoint_and_follow_the_pieces(seed, count):
    """Whatever the pieces are called."""
    rng = default_rng(seed)
    mesh, sure = a_mesh(rng, count), rng.random(count + 1).astype(np.float32)
    found = join(mesh, sure)
    members = [member for one in found for member in one.members]
    assert len(members) == len(set(members))
    assert all(len(one.members) > 1 and MIN_RELIEF <= one.relief <= 1 for one in found)
    names = np.append(rng.permutation(count), count).astype(np.int32)
    places = np.argsort(names)
    renamed = mesh._replace(front=names[mesh.front], back=names[mesh.back], areas=mesh.areas[places])
    others = join(renamed, sure[places])
    assert {frozenset(names[one.members].tolist()) for one in found} == {frozenset(j.members) for j in others}


def tree(parents: list[int], levels: list[int], node_of: list[int]) -> Tree:
    count = len(parents)
    return Tree(
        np.array(node_of, np.int32), np.array(parents, np.int32), np.array(levels, np.uint8), np.full(count, UNSURE)
    )


def test_joined_things_are_parts_of_a_new_one():
    """Nodes: a part of thing 1, things 1, 2 and 3, a group of 2 and 3. Things 1 and 2 are one: the group is crossed."""
    before = tree([1, -1, 4, 4, -1], [PART, THING, THING, THING, GROUP], [0, 1, 2, 3, 3, -1])
    after = with_joined(before, [Joined([0, 1], 0.9)])
    check_forest(after.node_of, after.parents, after.levels)
    assert after.levels.tolist() == [PART, PART, PART, THING, THING]
    assert after.parents.tolist() == [1, 3, 3, -1, -1]
    assert after.node_of.tolist() == [0, 1, 2, 4, 4, -1]
    assert after.sure[3] == np.float32(0.9)


def test_groups_that_hold_all_of_a_thing_and_more_stay():
    """Things 0, 1, 2; a group of 0 and 1, in a group with 2. Once 0 and 1 are one the inner group says nothing new."""
    before = tree([3, 3, 4, 4, -1], [THING, THING, THING, GROUP, GROUP], [0, 1, 2, -1])
    after = with_joined(before, [Joined([0, 1], 0.8)])
    check_forest(after.node_of, after.parents, after.levels)
    assert after.levels.tolist() == [PART, PART, THING, THING, GROUP]
    assert after.parents.tolist() == [2, 2, 4, 4, -1]


def test_cameras_are_kept_with_how_columns_came_about():
    views = views_around(np.zeros(3), 5.0, 3)
    come = Provenance(np.zeros((3, 2, 3)), np.zeros((3, 16), np.uint8), "avx2", None, cameras_of(views))
    again = come.of(np.array([2, 0])).views(["2.jpg", "0.jpg"])
    for view, expected in zip(again, (views[2], views[0]), strict=True):
        assert (view.name, view.width, view.height) == (expected.name, SIZE, SIZE)
        assert_array_equal(view.K, expected.K)
        assert_array_equal(view.cam_from_world, expected.cam_from_world)
    both = come.of(np.array([0])).with_views(come.of(np.array([1, 2])), np.array([2, 1, 0]))
    assert_array_equal(both.cameras, come.cameras[::-1])
    unknown = replace(come, cameras=None)
    assert unknown.views(["a", "b", "c"]) == []
    assert come.with_views(unknown, np.arange(6)).cameras is None


@pytest.mark.parametrize(("place", "value"), [(0, np.nan), (12, 0.0), (16, 0.0)])
def test_cameras_that_are_none_are_refused(place, value):
    numbers = cameras_of(views_around(np.zeros(3), 5.0, 2))
    numbers[1, place] = value
    with pytest.raises(InputError, match="cameras: expected 18 finite numbers"):
        Provenance(np.zeros((2, 2, 3)), np.zeros((2, 16), np.uint8), "avx2", None, numbers)
