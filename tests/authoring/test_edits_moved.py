"""A moved object is the world with the object moved: two rooms are built, one is edited into the other.

Run with -s it prints the PSNR of the object's pixels in 20 views.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drsplat import Gaussians, render
from drsplat.authoring.editing import Edit, Fill, Move, Remove, Rows, Scale, Turn, edited
from drsplat.drawing.pictures import visible_share
from drsplat.scene.similarity import sh_basis
from drsplat.scene.views import View
from furnished.cameras import walk
from furnished.room import INVENTORY, build_room

COARSE, TEDDY, BY, TURN = 2.0, "brown teddy", (-0.55, 0.30, 0.0), 40.0
GLOSS = np.array([0.25, 0.18, 0.10])  # of a highlight, added to the colour


def room(by: tuple[float, float, float] = (0, 0, 0), turn: float = 0.0) -> tuple[Gaussians, np.ndarray, np.ndarray]:
    """The furnished room, the teddy moved and turned in it; its rows, and where it stands."""
    made = build_room(COARSE, {TEDDY: (by, turn)})
    rows = np.flatnonzero(made.members(TEDDY))
    return glossy(made.gaussians, rows, turn), rows, np.add(INVENTORY[TEDDY][0], by)


def glossy(gaussians: Gaussians, rows: np.ndarray, turn: float) -> Gaussians:
    """The teddy shines where it is looked at along its own x: harmonics of degree 2, fitted in its frame as turned."""
    directions = np.random.default_rng(1).normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    angle = np.radians(turn)
    along = directions @ [np.cos(angle), np.sin(angle), 0]
    shine = np.linalg.lstsq(sh_basis(directions)[:, :9], 0.5 * (along + along**2), rcond=None)[0]
    sh = np.zeros((len(gaussians), 9, 3), np.float32)
    sh[:, :1] = gaussians.sh
    sh[rows] += (shine[:, None] * GLOSS).astype(np.float32)
    return Gaussians(gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, sh)


def views() -> list[View]:
    return walk(20, 320, 240)


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((np.clip(a, 0, 1) - np.clip(b, 0, 1)) ** 2)))


def of_pixels(drawn: Gaussians, truth: Gaussians, rows: np.ndarray) -> list[float]:
    """PSNR over the pixels that show the object in the truth, view by view; of views with 50 such pixels or more."""
    found = []
    for view in views():
        shown = visible_share(truth, view, rows) > 0.5
        if shown.sum() >= 50:
            found.append(psnr(render(drawn, view).rgb[shown], render(truth, view).rgb[shown]))
    return found


@pytest.mark.slow
def test_a_moved_and_turned_object_is_the_world_with_it_moved():
    scene, rows, at = room()
    truth, same_rows, _ = room(BY, TURN)
    assert_array_equal(rows, same_rows)
    x, y, z = at.tolist()
    edits = [Edit(Rows.of(rows), change) for change in (Turn(TURN, (0, 0, 1), (x, y, z)), Move(BY))]
    moved, still = of_pixels(edited(scene, edits), truth, rows), of_pixels(scene, truth, rows)
    print(f"{len(moved)} views: PSNR {min(moved):.1f} to {max(moved):.1f} dB, mean {np.mean(moved):.1f}; not moved")
    print(f"{min(still):.1f} to {max(still):.1f}, mean {np.mean(still):.1f}")
    assert len(moved) >= 15
    assert min(moved) > 30
    assert np.mean(still) < 20  # so this can fail


@pytest.mark.slow
def test_the_floor_is_whole_again():
    """The floor below the teddy was there all along: without it and with its hole filled it looks so."""
    scene, rows, _ = room()
    kept = edited(scene, [Edit(Rows.of(rows), Remove())])
    beside = (np.abs(scene.means[rows] - scene.means[rows].mean(axis=0))[:, :2] < 0.12).all(axis=1)
    assert beside.any()
    floor = np.flatnonzero((scene.means[:, 2] < 0.02) & ~np.isin(np.arange(len(scene)), rows))
    away = np.abs(scene.means[floor, :2] - scene.means[rows, :2].mean(axis=0)).max(axis=1)
    hole = floor[away < 0.13]
    damaged = edited(scene, [Edit(Rows.of(hole), Remove())])
    own = np.searchsorted(np.setdiff1d(np.arange(len(scene)), hole), rows)
    target = Rows.of(own)
    filled = edited(damaged, [Edit(target, Remove()), Edit(target, Fill())])
    open_ = edited(damaged, [Edit(target, Remove())])
    shown = [visible_share(kept, view, hole - (hole > rows[-1]) * len(rows)) > 0.5 for view in views()]
    pairs = [(view, one) for view, one in zip(views(), shown, strict=True) if one.sum() >= 30]
    assert pairs
    closed = [psnr(render(filled, view).rgb[one], render(kept, view).rgb[one]) for view, one in pairs]
    left = [psnr(render(open_, view).rgb[one], render(kept, view).rgb[one]) for view, one in pairs]
    print(f"hole: open {np.mean(left):.1f} dB, filled {np.mean(closed):.1f}")
    assert np.mean(closed) > np.mean(left) + 3


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_copy_of_another_size_covers_as_much_from_as_much_nearer(factor):
    scene, rows, at = room()
    x, y, z = at.tolist()
    only = scene.subset(rows)
    everything = Rows.of(np.arange(len(only)))
    done = edited(only, [Edit(everything, Scale(factor, (x, y, z)))])
    view = views()[0]
    nearer = view.cam_from_world.copy()
    center = at + (view.center - at) * factor
    nearer[:3, 3] = -nearer[:3, :3] @ center
    there = View(view.name, view.K, nearer, view.width, view.height)
    assert_allclose(render(done, there).rgb, render(only, view).rgb, atol=0.01)
