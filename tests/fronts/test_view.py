"""The viewer without a browser: what is shown, picked, painted, asked, changed and saved."""

import io
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from drsplat import read_gaussians, write_gaussians
from drsplat.authoring.editing import Recolour, Remove
from drsplat.authoring.filming import looking
from drsplat.drawing.heat import heat_of
from drsplat.fronts.viewing import client, naming, painting, saving, shown
from drsplat.fronts.viewing.bare import is_bare, open_bare
from drsplat.fronts.viewing.session import Mode, Session
from drsplat.query import Scene
from drsplat.query.suggesting import suggestions
from refusing import refused
from scenes import look_at_view, random_gaussians
from viewing_scenes import EACH, THINGS, boxes_scene

UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture
def session() -> Session:
    return Session(boxes_scene(), words=THINGS)


def rows(thing: int) -> np.ndarray:
    return np.arange(thing * EACH, (thing + 1) * EACH)


# --- what is shown ---


def test_above_the_budget_the_most_significant_are_shown_and_it_is_said():
    scene = random_gaussians(500)
    part = shown.shown_of(scene, 100)
    weight = scene.opacities * scene.scales.astype(np.float64).prod(1) ** 0.1
    rest = np.setdiff1d(np.arange(500), part.ids)
    assert len(part) == 100
    assert weight[part.ids].min() >= weight[rest].max()
    assert "100" in part.summary
    assert "500" in part.summary


@settings(max_examples=20)
@given(st.floats(-4, 4), st.integers(0, 5))
def test_any_size_of_scene_keeps_its_covariances_in_float16(power, seed):
    scene = random_gaussians(300, seed, size=0.02)
    factor = np.float32(10.0**power)
    grown = replace(scene, means=scene.means * factor, scales=scene.scales * factor)
    one, other = shown.shown_of(scene, 300), shown.shown_of(grown, 300)
    assert_allclose(one.centers, other.centers, rtol=1e-3, atol=1e-3)
    assert_allclose(one.covariances, other.covariances, rtol=1e-3, atol=1e-6)
    variances = one.covariances[:, [0, 3, 5]]
    halves = variances.astype(np.float16).astype(np.float32)
    assert np.abs(halves / variances - 1).max() < 0.05


@pytest.mark.parametrize(("count", "budget"), [(0, 5), (5, 0)])
def test_nothing_to_show_is_said(count, budget):
    with refused("nothing to show"):
        shown.shown_of(random_gaussians(5).subset(np.arange(count)), budget)


def test_what_is_too_far_for_float32_stays_finite():
    scene = random_gaussians(200)
    means = scene.means.copy()
    means[7] = [3e38, -3e38, 0]
    part = shown.shown_of(replace(scene, means=means), 200)
    assert np.isfinite(part.centers).all()
    assert np.abs(part.centers[7]).max() > 1e38


# --- colours ---


@given(st.tuples(*[st.floats(0, 1, width=32)] * 3))
def test_what_was_found_keeps_its_colour(color):
    rgb = np.array([color], np.float32)
    assert_array_equal(painting.highlighted(rgb, np.zeros(1, np.int32), [painting.accent(0)]), rgb)


def test_blue_stays_blue_and_stands_out_of_the_rest():
    blue = np.array([[0.1, 0.25, 0.7]] * 2, np.float32)
    found, rest = painting.highlighted(blue, np.array([0, -1], np.int32), [painting.accent(0)])
    assert_array_equal(found, blue[0])
    assert np.ptp(rest) < 0.2 * np.ptp(found)
    assert rest.max() < 0.5 * found.max()


def test_nothing_goes_black_and_where_nothing_fits_all_stays_as_it_is(session):
    assert painting.dimmed(np.zeros((1, 3), np.float32)).min() >= 0.08
    session.ask("elephant")
    assert_array_equal(session.colors, shown.base_colors(session.scene.gaussians))


