"""What `--fill` closes, takes and lets be: holes in the plane that surrounds them, and nothing that is only beside."""

from dataclasses import replace

import numpy as np
import pytest
from test_edits import of, on_a_floor
from test_loose_parts import ORANGE, a_thing_in_a_hole, grid, wooden

from drsplat import Gaussians
from drsplat.authoring.editing import Edit, Fill, Remove, Rows, edited
from drsplat.authoring.editing.draft import OBJECT_ID
from drsplat.authoring.editing.ground import Ground
from drsplat.authoring.editing.planes import Plane, surfaces_around
from drsplat.errors import DrSplatWarning
from drsplat.scene.gaussians import concatenated
from scenes import gaussians_at

FLOOR, TABLE, OTHER, NOBODY = 0, 1, 2, -1
FLAT = (0.015, 0.015, 0.001)


def filled(scene: Gaussians, rows: np.ndarray) -> Gaussians:
    return edited(scene, [Edit(Rows.of(rows), Remove()), Edit(Rows.of(rows), Fill())])


def same_places(scene: Gaussians, part: Gaussians) -> int:
    """How many of a part are still there."""
    return int((scene.means[:, None] == part.means[None]).all(axis=2).any(axis=0).sum())


def with_owners(*parts: tuple[Gaussians, int]) -> Gaussians:
    owners = np.concatenate([np.full(len(part), owner, np.int32) for part, owner in parts])
    return replace(concatenated([part for part, _ in parts]), extra={OBJECT_ID: owners})


def below_a_table(patch_owner: int) -> tuple[Gaussians, np.ndarray, Gaussians]:
    """A table of which only the legs touch the floor, and an orange patch on the floor below its top."""
    floor = grid((-1, -1, 0), (1, 1, 0), 0.02)
    below = (np.abs(floor[:, :2]) <= 0.061).all(axis=1)
    top = grid((-0.2, -0.2, 0.3), (0.2, 0.2, 0.34), 0.02)
    legs = grid((-0.2, -0.2, 0.01), (0.2, 0.2, 0.3), 0.02)
    legs = legs[(np.abs(legs[:, :2]) > 0.17).all(axis=1)]
    patch = gaussians_at(floor[below], FLAT, ORANGE)
    things = wooden(np.concatenate([top, legs]))
    scene = with_owners((wooden(floor[~below], FLAT), FLOOR), (patch, patch_owner), (things, TABLE))
    return scene, np.flatnonzero(scene.extra[OBJECT_ID] == TABLE), patch


@pytest.mark.parametrize(("owner", "stay"), [(NOBODY, False), (OTHER, True)])
def test_what_is_nobodys_below_a_thing_hides_no_hole(owner, stay):
    scene, table, patch = below_a_table(owner)
    middle = patch.subset((np.abs(patch.means[:, :2]) < 0.03).all(axis=1))  # what is around covers the edge
    assert same_places(filled(scene, table), middle) == (len(middle) if stay else 0)


def test_what_stands_off_a_floor_in_the_place_of_a_thing_goes():
    """It goes inside of the thing, and stays beside it, or where it is another's."""
    scene, block, _, _ = a_thing_in_a_hole()
    spike = wooden(grid((0, 0, 0.05), (0, 0, 0.25), 0.05))
    beside = replace(spike, means=spike.means + np.float32([0.5, 0, 0]))
    first, owners = len(scene), scene.extra[OBJECT_ID]
    for owner, gone in ((FLOOR, True), (OTHER, False)):
        more = np.full(2 * len(spike), owner, np.int32)
        whole = replace(
            concatenated([replace(scene, extra={}), spike, beside]), extra={OBJECT_ID: np.concatenate([owners, more])}
        )
        assert len(whole) == first + 2 * len(spike)
        after = filled(whole, block)
        assert same_places(after, spike) == (0 if gone else len(spike))
        assert same_places(after, beside) == len(beside)


@pytest.mark.parametrize(("high", "around"), [(1.0, True), (0.05, True), (-0.15, False)])
def test_a_hole_is_within_what_is_left_of_its_plane(high, around):
    """A floor that ends behind the hole, in its middle, or before it."""
    floor = grid((-1, -1, 0), (1, high, 0), 0.02)
    floor = floor[(np.abs(floor[:, :2]) > 0.1).any(axis=1)]
    corner = np.array([[-1, 1, 0.0], [1, 1, 0.0]])  # so that cells reach there: too few to count
    scene = wooden(np.concatenate([floor, corner]), FLAT)
    scene.opacities[-2:] = 0.01
    plane = Plane(np.array([0.0, 0, 1]), 0.0, np.eye(3)[:2], 0.02)
    ground = Ground(scene, plane, [], grid((-0.1, -0.1, 0.02), (0.1, 0.1, 0.3), 0.02))
    assert ground.hole.any()
    assert ground.is_around_hole == around


def test_where_little_can_be_closed_nothing_is_cloned(monkeypatch):
    scene, thing = on_a_floor()
    gone = edited(scene, [of(thing, Remove())])
    monkeypatch.setattr("drsplat.authoring.editing.closing.MAX_SHIFTS", 1)
    assert len(filled(scene, thing)) > len(gone)  # so this can fail
    monkeypatch.setattr("drsplat.authoring.editing.closing.CLOSED_OPACITY", 1.0)
    with pytest.warns(DrSplatWarning, match="of one plane 0% of the hole could be closed"):
        assert len(filled(scene, thing)) == len(gone)


def test_a_plane_across_things_is_no_surface():
    """A floor with nothing below it is one; the same floor with more below it than above is none."""
    rng = np.random.default_rng(0)
    floor = np.column_stack([rng.uniform(-1, 1, (3000, 2)), np.zeros(3000)])
    thing = np.column_stack([rng.uniform(-0.2, 0.2, (500, 2)), rng.uniform(0, 0.4, 500)])
    below = np.column_stack([rng.uniform(-1, 1, (4000, 2)), rng.uniform(-1, -0.2, 4000)])
    assert len(surfaces_around(thing, floor)) == 1
    assert not surfaces_around(thing, np.concatenate([floor, below]))
