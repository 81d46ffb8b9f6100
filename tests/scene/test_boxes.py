"""Boxes hold the thing, stand upright, and are not stretched by strays."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from scipy.special import ndtr, ndtri
from test_registration import capture
from test_tasks import boxes_scene, field_of, unit

from drsplat import Answer, Gaussians, Scene, load_field, register
from drsplat.errors import InputError, MismatchError
from drsplat.field.codes import PQ
from drsplat.field.evidence.aggregation import Sampling
from drsplat.formats.field_folder import MANIFEST
from drsplat.kernels.boxes import box_of, boxes_of
from drsplat.query.tasks import locate
from drsplat.scene.boxes import Box, up_of, upward
from drsplat.scene.gaussians import concatenated
from scenes import look_at_view, random_gaussians
from twins import boxes as twin
from twins.boxes import core, mixture_quantile

UP = np.array([0.0, 0, 1])
SIZE = (0.6, 0.3, 0.9)


def shell(size=SIZE, turn: float = 0.0, count: int = 4000, seed: int = 0) -> Gaussians:
    """The surface of a cuboid, as trained scenes have it: flat Gaussians that lie on its faces."""
    rng = default_rng(seed)
    area = np.array([size[1] * size[2], size[0] * size[2], size[0] * size[1]])
    face = rng.choice(3, count, p=area / area.sum())
    points = rng.uniform(-0.5, 0.5, (count, 3))
    points[np.arange(count), face] = rng.choice([-0.5, 0.5], count)
    scales = np.full((count, 3), 0.02)
    scales[np.arange(count), face] = 0.001
    about = Rotation.from_euler("z", turn, degrees=True)
    x, y, z, w = about.as_quat()
    return Gaussians(
        about.apply(points * size).astype(np.float32),
        np.tile(np.float32([w, x, y, z]), (count, 1)),
        scales.astype(np.float32),
        rng.uniform(0.3, 1, count).astype(np.float32),
        np.zeros((count, 1, 3), np.float32),
    )


def everything(gaussians: Gaussians, up: np.ndarray | None = UP) -> Box:
    return box_of(gaussians, np.arange(len(gaussians)), up)


@settings(max_examples=15)
@given(st.floats(0, 180))
def test_a_cuboid_is_found_whichever_way_it_is_turned(turn):
    found = everything(shell(turn=turn))
    assert_allclose(found.center, 0, atol=0.01)
    assert_allclose(found.extent, SIZE, atol=0.04)
    assert (found.extent > np.array(SIZE) - 0.005).all()
    assert_allclose(found.axes[2], UP, atol=1e-9)
    assert np.linalg.det(found.axes) == pytest.approx(1)
    along = np.array([np.cos(np.radians(turn)), np.sin(np.radians(turn)), 0])
    assert abs(found.axes[0] @ along) > 0.99


def test_a_flat_thing_has_the_size_of_its_gaussians():
    """Of one large Gaussian in the middle the centres know nothing."""
    one = replace(random_gaussians(1), scales=np.float32([[0.5, 0.2, 0.01]]))
    one = replace(one, quats=np.float32([[1, 0, 0, 0]]))
    expected = 2 * ndtri(1 - 0.003) * one.scales[0]
    assert_allclose(everything(one).extent, expected, rtol=1e-5)
    assert_allclose(everything(one, None).extent[0], expected[0], rtol=1e-5)


def test_a_tail_goes_where_it_is_sparse_and_light():
    """To 101 points a hundredth apart, one more is a tail of 1 % of the mass, worth 8 % of the length."""
    row = np.linspace(0, 1, 101)

    def core_with(tail, weight=1.0):
        mass = np.append(np.ones(101), np.full(len(tail), weight))
        return core(np.append(row, tail), mass / mass.sum())

    assert core_with([]) == (0, 1)
    assert core_with([3.0]) == (0, 1)
    assert core_with([-2.0]) == (0, 1)
    assert core_with([1.05]) == (0, 1.05)  # 5 % longer for 1 % of the mass: less than eight times as sparse
    assert core_with([1.3, 1.4]) == (0, 1)
    assert core_with([3.0] * 5) == (0, 3)  # 5 % of the mass are no strays


def knife(halo: int, seed: int = 2) -> Gaussians:
    """A flat blade and its handle, 0.27 x 0.03 x 0.03, in a halo of the table around it."""
    blade = shell((0.27, 0.03, 0.03), turn=25, count=500)
    blade = replace(blade, scales=blade.scales * np.float32(0.1))
    rng = default_rng(seed)
    angles, far = rng.uniform(0, 2 * np.pi, halo), rng.uniform(0.03, 0.09, halo)
    means = np.stack([far * np.cos(angles), far * np.sin(angles), rng.uniform(-0.09, 0.09, halo)], axis=1)
    ids = np.arange(halo)
    around = replace(blade.subset(ids), means=means.astype(np.float32))
    return concatenated([blade, around])


@pytest.mark.parametrize("up", [None, UP])
@pytest.mark.parametrize("seed", range(5))
def test_the_halo_of_a_thin_thing_neither_widens_nor_turns_its_box(up, seed):
    clean, found = everything(knife(0), up), everything(knife(20, seed), up)
    assert_allclose(found.extent, clean.extent, atol=0.012)
    assert abs(found.axes[0] @ clean.axes[0]) > np.cos(np.radians(2))


@pytest.mark.parametrize("up", [None, UP, np.array([0.6, 0, 0.8])])
@pytest.mark.parametrize("count", [3, 40, 900])
def test_native_is_the_twin(up, count):
    scene = replace(random_gaussians(1000), origin=np.array([5.0, 0, -7]))
    ids = default_rng(count).choice(1000, count, replace=False)
    for fast, slow in zip(box_of(scene, ids, up), twin.box_of(scene, ids, up), strict=True):
        assert_allclose(fast, slow, atol=2e-6)


@pytest.mark.parametrize("up", [None, UP])
@pytest.mark.parametrize("seed", range(4))
def test_native_leaves_out_the_strays_that_the_twin_does(up, seed):
    thing = knife(20, seed)
    ids = np.arange(len(thing))
    for fast, slow in zip(box_of(thing, ids, up), twin.box_of(thing, ids, up), strict=True):
        assert_allclose(fast, slow, atol=2e-6)


def test_many_boxes_at_once_at_any_number_of_threads():
    scene, rng = random_gaussians(500), default_rng(3)
    ids = [rng.choice(500, count, replace=False) for count in (1, 2, 30, 400)]
    starts = np.append(0, np.cumsum([len(one) for one in ids]))
    found = boxes_of(scene, starts, np.concatenate(ids), UP, threads=3)
    for number, one in enumerate(ids):
        alone = box_of(scene, one, UP)
        for name in ("center", "axes", "extent"):
            np.testing.assert_array_equal(getattr(found, name)[number], getattr(alone, name))


@pytest.mark.parametrize(
    ("starts", "ids", "words"),
    [([0, 0], [], "at least one"), ([0, 2], [0, 500], "existing"), ([0, 3], [0, 1], "row starts")],
)
def test_sets_that_are_none(starts, ids, words):
    with pytest.raises(InputError, match=words):
        boxes_of(random_gaussians(500), np.array(starts, np.int64), np.array(ids, np.int64))


@settings(max_examples=10)
@given(st.tuples(*[st.floats(-1e7, 1e7)] * 3), st.floats(1e-3, 1e3))
def test_boxes_move_and_grow_with_the_scene(place, unit_of_length):
    thing, by = shell(turn=30), np.array(place)
    grown = replace(
        thing,
        means=thing.means * np.float32(unit_of_length),
        scales=thing.scales * np.float32(unit_of_length),
        origin=by,
    )
    own, found = everything(thing), everything(grown)
    assert_allclose(found.center - by, own.center * unit_of_length, atol=1e-4 * unit_of_length + 1e-8)
    assert_allclose(found.extent, own.extent * unit_of_length, rtol=1e-4)
    assert_allclose(found.axes, own.axes, atol=1e-4)


def test_free_boxes_lie_as_the_thing_does_longest_first():
    tilt = Rotation.from_euler("xyz", [30, 40, 10], degrees=True)
    scene, _ = boxes_scene([(0, 0, 0)], size=(0.2, 0.8, 0.4), turn=tilt)
    found = everything(scene, None)
    assert (np.diff(found.extent) < 0).all()
    assert np.linalg.det(found.axes) == pytest.approx(1)
    assert_allclose(found.extent, (0.8, 0.4, 0.2), rtol=0.05)
    assert everything(scene).extent.prod() > 1.3 * found.extent.prod()


@given(st.integers(0, 10_000), st.integers(1, 300), st.sampled_from([0.003, 0.2, 0.5, 0.8, 0.997]))
def test_the_quantile_is_where_the_mixture_says(seed, count, share):
    """Wide ones and narrow ones, and some without mass: all of them are counted, not only those near the end."""
    rng = default_rng(seed)
    means, deviations = rng.normal(0, 5, (count, 2)), np.exp(rng.normal(-1, 2, (count, 2)))
    mass = np.where(rng.random(count) < 0.2, 0, rng.random(count)) + 1e-9
    mass /= mass.sum()
    found = mixture_quantile(means, deviations, mass, share)
    for column in range(2):
        below = mass @ ndtr((found[column] - means[:, column]) / deviations[:, column])
        assert below == pytest.approx(share, abs=1e-4)


@pytest.mark.parametrize("pitch", [-60.0, -20.0, 0.0])
def test_up_is_told_by_tilted_photos_from_one_side(pitch):
    """Their mean would lean: all of them look down, and none from behind."""
    down = np.radians(pitch)
    eyes = [
        (5 * np.cos(a) * np.cos(down), 5 * np.sin(a) * np.cos(down), -5 * np.sin(down))
        for a in np.radians([0, 30, 60, 90])
    ]
    assert_allclose(upward([look_at_view(eye) for eye in eyes]), UP, atol=1e-6)


def test_photos_that_do_not_tell_which_way_is_up():
    upright = look_at_view((4, 0, 0))
    pose = np.diag([-1.0, -1, 1, 1]) @ upright.cam_from_world
    assert up_of([upright, replace(upright, cam_from_world=pose)]) is None
    assert up_of([]) is None
    assert_allclose(upward([upright]), UP, atol=1e-6)


def test_a_field_remembers_what_is_up_and_locate_uses_it(tmp_path):
    gaussians, (views, features) = random_gaussians(400, seed=3), capture()
    registration = register(gaussians, views, features, Sampling(10))
    assert registration.up is not None
    assert_allclose(registration.up, upward(views))
    field = registration.to_field(PQ(4))
    field.save(tmp_path / "a.field")
    again = load_field(tmp_path / "a.field")
    assert again.up is not None
    assert_allclose(again.up, registration.up, rtol=1e-12)
    scene, every = Scene(again, gaussians), Answer.of(again, np.ones(len(again), np.float32), 0.5)
    assert_allclose(scene.up, registration.up, rtol=1e-12)
    (match,) = locate(every, gaussians, link_distance=9.0, up=scene.up)
    assert_allclose(match.axes[2], registration.up)
    (free,) = locate(every, gaussians, link_distance=9.0)
    assert (np.diff(free.extent) <= 0).all()


def test_haze_of_a_match_does_not_stretch_its_box():
    """As of objects: what cannot be seen is selected, and the box is of the rest."""
    thing = shell()
    means, opacities = thing.means.copy(), thing.opacities.copy()
    means[:800] *= np.float32(1.5)
    opacities[:800] = 0.09
    dirty = replace(thing, means=means, opacities=opacities)
    field = field_of(dirty, np.zeros(len(dirty), np.int64))
    (match,) = locate(Answer.of(field, np.ones(len(field), np.float32), 0.5), dirty, link_distance=9.0, up=UP)
    assert len(match) == len(dirty)
    assert_allclose(match.extent, everything(thing.subset(np.arange(800, len(thing)))).extent, atol=1e-6)


def test_without_up_boxes_are_free():
    scene, labels = boxes_scene([(0, 0, 0)], turn=Rotation.from_euler("x", 40, degrees=True))
    field = field_of(scene, labels)
    assert field.up is None
    upright, free = (
        Scene(field, scene).locate(Answer.of(field, field.scores(unit(0)), 0.5), box=box)[0]
        for box in ("upright", "free")
    )
    assert_allclose(upright.axes, free.axes)
    known = replace(field, up=UP)
    standing = Scene(known, scene).locate(Answer.of(known, field.scores(unit(0)), 0.5))[0]
    assert_allclose(standing.axes[2], UP)


@pytest.mark.parametrize("up", ["[0, 0]", "[0, 0, 2]", '"z"', "[0, 0, 1e999]"])
def test_a_damaged_up_is_refused(tmp_path, up):
    scene, labels = boxes_scene([(0, 0, 0)])
    path = tmp_path / "a.field"
    replace(field_of(scene, labels), up=UP).save(path)
    text = (path / MANIFEST).read_text()
    start, end = text.index('"up": '), text.index("]", text.index('"up": ')) + 1
    (path / MANIFEST).write_text(f'{text[:start]}"up": {up}{text[end:]}')
    with pytest.raises((InputError, MismatchError, ValueError), match="up"):
        load_field(path)