# --- picking ---


def ray(origin: tuple[float, float, float], direction: tuple[float, float, float]) -> naming.Ray:
    return naming.ray_along(np.array(origin, np.float64), np.array(direction, np.float64))


def test_a_ray_meets_what_is_in_front():
    scene = boxes_scene().gaussians
    hit = naming.hit_by_ray(scene, ray((-3.0, 0, 0), (1.0, 0, 0)))
    assert hit.gaussian_ids[0] in rows(0)
    assert (np.diff(hit.weights) <= 0).all()
    assert 0 < hit.weights.sum() <= 1
    back = naming.hit_by_ray(scene, ray((3.0, 0, 0.3), (-1.0, 0, 0)))
    assert back.gaussian_ids[0] in rows(2)


def test_a_ray_passes_what_is_hidden_and_what_lies_behind_it():
    scene = boxes_scene().gaussians
    visible = np.ones(len(scene), bool)
    visible[rows(0)] = False
    hit = naming.hit_by_ray(scene, ray((-3.0, 0, 0), (1.0, 0, 0)), visible)
    assert hit.gaussian_ids[0] in rows(1)
    away = naming.hit_by_ray(scene, ray((-9.0, 0, 0), (-1.0, 0, 0)))
    assert away is None


def test_a_ray_weighs_as_the_renderer_does_far_away():
    """From afar a pixel is a ray: the same Gaussian dominates, for needles and discs too."""
    from drsplat.kernels import splat_arrays, topk_contributions

    scene = random_gaussians(400, 2, size=0.3)
    view = look_at_view((0.0, -40.0, 0.0), width=64, height=64, fov_degrees=6)
    best = topk_contributions(splat_arrays(scene), view, 1)
    same = 0
    for row, column in np.argwhere(best.weights[..., 0] > 0.6)[::7]:
        pixel = np.linalg.solve(view.K, [column + 0.5, row + 0.5, 1.0])
        direction = view.cam_from_world[:3, :3].T @ pixel
        hit = naming.hit_by_ray(scene, naming.ray_along(view.center, direction))
        same += hit is not None and hit.gaussian_ids[0] == best.ids[row, column, 0]
    total = len(np.argwhere(best.weights[..., 0] > 0.6)[::7])
    assert total > 20
    assert same >= 0.9 * total


# --- cameras ---


def test_a_camera_looks_at_its_target_with_up_upwards():
    eye, target = np.array([3.0, -2.0, 1.5]), np.array([0.2, 0.1, 0.3])
    view = looking.looking_at(eye, target, UP, (320, 240), 50.0)
    pixel = view.K @ (view.cam_from_world[:3, :3] @ target + view.cam_from_world[:3, 3])
    assert_allclose(pixel[:2] / pixel[2], (160, 120))
    assert_allclose(view.center, eye)
    assert (view.cam_from_world[:3, :3] @ UP)[1] < 0  # +y is down


def test_a_camera_can_look_straight_down_but_not_at_itself():
    view = looking.looking_at(np.array([0, 0, 5.0]), np.zeros(3), UP, (32, 32))
    assert_allclose(view.cam_from_world[2, :3], (0, 0, -1), atol=1e-9)
    with refused("where it stands"):
        looking.looking_at(np.ones(3), np.ones(3), UP, (32, 32))


def test_up_is_what_the_photos_call_up():
    views = [look_at_view((np.cos(a), np.sin(a), 0.5)) for a in np.linspace(0, 6, 9)]
    field = boxes_scene().field
    assert_allclose(looking.up_direction(Scene(field, views=views)), UP, atol=1e-12)
    assert_array_equal(looking.up_direction(Scene(field)), (0, -1, 0))
    leaning = np.array([0.1, 0.0, np.sqrt(0.99)])  # as the field has it, so its boxes stand: not along the nearest axis
    assert_array_equal(looking.up_direction(Scene(replace(field, up=leaning), views=views)), leaning)
    assert_array_equal(looking.named_up("-y"), (0, -1, 0))
    assert_array_equal(looking.named_up("z"), (0, 0, 1))
    with refused("expected one of"):
        looking.named_up("w")


