"""Loose parts: what belongs to a thing though no object says so goes with it, and nothing of what is beside it does."""

from dataclasses import replace

import numpy as np
import pytest

from drsplat import Gaussians
from drsplat.authoring.editing import Edit, Fill, Remove, Rows, edited
from drsplat.authoring.editing.draft import OBJECT_ID
from drsplat.authoring.editing.ground import Surface, best_shift
from drsplat.authoring.editing.resolving import completed, loose_parts
from drsplat.errors import InputError
from drsplat.scene.gaussians import SH_C0, concatenated
from scenes import gaussians_at

TABLE, CAR, OTHER, SCRAP = range(4)
WOOD, ORANGE = (0.6, 0.4, 0.2), (1.0, 0.4, 0.0)


def grid(low: tuple, high: tuple, step: float) -> np.ndarray:
    axes = [np.arange(a, b + step / 2, step) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def wooden(means: np.ndarray, size: float | tuple = 0.012) -> Gaussians:
    return gaussians_at(means, size, WOOD)


def a_car_on_a_table() -> tuple[Gaussians, np.ndarray, dict[str, np.ndarray]]:
    """A car's body, its wheels (those on the left given to the table, those on the right a scrap), and a box beside."""
    table = grid((-1, -1, 0), (1, 1, 0), 0.02)
    body = grid((-0.15, -0.08, 0.05), (0.15, 0.08, 0.13), 0.02)
    left, right = (grid((-0.12, y, 0.02), (-0.08, y + 0.02, 0.04), 0.01) for y in (-0.08, 0.06))
    box = grid((0.25, -0.1, 0.02), (0.45, 0.1, 0.2), 0.02)
    parts = {"table": table, "body": body, "left": left, "right": right, "box": box}
    owners = {"table": TABLE, "body": CAR, "left": TABLE, "right": SCRAP, "box": OTHER}
    ends = np.cumsum([0, *map(len, parts.values())])
    rows = {name: np.arange(a, b) for name, a, b in zip(parts, ends[:-1], ends[1:], strict=True)}
    scene = concatenated(
        [wooden(table, (0.015, 0.015, 0.001)), *(wooden(parts[name]) for name in ("body", "left", "right", "box"))]
    )
    return scene, np.concatenate([np.full(len(rows[name]), owners[name]) for name in parts]), rows


def test_a_car_takes_its_wheels_and_neither_the_table_nor_what_is_beside_it():
    scene, owners, rows = a_car_on_a_table()
    inside = owners == CAR
    agreed = np.array([True, True, True, False])
    parts = np.flatnonzero(loose_parts(scene, inside, owners, agreed))
    np.testing.assert_array_equal(parts, np.concatenate([rows["left"], rows["right"]]))
    whole = completed(scene, rows["body"], owners, agreed)
    np.testing.assert_array_equal(whole, np.sort(np.concatenate([rows["body"], rows["left"], rows["right"]])))


def test_what_photos_agree_on_stays_a_thing_of_its_own():
    scene, owners, rows = a_car_on_a_table()
    parts = loose_parts(scene, owners == CAR, owners, np.ones(4, bool))
    assert not parts[rows["right"]].any()
    assert parts[rows["left"]].all()


def test_the_rest_of_a_scrap_goes_with_most_of_it():
    """Some of a scrap is too large to be a loose part: it goes if the rest is most of the scrap, and stays if not."""
    scene, owners, rows = a_car_on_a_table()
    agreed, right = np.array([True, True, True, False]), rows["right"]
    for share, goes in ((0.3, True), (0.7, False)):
        large = right[: int(share * len(right))]
        scales = scene.scales.copy()
        scales[large] *= 3
        whole = completed(replace(scene, scales=scales), rows["body"], owners, agreed)
        assert set(right[len(large) :]) <= set(whole)
        assert (set(large) <= set(whole)) == goes
        assert not set(rows["box"]) & set(whole)


def test_large_ones_reach_beyond_a_thing_and_stay():
    scene, owners, rows = a_car_on_a_table()
    scene.scales[rows["left"]] *= 3
    assert not loose_parts(scene, owners == CAR, owners, np.array([True, True, True, False]))[rows["left"]].any()


def test_few_gaussians_have_no_loose_parts():
    scene, owners, rows = a_car_on_a_table()
    inside = np.isin(np.arange(len(scene)), rows["body"][:5])
    assert not loose_parts(scene, inside, owners, np.ones(4, bool)).any()


# --- filled without specks ---


def a_hole_among_crumbs() -> tuple[Gaussians, np.ndarray]:
    """A block on a table with a hole below it, and orange crumbs everywhere that lie flat on the table."""
    floor = grid((-1, -1, 0), (1, 1, 0), 0.02)
    floor = floor[(np.abs(floor[:, :2]) > 0.1).any(axis=1)]
    crumbs = grid((-0.95, -0.95, 0.001), (0.95, 0.95, 0.001), 0.1)
    crumbs = crumbs[(np.abs(crumbs[:, :2]) > 0.12).any(axis=1)]
    block = grid((-0.1, -0.1, 0.02), (0.1, 0.1, 0.3), 0.02)
    flat = (0.015, 0.015, 0.001)
    scene = concatenated([wooden(floor, flat), gaussians_at(crumbs, flat, ORANGE), wooden(block)])
    return scene, np.arange(len(floor) + len(crumbs), len(scene))


def oranges(scene: Gaussians) -> int:
    return int(np.count_nonzero(scene.sh[:, 0, 2] < (0.1 - 0.5) / SH_C0))


def test_what_lies_on_a_table_is_not_cloned_into_a_hole():
    scene, block = a_hole_among_crumbs()
    rows = Rows.of(block)
    clean = edited(scene, [Edit(rows, Remove()), Edit(rows, Fill())])
    assert oranges(clean) == oranges(scene)
    in_hole = (np.abs(clean.means[:, :2]) < 0.09).all(axis=1)
    assert in_hole.sum() > 50


def a_thing_in_a_hole() -> tuple[Gaussians, np.ndarray, Gaussians, Gaussians]:
    """The same with grime of the floor below the block, and a low thing that is an object of its own."""
    scene, block = a_hole_among_crumbs()
    grime = wooden(grid((-0.05, -0.09, 0.002), (0.05, -0.08, 0.002), 0.01), (0.01, 0.01, 0.001))
    thing = gaussians_at(grid((-0.04, -0.04, 0.003), (0.04, 0.04, 0.009), 0.01), (0.005, 0.005, 0.005), ORANGE)
    first = len(scene)
    scene = concatenated([scene, grime, thing])
    owners = np.zeros(len(scene), np.int32)
    owners[block], owners[first + len(grime) :] = 1, 2
    return replace(scene, extra={OBJECT_ID: owners}), block, grime, thing


def test_what_stands_in_a_hole_stays():
    """The low thing stays, and the grime that training left there goes."""
    scene, block, grime, thing = a_thing_in_a_hole()
    rows = Rows.of(block)
    after = edited(scene, [Edit(rows, Remove()), Edit(rows, Fill())])
    assert np.count_nonzero(after.extra[OBJECT_ID] == 2) == len(thing)
    assert not (after.means[:, None] == grime.means[None]).all(axis=2).any()


def test_seams_are_not_compared_where_no_shift_closes_anything(monkeypatch):
    cells = np.zeros((20, 20), bool)
    missing = cells.copy()
    missing[8:12, 8:12] = True
    seams = []
    monkeypatch.setattr(Surface, "seam", lambda *arguments: seams.append(arguments) or 0.0)
    _, closed = best_shift(missing, cells, Surface(np.zeros((20, 20, 3)), ~missing))
    assert not closed.any()
    assert len(seams) == 1
    best_shift(missing, ~missing, Surface(np.zeros((20, 20, 3)), ~missing))
    assert len(seams) > 2  # so this can fail


def test_a_fill_of_other_rules_is_refused():
    with pytest.raises(InputError, match="expected version 4, got 3"):
        Fill(3)
