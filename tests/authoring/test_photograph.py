"""Pictures of splats without photos: poses, coverage, the capture, and what says that they are renderings."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.sparse import csc_array

from command_line import answer_of, error_of, text_of
from drsplat import Gaussians, View, ViewFeatures, load_image, read_sparse_points, read_views, register, render
from drsplat.authoring.filming.looking import looking_at
from drsplat.authoring.filming.paths import CameraPath, KeyFrame, write_path
from drsplat.authoring.photographing import candidates, taking
from drsplat.authoring.photographing.candidates import ENOUGH_SIGHTS, PhotographSettings, Sights, chosen_views, sights
from drsplat.authoring.photographing.space import Space
from drsplat.authoring.photographing.taking import guessed_up, photograph
from drsplat.drawing.pictures import as_pixels
from drsplat.errors import DrSplatWarning, FormatError, InputError
from drsplat.evaluation.report import html_page
from drsplat.evaluation.scorers import cosine_scorer
from drsplat.evaluation.tables import pictures_judged, pictures_note
from drsplat.field.evidence.aggregation.entries import canonical
from drsplat.field.registration import Registration
from drsplat.formats.colmap import read_colmap
from drsplat.formats.colmap_binary import write_colmap
from drsplat.formats.field_folder import MANIFEST
from drsplat.formats.gaussian_ply import write_gaussians
from drsplat.formats.moving_scenes import write_moving
from drsplat.formats.rendering_record import RECORD, read_rendering_record
from drsplat.formats.vocabulary import VocabularyEncoder
from drsplat.scene.gaussians import concatenated
from moving_scenes import still
from refusing import refused
from scenes import gaussians_at, random_gaussians

SMALL = PhotographSettings(number=6, size=(64, 48))
UP = np.array([0.0, 0.0, 1.0])
ROOM = np.array([4.0, 4.0, 2.4])  # from its middle on the floor: 4 across, 4 deep, 2.4 high
STEP = 0.2


@pytest.fixture(autouse=True)
def few_candidates(monkeypatch) -> None:
    """Choose from fewer cameras, which takes less time."""
    for name, count in (("MAX_PLACES", 12), ("NUM_TARGETS", 8), ("FAR_VIEWS", 16), ("NEAR_VIEWS", 3)):
        monkeypatch.setattr(candidates, name, count)


def coloured_at(points: np.ndarray, size: float = 0.1, opacity: float = 0.95) -> Gaussians:
    """Round Gaussians of random colours at some points."""
    sh = np.random.default_rng(0).normal(0, 0.5, (len(points), 1, 3)).astype(np.float32)
    return replace(gaussians_at(points, size, opacity=opacity), sh=sh)


def room() -> Gaussians:
    """A floor and four walls, and a block that stands in the middle."""
    across, up = np.arange(-2, 2.01, STEP), np.arange(0, ROOM[2] + 0.01, STEP)
    floor = np.stack(np.meshgrid(across, across, [0.0]), -1).reshape(-1, 3)
    side = np.stack(np.meshgrid(across, [2.0], up), -1).reshape(-1, 3)
    turned = side[:, [1, 0, 2]]
    block = np.stack(np.meshgrid(*[np.arange(-0.3, 0.31, STEP)] * 2, np.arange(0.2, 0.9, STEP)), -1).reshape(-1, 3)
    mirrored = [wall * signs for wall, signs in ((side, (1, -1, 1)), (turned, (-1, 1, 1)))]
    return coloured_at(np.concatenate([floor, side, turned, *mirrored, block]))


def thing(count: int = 200, **more: object) -> Gaussians:
    return replace(random_gaussians(count, extent=0.4, size=0.08), **more)


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


# --- the capture ---


@pytest.mark.slow
@pytest.mark.parametrize("scene", [room(), thing(), thing(antialiased=True)], ids=["room", "thing", "antialiased"])
def test_a_pose_that_is_read_again_renders_the_same_picture_to_the_bit(scene, tmp_path):
    photograph(scene, tmp_path / "capture", SMALL)
    views = read_views(tmp_path / "capture")
    assert len(views) == 6
    for view in views:
        assert (view.width, view.height) == SMALL.size
        assert_array_equal(load_image(view), as_pixels(render(scene, view).rgb))
        assert load_image(view).std() > 5  # something is in sight


def test_pictures_of_harmonics_change_with_the_direction(tmp_path):
    scene = random_gaussians(200, extent=0.4, size=0.08, sh_degree=3)
    photograph(scene, tmp_path / "capture", SMALL)
    view = read_views(tmp_path / "capture")[0]
    flat = replace(scene, sh=np.ascontiguousarray(scene.sh[:, :1]))
    assert (load_image(view) != as_pixels(render(flat, view).rgb)).any()
    assert_array_equal(load_image(view), as_pixels(render(scene, view).rgb))


def test_points_are_centres_of_gaussians_with_their_colours(tmp_path):
    scene = room()
    photograph(scene, tmp_path / "capture", SMALL)
    points = read_sparse_points(tmp_path / "capture")
    assert_array_equal(points.positions, scene.positions)
    expected = np.clip(0.5 + 0.28209479177387814 * scene.sh[:, 0], 0, 1)
    assert_allclose(points.colors / 255, expected, atol=0.51 / 255)


def test_a_written_model_is_read_as_it_was_planned(tmp_path):
    views = [
        replace(looking_at(np.array(eye, float), np.zeros(3), UP, (64, 48), fov), name=f"{fov:g}.png")
        for eye, fov in (((1, 2, 3), 40.0), ((-4, 1, 0.5), 40.0), ((0, 0, 5), 70.0))
    ]
    write_colmap(tmp_path, views, np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
    for written, found in zip(views, read_colmap(tmp_path), strict=True):
        assert (written.name, written.width, written.height) == (found.name, found.width, found.height)
        assert_array_equal(written.K, found.K)
        assert_allclose(written.cam_from_world, found.cam_from_world, atol=1e-14)
    bent = replace(views[0], distortion=(0.1, 0.0, 0.0, 0.0))
    with refused("only pinholes"):
        write_colmap(tmp_path, [bent], np.zeros((0, 3)), np.zeros((0, 3), np.uint8))


def test_colmaps_own_package_reads_the_model(tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    photograph(room(), tmp_path / "capture", SMALL)
    model = pycolmap.Reconstruction(str(tmp_path / "capture/sparse/0"))
    assert (len(model.images), len(model.points3D)) == (6, len(room()))
    for view in read_views(tmp_path / "capture"):
        image = next(image for image in model.images.values() if image.name == view.name)
        assert_allclose(image.projection_center(), view.center, atol=1e-9)


@pytest.mark.slow
def test_the_same_bytes_at_any_number_of_threads(tmp_path):
    for threads in (1, 2, 3):
        photograph(room(), tmp_path / f"{threads}", SMALL, threads=threads)
    one, two, three = (files_of(tmp_path / f"{threads}") for threads in (1, 2, 3))
    assert one == two == three
    assert {name.split("/")[0] for name in one} == {"images", "sparse", RECORD}


# --- poses ---


def test_cameras_of_a_room_stand_in_its_free_space(tmp_path):
    scene = room()
    record = photograph(scene, tmp_path / "capture", replace(SMALL, number=30))
    assert (record["kind"], record["up"]) == ("room", "+z")
    space = Space(scene, UP)
    for view in read_views(tmp_path / "capture"):
        assert (np.abs(view.center[:2]) < 2 - space.clearance).all()
        assert 0 < view.center[2] < ROOM[2]
        assert np.linalg.norm(scene.positions - view.center, axis=1).min() > space.clearance
        assert view.cam_from_world[1, 2] < 0  # +z is above in the picture


@pytest.mark.slow
def test_cameras_of_a_thing_are_around_it_and_look_at_it(tmp_path):
    record = photograph(thing(), tmp_path / "capture", replace(SMALL, number=40))
    assert record["kind"] != "room"
    views = read_views(tmp_path / "capture")
    turns = np.sort([np.arctan2(view.center[2], view.center[0]) for view in views])
    assert np.diff(turns, append=turns[0] + 2 * np.pi).max() < np.pi / 2  # -y is up
    assert min(np.linalg.norm(view.center) for view in views) > 0.4
    assert all(load_image(view).any() for view in views)


def test_a_place_is_free_where_no_gaussian_is_around_it_or_right_before_it():
    far = np.array([[10.0, 0, 0], [-10, 0, 0], [0, 10, 0], [0, -10, 0], [0, 0, 2]] * 4)
    wide = coloured_at(np.array([[0.0, 0.0, 0.0]]), size=3.0, opacity=0.9)
    space = Space(coloured_at(far, size=0.5), UP)
    assert space.surroundings(np.zeros(3)).is_free
    assert not space.surroundings(np.array([9.8, 0.0, 0.0])).is_free  # inside of one
    foggy = concatenated([space.gaussians, wide])
    assert not Space(foggy, UP).surroundings(np.array([0.0, 0.0, 1.0])).is_free  # within the haze of the wide one


def test_all_directions_of_a_closed_room_show_something_and_few_of_a_lonely_thing():
    across = np.arange(-1, 1.01, 0.1)
    faces = np.stack(np.meshgrid(across, across, [1.0]), -1).reshape(-1, 3)
    closed = [np.roll(faces * sign, shift, axis=1) for sign in (1, -1) for shift in range(3)]
    assert Space(coloured_at(np.concatenate(closed)), UP).surroundings(np.zeros(3)).enclosed == 1
    alone = Space(coloured_at(np.full((20, 3), 5.0), size=0.01), UP)
    assert alone.surroundings(np.zeros(3)).enclosed < 0.01


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [1, -1])
def test_up_is_away_from_the_floor_along_the_shortest_side(axis, sign):
    points = np.roll(room().means * (1, 1, sign), axis - 2, axis=1)
    expected = np.zeros(3)
    expected[axis] = sign
    assert_array_equal(guessed_up(coloured_at(points)), expected)


def test_up_of_a_scene_that_is_as_high_as_it_is_wide_is_that_of_colmap():
    assert_array_equal(guessed_up(thing()), [0, -1, 0])


# --- coverage ---


def seen_by_hand(weights: list[list[float]], smears: list[float] | None = None) -> Sights:
    """A row for each Gaussian, a column for each camera."""
    count = len(weights[0])
    views = [View(f"{n}", np.eye(3), np.eye(4), 2, 2) for n in range(count)]
    return Sights(views, csc_array(np.array(weights, float)), np.array(smears or [0.0] * count))


def test_coverage_is_the_share_that_three_pictures_show():
    seen = seen_by_hand(
        [
            [50, 40, 2, 0, 0],  # matters, in three
            [0, 30, 1, 0.9, 0],  # matters, in two: 0.9 of a pixel is too little
            [0, 0, 0, 0, 20],  # matters, in one
            [1.1, 1.1, 1.1, 1.1, 0],  # the last 1.1 of 101.1: what is before has 98.9 % of all
        ]
    )
    assert_array_equal(seen.significant, [True, True, True, False])
    every = seen.coverage(range(5))
    assert (every.significant, every.often, every.once, every.reachable) == (3, 1 / 3, 1.0, 1 / 3)
    some = seen.coverage([0, 1])
    assert (some.often, some.once, some.reachable) == (0.0, 2 / 3, 1 / 3)
    assert seen.coverage([]).once == 0


def test_the_camera_that_shows_most_that_is_new_comes_first():
    rows = [[9, 0, 0, 9], [9, 0, 0, 9], [9, 0, 0, 0], [0, 9, 9, 0]]
    chosen = chosen_views(seen_by_hand(rows), 4)
    assert chosen[0] == 0
    assert sorted(chosen) == [0, 1, 2, 3]
    assert chosen_views(seen_by_hand(rows), 2) == [0, 3]
    assert len(chosen_views(seen_by_hand(rows), 99)) == 4
    assert len(chosen_views(seen_by_hand(rows), None)) == 4


def test_smeared_cameras_are_left_out():
    seen = seen_by_hand([[9] * 10], [0.3, 0.1, 0.12, 0.15, 0.9, 0.95, 0.5, 0.1, 0.1, 0.1])
    assert [view.name for view in seen.sharp().views] == ["1", "2", "3", "7", "8", "9"]
    assert seen.sharp().pixels.shape == (1, 6)


def test_what_cameras_see_is_counted_in_pixels_of_the_pictures():
    """One opaque Gaussian far away: its weight is its alpha, summed over all pixels."""
    sigma, distance, opacity = 0.5, 10.0, 0.5
    spread = np.array([[0.0, 0.0, 0.0]] + [[400.0 + n, 0, 0] for n in range(16)])  # the others are behind the camera
    space = Space(coloured_at(spread, size=sigma, opacity=opacity), UP)
    view = looking_at(np.array([distance, 0.0, 0.0]), np.zeros(3), UP, (400, 400), 60.0)
    seen = sights(space, [view])
    radius = view.K[0, 0] * sigma / distance
    expected = opacity * 2 * np.pi * (radius**2 + 0.3)  # the kernel adds 0.3 of a pixel squared
    assert seen.pixels.toarray()[0, 0] == pytest.approx(expected, rel=0.05)
    assert np.count_nonzero(seen.pixels.toarray()[1:]) == 0
    assert seen.coverage([0]).significant == 1


@pytest.mark.slow
def test_more_pictures_cover_more_and_the_numbers_are_those_of_the_capture(tmp_path):
    scene = room()
    few, many = (photograph(scene, tmp_path / f"{n}", replace(SMALL, number=n)) for n in (4, 40))
    assert few["coverage"]["often"] < many["coverage"]["often"] <= many["coverage"]["reachable"]
    assert many["coverage"]["once"] > 0.9
    again = sights(Space(scene, UP), read_views(tmp_path / "40"))
    assert len(again.views) == many["num_pictures"] == 40
    counts = np.asarray((again.pixels >= 1).sum(axis=1)).reshape(-1)
    assert (counts >= ENOUGH_SIGHTS).mean() > 0.5


# --- refusals, and runs that are stopped ---


@pytest.mark.slow
def test_what_is_there_is_refused_and_replaced_only_if_it_is_ours(tmp_path):
    output = tmp_path / "capture"
    photograph(thing(), output, SMALL)
    before = files_of(output)
    with refused("exists already: pass overwrite=True"):
        photograph(thing(), output, SMALL)
    assert files_of(output) == before
    record = photograph(thing(150), output, replace(SMALL, number=3), overwrite=True)
    assert record["num_pictures"] == len(read_views(output)) == 3
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/notes.txt").write_text("keep")
    with refused("not ours to replace"):
        photograph(thing(), tmp_path / "mine", SMALL, overwrite=True)
    assert (tmp_path / "mine/notes.txt").read_text() == "keep"
    with refused("there is no folder"):
        photograph(thing(), tmp_path / "no/capture", SMALL)


@pytest.mark.slow
@pytest.mark.parametrize("overwrite", [False, True])
def test_a_run_that_is_stopped_leaves_what_was_there(overwrite, tmp_path, monkeypatch):
    output = tmp_path / "capture"
    if overwrite:
        photograph(thing(), output, SMALL)
    before = files_of(tmp_path)
    write = taking.write_picture

    def stopping(path, *rest):
        if path.name == "view_0004.png":
            raise KeyboardInterrupt
        write(path, *rest)

    monkeypatch.setattr(taking, "write_picture", stopping)
    with pytest.raises(KeyboardInterrupt):
        photograph(room(), output, SMALL, overwrite=overwrite)
    assert files_of(tmp_path) == before
    monkeypatch.undo()
    photograph(room(), output, SMALL, overwrite=overwrite)
    assert len(read_views(output)) == 6


@pytest.mark.parametrize(
    ("wish", "message"),
    [
        ({"number": 0}, "number: expected 1 to 10,000 pictures, got 0"),
        ({"size": (1, 48)}, "size: expected 2x2 to"),
        ({"fov_degrees": 180.0}, "fov: expected 1 to 170 degrees"),
        ({"up": (0.0, 0.0, 0.0)}, "up: expected a direction"),
        ({"up": (float("nan"), 0.0, 1.0)}, "up: expected a direction"),
        ({"background": (2.0, 0.0, 0.0)}, "background: expected red"),
    ],
)
def test_settings_that_cannot_be_are_refused(wish, message):
    with refused(message):
        PhotographSettings(**wish)


def test_scenes_that_cannot_be_photographed_are_refused(tmp_path):
    with refused("the scene has no Gaussians"):
        photograph(thing().subset(np.arange(0)), tmp_path / "capture")
    with refused("this scene stands still"):
        photograph(thing(), tmp_path / "capture", replace(SMALL, time=0.5))
    with refused("this scene moves: give one of 0 to 1"):
        photograph(still(thing()), tmp_path / "capture", SMALL)
    with pytest.raises(InputError):
        photograph(still(thing()), tmp_path / "capture", replace(SMALL, time=7.0))
    faint = replace(thing(), opacities=np.zeros(200, np.float32))
    with refused("no camera sees anything"):
        photograph(faint, tmp_path / "capture", SMALL)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_record_that_was_changed_is_not_believed(tmp_path):
    photograph(thing(), tmp_path / "capture", SMALL)
    path = tmp_path / "capture" / RECORD
    good = path.read_text()
    parts = ("fingerprint", '"time"', "num_pictures")
    changed = [good.replace(part, part.replace("e", "a", 1).replace("n", "m", 1)) for part in parts]
    for text in (*changed, "", "[]", "{}", '{"format": "drsplat photograph", "version": 2}', "\x00"):
        assert text != good
        path.write_text(text)
        with pytest.raises(FormatError):
            read_views(tmp_path / "capture")


# --- paths and times ---


def path_file(folder: Path, eyes: list[tuple[float, float, float]]) -> Path:
    keys = [KeyFrame.of(looking_at(np.array(eye), np.array([0.0, 0.0, 0.5]), UP, (64, 48), 50.0)) for eye in eyes]
    write_path(folder / "path.json", CameraPath(keys), overwrite=True)
    return folder / "path.json"


def test_pictures_along_a_path_are_those_of_a_film(tmp_path, capsys):
    write_gaussians(tmp_path / "room.ply", room())
    path = path_file(tmp_path, [(1.4, -1.4, 1.2), (1.4, 1.4, 1.4), (-1.4, 1.4, 1.2)])
    options = (tmp_path / "room.ply", "-o", tmp_path / "capture", "--size", "64x48")
    answer = answer_of(capsys, "photograph", *options, "--path", path, "--number", 5)
    assert (answer["kind"], answer["num_pictures"]) == ("path", 5)
    from drsplat.authoring.filming.paths import read_path

    for view, expected in zip(read_views(tmp_path / "capture"), read_path(path).views(5, (64, 48)), strict=True):
        assert_allclose(view.cam_from_world, expected.cam_from_world, atol=1e-12)
    orbit = answer_of(capsys, "photograph", *options, "--path", "swing", "--number", 4, "--up", "+z", "--overwrite")
    assert orbit["kind"] == "path"


def test_cameras_of_a_path_that_are_inside_of_gaussians_are_left_out(tmp_path):
    keys = [
        KeyFrame.of(looking_at(np.array(eye), np.array([0.0, 0.1, 0.6]), UP, (64, 48), 50.0))
        for eye in ((1.5, 0.0, 0.6), (-1.5, 0.0, 0.6))  # through the block
    ]
    with pytest.warns(DrSplatWarning, match="cameras of the path are inside of Gaussians"):
        record = photograph(room(), tmp_path / "capture", replace(SMALL, number=9), path=CameraPath(keys))
    assert 2 <= record["num_pictures"] < 9
    for view in read_views(tmp_path / "capture"):
        assert abs(view.center[0]) > 0.5
    inside = [KeyFrame.of(looking_at(np.array((x, 0.0, 0.5)), np.zeros(3), UP, (64, 48))) for x in (0.1, 0.2)]
    with refused("all 6 cameras of the path"):
        photograph(room(), tmp_path / "other", SMALL, path=CameraPath(inside))


def test_a_moving_scene_is_photographed_at_a_time_that_its_views_keep(tmp_path, capsys):
    write_moving(tmp_path / "film.motion", still(room()))
    line = ("photograph", tmp_path / "film.motion", "-o", tmp_path / "capture", "--size", "64x48", "--number", 3)
    assert "this scene moves" in error_of(capsys, *line)
    answer_of(capsys, *line, "--time", 0.5)
    views = read_views(tmp_path / "capture")
    assert [view.time for view in views] == [0.5] * 3
    made = register(still(room()), views, features_of(views))
    assert set(made.masks.times.tolist()) == {0.5}


# --- told apart from photos ---


def features_of(views: list[View]) -> dict[str, ViewFeatures]:
    """One mask for each picture, with its own direction."""
    return {
        view.name: ViewFeatures(
            np.zeros((view.height, view.width), np.int32), np.eye(4, dtype=np.float32)[[number % 4]]
        )
        for number, view in enumerate(views)
    }  # fmt: skip


def kinds_of(made: Registration, folder: Path) -> tuple[str, list[str]]:
    """What the manifest of a field says, once it is saved."""
    made.to_field().save(folder, overwrite=True)
    manifest = json.loads((folder / MANIFEST).read_text())
    return manifest["pictures"], manifest["rendered_from"]


def test_a_field_knows_which_of_its_views_are_renderings(tmp_path):
    scene = room()
    photograph(scene, tmp_path / "capture", SMALL, name="room.ply")
    views, source = read_views(tmp_path / "capture"), f"room.ply ({scene.fingerprint})"
    assert {view.rendered_from for view in views} == {source}
    photos = [replace(view, name=f"photo_{view.name}", rendered_from="") for view in views]
    of_photos, of_both = (register(scene, some, features_of(some)) for some in (photos, [*photos, *views]))
    of_renderings = register(scene, views, features_of(views))
    assert kinds_of(of_renderings, tmp_path / "a.field") == ("renderings", [source])
    assert kinds_of(of_photos, tmp_path / "b.field") == ("photos", [])
    assert kinds_of(of_both, tmp_path / "c.field") == ("photos and renderings", [source])
    merged = of_photos.merged(of_renderings)
    assert merged.masks.sources == of_both.masks.sources == ("",) * 6 + (source,) * 6
    assert canonical(merged.evidence).masks.sources == merged.masks.sources
    left = merged.without([view.name for view in views])
    assert left.masks.rendered_from == ()
    from drsplat import load_field

    assert load_field(tmp_path / "c.field").rendered_from == merged.masks.sources
    assert Registration.from_field(load_field(tmp_path / "c.field")).masks.sources == merged.masks.sources


@pytest.mark.slow
def test_renderings_are_called_so_by_all_that_is_made_of_them(tmp_path, capsys):
    scene, capture, field = tmp_path / "room.ply", tmp_path / "capture", tmp_path / "room.field"
    write_gaussians(scene, room())
    shown = text_of(capsys, "photograph", scene, "-o", capture, "--size", "96x72", "--number", 8)
    assert "8 renderings of 96x72, chosen from" in shown
    assert "Gaussians that matter are seen in three pictures" in shown.replace("\n", " ")
    facts = answer_of(capsys, "inspect", capture)
    source = facts["rendered_from"]
    assert (facts["pictures"], facts["num_photos"]) == ("renderings", 8)
    assert source == [f"room.ply ({room().fingerprint})"]
    models = ("--segmenter", "graph", "--encoder", "drsplat-mini")
    assert answer_of(capsys, "embed", capture, *models)["pictures"] == "renderings"
    features = capture / "language_features"
    assert json.loads((features / "embedding.json").read_text())["settings"]["rendered_from"] == source
    assert answer_of(capsys, "inspect", features)["rendered_from"] == source
    made = answer_of(capsys, "register", scene, capture, "--features", features, "-o", field)
    assert (made["pictures"], made["rendered_from"]) == ("renderings", source)
    assert answer_of(capsys, "inspect", field)["pictures"] == "renderings"
    listed = answer_of(capsys, "objects", field, "--scene", scene)
    assert (listed["pictures"], listed["rendered_from"]) == ("renderings", source)
    assert "renderings" in text_of(capsys, "objects", field, "--scene", scene)
    assert "8 renderings" in text_of(
        capsys, "register", scene, capture, "--features", features, "-o", tmp_path / "b.field"
    )


def test_the_report_of_an_evaluation_says_that_a_field_is_of_renderings(tmp_path):
    photograph(room(), tmp_path / "capture", SMALL)
    views = read_views(tmp_path / "capture")
    for some, kind in ((views, "renderings"), ([replace(view, rendered_from="") for view in views], "photos")):
        field = register(room(), some, features_of(some)).to_field()
        encoder = VocabularyEncoder(field.encoder, ("mug",), np.eye(1, 4, dtype=np.float32))
        about = dict(cosine_scorer(field, encoder).about)
        assert about["pictures"] == kind
        result = {"method": "cosine", "protocol": "p", "scenes": [{"inputs": {"scorer": about}}], "thresholds": {}}
        result["pictures"] = pictures_judged(result)
        assert result["pictures"] == kind
        page = html_page([result], [], [], [])
        assert ("its fields were made from renderings of the scenes" in page) == (kind == "renderings")
    both = {"scenes": [{"inputs": {"scorer": {"pictures": kind}}} for kind in ("renderings", "photos")]}
    assert pictures_judged(both) == "photos and renderings"
    assert pictures_judged({"scenes": [{"inputs": {}}]}) is None
    assert pictures_note({"method": "cosine"}) == ""


@pytest.mark.slow
def test_the_record_says_of_which_scene_by_what(tmp_path):
    photograph(thing(), tmp_path / "a", SMALL, name="thing.spz")
    record = read_rendering_record(tmp_path / "a")
    scene, settings = record["scene"], record["settings"]
    assert isinstance(scene, dict)
    assert isinstance(settings, dict)
    assert (scene["name"], scene["fingerprint"], scene["num_gaussians"]) == ("thing.spz", thing().fingerprint, 200)
    assert (record["num_pictures"], settings["size"], record["up_from"]) == (6, [64, 48], "scene")
    other = photograph(replace(thing(), sh=thing().sh + np.float32(0.1)), tmp_path / "b", SMALL)
    assert other["scene"]["fingerprint"] == scene["fingerprint"]
    assert other["scene"]["checksum"] != scene["checksum"]  # another picture
    assert read_rendering_record(tmp_path) is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--path", "photos"), "there are no photos to go through"),
        (("--path", "no.json"), "there is no such file"),
        (("--path", "orbit", "--fov", "40"), "a path has its own lens"),
        (("--fov", "0.5"), "fov: expected 1 to 170 degrees"),
        (("--time", "1"), "this scene stands still"),
    ],
)
def test_options_that_do_not_go_together_are_refused(options, message, tmp_path, capsys):
    write_gaussians(tmp_path / "thing.ply", thing())
    assert message in error_of(capsys, "photograph", tmp_path / "thing.ply", "-o", tmp_path / "out", *options)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("options", [("--up", "w"), ("--up", "1,2"), ("--up", "a,b,c"), ("--number", "0")])
def test_options_that_are_none_are_misuse(options, tmp_path, capsys):
    error_of(capsys, "photograph", tmp_path / "thing.ply", "-o", tmp_path / "out", *options, code=2)


def test_up_may_be_three_numbers(tmp_path, capsys):
    write_gaussians(tmp_path / "thing.ply", thing())
    line = ("photograph", tmp_path / "thing.ply", "-o", tmp_path / "out", "--size", "32x24", "--number", 2)
    answer = answer_of(capsys, *line, "--up=0,-3,4")
    assert (answer["up"], answer["up_from"]) == ("0.000 -0.600 0.800", "settings")