def test_a_flight_is_a_loop_at_one_height_and_distance():
    eye, target = np.array([2.0, 0, 1]), np.array([0.0, 0, 0.5])
    places = np.array(looking.swing(eye, target, UP, 24))
    assert_allclose(places[0], eye)
    assert_allclose(np.linalg.norm(places - target, axis=1), np.linalg.norm(eye - target))
    assert_allclose(places[:, 2], 1)
    assert np.abs(np.diff(np.vstack([places, places[:1]]), axis=0)).max() < 0.4
    with refused("two frames"):
        looking.swing(eye, target, UP, 1)


def test_the_place_before_a_thing_sees_all_of_it(session):
    session.ask("tall lamp")
    thing, scene = session.results[0].matches[0], session.scene
    eye = looking.before(thing, scene.gaussians, scene.views, UP)
    view = looking.looking_at(eye, thing.center, UP, (200, 200))
    points = scene.gaussians.means[thing.gaussian_ids] @ view.cam_from_world[:3, :3].T
    pixels = (points + view.cam_from_world[:3, 3]) @ view.K.T
    at = pixels[:, :2] / pixels[:, 2:]
    assert (pixels[:, 2] > 0).all()
    assert ((at > 0) & (at < 200)).all()


# --- painting ---


def test_heat_is_a_half_at_the_threshold_and_rises_with_the_value():
    values = np.linspace(-0.2, 0.6, 101).astype(np.float32)
    heat = heat_of(values, 0.4)
    assert (np.diff(heat) >= 0).all()
    assert heat[0] == 0
    assert heat[-1] == 1
    assert_allclose(heat[np.abs(values - 0.4).argmin()], 0.5, atol=0.01)


def test_where_nothing_is_found_nothing_is_hot():
    assert heat_of(np.linspace(0, 0.3, 50).astype(np.float32), 0.5).max() < 0.5
    assert np.isfinite(heat_of(np.zeros(4, np.float32), 0.0)).all()


def test_what_is_not_meant_has_half_its_light_and_little_colour():
    rgb = default_rng(1).random((100, 3)).astype(np.float32)
    dimmed = painting.dimmed(rgb)
    assert_allclose(dimmed @ painting.LUMA, 0.08 + 0.52 * (rgb @ painting.LUMA), atol=1e-5)
    assert_allclose(np.ptp(dimmed, axis=1), 0.52 * 0.28 * np.ptp(rgb, axis=1), atol=1e-5)


def test_features_of_one_thing_have_one_colour_and_others_another(session):
    session.mode = Mode.FEATURES
    colors = session.colors
    means = np.array([colors[rows(thing)].mean(0) for thing in range(3)])
    assert max(colors[rows(thing)].std(0).max() for thing in range(3)) < 0.02
    apart = np.linalg.norm(means[:, None] - means, axis=2)[np.triu_indices(3, 1)]
    assert apart.min() > 0.3


# --- asking ---


# --- changing and saving ---


def test_hidden_is_not_met_not_shown_and_not_saved(session, tmp_path):
    session.ask("red mug")
    session.edit(Remove())
    assert (session.edits.everything.opacities[rows(0)] == 0).all()
    assert not len(session.selection)
    count = saving.save_scene(tmp_path / "rest.ply", session)
    assert count == len(session.scene.gaussians) - EACH == len(read_gaussians(tmp_path / "rest.ply"))
    session.restore()
    assert (session.edits.everything.opacities == session.scene.gaussians.opacities).all()


def test_a_selection_is_saved_alone_and_in_its_new_colour(session, tmp_path):
    session.ask("red mug")
    session.edit(Recolour((0, 1, 0)))
    saving.save_scene(tmp_path / "mug.ply", session, selected_only=True)
    saved = read_gaussians(tmp_path / "mug.ply")
    assert len(saved) == EACH
    rgb = shown.base_colors(saved)
    assert (rgb[:, 1] >= rgb[:, 0]).all()
    assert_allclose(rgb[:, [0, 2]], 0, atol=1e-6)


def test_a_flight_is_an_endless_gif(session):
    session.ask("tall lamp")
    eye, target = np.array([3.0, -3, 2]), np.zeros(3)
    film = Image.open(io.BytesIO(saving.flight_gif(session, eye, target, UP, frames=4)))
    assert film.n_frames == 4
    assert film.info["loop"] == 0


def test_a_session_saves_so_many_files_and_never_over_another(tmp_path):
    (tmp_path / "found.ply").symlink_to(tmp_path / "nowhere")
    saves = saving.Saves(tmp_path, most_files=2)
    for expected in ("found-2.ply", "found-3.ply"):
        path, data = saves.save("found", ".ply", lambda path: path.write_bytes(b"xy"))
        assert (path.name, data) == (expected, b"xy")
    with refused("saved enough"):
        saves.save("found", ".ply", lambda path: path.write_bytes(b""))
    assert not (tmp_path / "nowhere").exists()
    assert (tmp_path / "found.ply").is_symlink()


def test_a_session_saves_so_many_bytes(tmp_path):
    saves = saving.Saves(tmp_path, most_bytes=3)
    for _ in range(2):
        saves.save("found", ".ply", lambda path: path.write_bytes(b"xy"))
    with refused("saved enough"):
        saves.save("found", ".ply", lambda path: path.write_bytes(b""))


# --- texts of strangers ---


def test_no_text_of_a_stranger_is_more_than_text():
    hostile = "<img src=x onerror=alert(1)>&\udcff\x1b[2J\u202e\n"
    assert client.escaped(hostile) == "&lt;img src=x onerror=alert(1)&gt;&amp;" + "\ufffd" + "\ufffd[2J" + 2 * "\ufffd"
    assert client.printable("é 日本 🍎") == "é 日本 🍎"
    assert len(client.printable("x" * 10_000)) == client.MAX_CHARACTERS_SHOWN


# --- what to ask ---


def test_what_is_suggested_is_found(session):
    suggested = suggestions(session.scene, ("elephant", *THINGS, "green sofa"))
    assert suggested
    assert set(suggested) <= set(THINGS)
    assert all(session.scene.locate(word) for word in suggested)
    assert suggestions(session.scene, suggested, most=1) == suggested[:1]


# --- a scene without a field ---


def test_a_scene_without_a_field_can_be_looked_at_and_saved_and_says_why_it_is_silent(tmp_path):
    scene = random_gaussians(50)
    write_gaussians(tmp_path / "plain.ply", scene)
    bare = Session(open_bare(tmp_path / "plain.ply"))
    assert not bare.is_askable
    with refused("no field"):
        bare.ask("red mug")
    for mode in Mode:
        bare.mode = mode
        assert bare.colors.shape == (50, 3)
    assert bare.click(np.array([0.0, 0.0, -9.0]), np.array([0.0, 0.0, 1.0])) is None
    assert saving.save_scene(tmp_path / "again.ply", bare) == 50
    assert_array_equal(read_gaussians(tmp_path / "again.ply").means, scene.means)


def test_a_trained_model_is_bare_until_it_has_a_field(tmp_path):
    folder = tmp_path / "point_cloud/iteration_7"
    folder.mkdir(parents=True)
    write_gaussians(folder / "point_cloud.ply", random_gaussians(50))
    assert is_bare(tmp_path)
    assert len(open_bare(tmp_path).gaussians) == 50
    (tmp_path / "room.field").mkdir()
    assert not is_bare(tmp_path)
    assert not is_bare(tmp_path / "nothing")
