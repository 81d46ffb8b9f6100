"""The pictures of a film, what is drawn over them, and `drsplat render --path` as people call it."""

import json
import shutil
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image
from test_film_paths import nerfstudio_file

from command_line import answer_of, error_of, text_of
from drsplat import Gaussians, Query, cli, render
from drsplat.authoring.filming.frames import Film, Highlight
from drsplat.authoring.filming.looking import looking_at
from drsplat.drawing import labels
from drsplat.drawing.labels import Mark, lines_of, marked, plates_of
from drsplat.drawing.pictures import as_pixels, titled
from drsplat.formats.annotations import AnnotationFile
from drsplat.query.sheets import attribute_row
from drsplat.scene.labelled import Annotation
from drsplat.scene.moving import Moving
from drsplat.scene.views import View
from refusing import refused
from scenes import look_at_view, random_gaussians
from toy_capture import write_toy_capture
from viewing_scenes import EACH, boxes_scene

UP = np.array([0.0, 0.0, 1.0])
SIZE = (96, 72)
PINK = np.array((255, 64, 160))


def front(distance: float = 4.0, size: tuple[int, int] = SIZE) -> View:
    return looking_at(np.array([0.0, -distance, 0.0]), np.zeros(3), UP, size, 45.0)


def pixels_near(picture: np.ndarray, color: np.ndarray, tolerance: int = 12) -> np.ndarray:
    """(row, column) of those of a colour."""
    return np.argwhere((np.abs(picture.astype(int) - color) <= tolerance).all(-1))


# --- labels ---


def plates(things: list[tuple[float, ...]], count: int, size: tuple[int, int] = (320, 240)) -> np.ndarray:
    return np.array(plates_of([np.array(one, float) for one in things], [(60.0, 14.0)] * count, 4.0, size))


def is_free(boxes: np.ndarray) -> bool:
    shared = np.minimum(boxes[:, None, 2:], boxes[None, :, 2:]) - np.maximum(boxes[:, None, :2], boxes[None, :, :2])
    return int((shared > 0).all(-1).sum()) == len(boxes)


def test_names_make_room_for_each_other():
    assert np.array_equal(plates([(100, 100, 140, 120)], 1), [[90, 82, 150, 96]])
    same = plates([(100, 100, 140, 120)] * 8, 8)
    assert is_free(same)
    assert np.abs(same - same[0]).max() < 90  # all of them near by
    assert is_free(plates([(0, 0, 30, 8)] * 4, 4))  # in a corner
    assert np.array_equal(plates([(40, 40, 60, 60), (240, 180, 260, 200)], 2)[1], [220, 162, 280, 176])


def test_names_stay_within_the_picture_when_there_is_no_room():
    found = plates([(20, 10, 30, 20)] * 12, 12, (70, 30))
    assert (found >= 0).all()
    assert (found <= [70, 30, 70, 30]).all()
    assert len(plates([(100, 100, 140, 120)] * 300, 300)) == 300


@pytest.mark.parametrize("extent", [1e-300, 1e20, 1e30])
def test_a_box_of_any_size_is_drawn_without_a_fault(extent):
    view = look_at_view((0, -3, 0), (0, 0, 0), width=96, height=72)
    box = Mark("box", np.full(3, 0.1), np.full(3, extent), np.eye(3))
    far = Mark("far", np.array([extent, -extent, extent]))
    spots = np.array(lines_of(box, view)).reshape(-1, 2)
    assert np.isfinite(spots).all()
    assert ((spots >= 0) & (spots <= (96, 72))).all()
    assert marked(np.zeros((72, 96, 3), np.uint8), view, [box, far]).shape == (72, 96, 3)


def test_a_picture_larger_than_memory_is_refused_before_it_is_made():
    view = look_at_view((0, -3, 0), (0, 0, 0), width=60_000, height=60_000)
    with refused(r"expected up to 134,217,728 pixels, got 60000x60000: .* max_side=PIXELS"):
        render(random_gaussians(3), view)


def test_a_title_and_its_note_do_not_meet():
    """Black letters on the left, grey ones on the right, a gap between them."""
    for title in ("duplicate, recolour", "a very long name of a thing that no strip has room for"):
        strip = titled(np.zeros((60, 180, 3), np.uint8), title, "+1,665 Gaussians")[:28].min(axis=(0, 2)) < 200
        inked = np.flatnonzero(strip)
        assert inked[0] > 3
        assert inked[-1] < 177
        assert np.diff(inked).max() >= 8


def test_a_box_is_drawn_where_its_corners_are():
    """The front face of a cube of 1 at a distance of 4 - 0.5, through a lens of 45 degrees on 72 pixels."""
    focal = 36 / np.tan(np.radians(22.5))
    half = 0.5 * focal / 3.5
    lines = np.array(lines_of(Mark("", np.zeros(3), np.ones(3)), front())).reshape(-1, 2)
    assert len(lines) == 24
    assert_allclose(lines.min(0), (48 - half, 36 - half), atol=1e-9)
    assert_allclose(lines.max(0), (48 + half, 36 + half), atol=1e-9)
    pink = pixels_near(marked(np.zeros((72, 96, 3), np.uint8), front(), [Mark("", np.zeros(3), np.ones(3))]), PINK)
    assert_allclose(pink.min(0), (36 - half, 48 - half), atol=1)
    assert_allclose(pink.max(0), (36 + half, 48 + half), atol=1)


def test_a_turned_box_and_a_point_follow_the_camera():
    turned = np.array([[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    mark = Mark("", np.array([0.3, 0.2, 0.1]), np.array([0.5, 0.2, 0.1]), turned)
    view = looking_at(np.array([1.0, -3.0, 0.5]), np.zeros(3), UP, SIZE)
    corner = mark.center + 0.25 * turned[0] - 0.1 * turned[1] + 0.05 * turned[2]
    seen = view.K @ (view.cam_from_world[:3, :3] @ corner + view.cam_from_world[:3, 3])
    ends = np.array(lines_of(mark, view)).reshape(-1, 2)
    assert np.linalg.norm(ends - seen[:2] / seen[2], axis=1).min() < 1e-9
    ((one, other),) = lines_of(Mark("", np.zeros(3)), view)
    assert one == other == pytest.approx((48, 36))


def test_what_is_behind_the_camera_or_beside_the_picture_is_not_drawn():
    black = np.zeros((72, 96, 3), np.uint8)
    away = [Mark("gone", np.array([0.0, -9.0, 0.0]), np.ones(3)), Mark("gone", np.array([50.0, 0.0, 0.0]), np.ones(3))]
    away.append(Mark("gone", np.array([0.0, -9.0, 0.0])))
    for mark in away:
        assert lines_of(mark, front()) == []
        assert not marked(black, front(), [mark]).any()


def test_a_box_about_the_camera_is_cut_at_the_near_plane():
    """Its four edges along the line of sight leave the picture; none turns over to the other side."""
    mark = Mark("room", np.zeros(3), np.array([2.0, 20.0, 2.0]))
    lines = np.array(lines_of(mark, front()))
    assert len(lines) >= 4
    assert (lines >= -1e-6).all()
    assert (lines <= np.array(SIZE) + 1e-6).all()
    back = np.array(lines_of(Mark("", np.array([0.0, 5.0, 0]), np.array([2.0, 10.0, 2.0])), front())).reshape(-1, 2)
    assert np.abs(back - (48, 36)).max() <= 48 + 1e-6
    assert marked(np.zeros((72, 96, 3), np.uint8), front(), [mark]).any()


@pytest.mark.parametrize("paper", [0, 255])
def test_a_name_is_legible_on_black_and_white_and_stays_in_the_picture(paper):
    blank = np.full((240, 320, 3), paper, np.uint8)
    for place in (np.zeros(3), np.array([-1.9, 0, 1.4]), np.array([2.2, 0, 0.0])):
        picture = marked(blank, front(size=(320, 240)), [Mark("red\nmug " + 5 * "w", place, np.full(3, 0.3))])
        plate = pixels_near(picture, np.array((20, 22, 27)), 3)
        assert len(plate) > 300
        letters = picture[plate[:, 0].min() : plate[:, 0].max(), plate[:, 1].min() : plate[:, 1].max()]
        assert len(pixels_near(letters, PINK, 40)) > 60
    faint = marked(blank, front(size=(320, 240)), [Mark("mug", np.zeros(3))], share=0.5)
    whole = marked(blank, front(size=(320, 240)), [Mark("mug", np.zeros(3))])
    assert_allclose(faint, (blank.astype(float) + whole) / 2, atol=1)
    assert marked(blank, front(size=(320, 240)), [Mark("mug", np.zeros(3))], share=0.0) is blank


def test_names_behind_other_names_are_not_drawn(monkeypatch):
    """Thousands at one place took a minute; the picture is the same to the bit."""
    rng = np.random.default_rng(5)
    marks = [Mark(f"name {number}", rng.uniform(-0.4, 0.4, 3)) for number in range(600)]
    blank, view = np.zeros((72, 96, 3), np.uint8), front()
    drawn = []
    draw = labels._draw_name
    monkeypatch.setattr(
        labels, "_draw_name", lambda pen, mark, *rest: (drawn.append(mark.text), draw(pen, mark, *rest))
    )
    picture, few = marked(blank, view, marks), len(drawn)
    assert 10 < few < 300
    monkeypatch.setattr(labels, "_in_sight", lambda far, *_: far)
    assert_array_equal(marked(blank, view, marks), picture)
    assert len(drawn) == few + 600
    monkeypatch.undo()
    monkeypatch.setattr(labels, "_draw_name", lambda _, mark, *__: drawn.append(mark.text))
    drawn.clear()
    marked(blank, view, [Mark("one", np.zeros(3))] * 600)
    assert len(drawn) < 100


# --- pictures ---


@pytest.fixture(scope="module")
def answer() -> Highlight:
    return Highlight.of(boxes_scene(), Query("red mug"), boxes=True)


def views_of(count: int, size: tuple[int, int] = SIZE) -> list[View]:
    return [front(3.0 + 0.05 * number, size) for number in range(count)]


def test_an_answer_fades_in(answer):
    """Of 3 seconds, the first half is as it is; then it comes, and from the first second on it is all there."""
    scene, views = boxes_scene().gaussians, views_of(30)
    film = Film(scene, views, 10.0, answer, threads=1)
    seen = list(film.pictures())
    assert len(seen) == 30
    plain = [as_pixels(render(scene, view, threads=1).rgb) for view in views]
    drawn = render(scene, views[-1], values=answer.values, threads=1)
    for number in range(6):
        assert_array_equal(seen[number], plain[number])
    apart = [float(np.abs(one.astype(float) - other).mean()) for one, other in zip(seen, plain, strict=True)]
    assert 0 < apart[6] < apart[7] < apart[9]
    assert_array_equal(seen[-1], answer.over(drawn, plain[-1], views[-1], 1.0))
    assert len(pixels_near(seen[-1], PINK)) > 20
    assert answer.num_selected == EACH


def test_a_film_is_the_same_to_the_bit_for_any_number_of_threads(answer):
    scene = boxes_scene().gaussians
    one, two = (list(Film(scene, views_of(4), 1.0, answer, threads=threads).pictures()) for threads in (1, 2))
    assert_array_equal(one, two)


def test_side_by_side_is_without_and_with_the_answer(answer):
    scene, views = boxes_scene().gaussians, views_of(8)
    film = Film(scene, views, 1.0, answer, scene, threads=1)
    assert film.size == (192, 72)
    alone = list(Film(scene, views, 1.0, answer, threads=1).pictures())[-1]
    last = list(film.pictures())[-1]
    assert_array_equal(last[:, :95], as_pixels(render(scene, views[-1], threads=1).rgb)[:, :95])
    assert_array_equal(last[:, 97:], alone[:, 1:])
    other = random_gaussians(50)
    beside = next(Film(scene, views, 1.0, None, other, threads=1).pictures())
    assert_array_equal(beside[:, :95], as_pixels(render(other, views[0], threads=1).rgb)[:, :95])


@dataclass
class Sliding:
    """Moves along x by its time."""

    canonical: Gaussians

    def at(self, time: float) -> Gaussians:
        return replace(self.canonical, means=self.canonical.means + np.float32([time, 0, 0]))


def test_time_runs_and_boxes_go_with_what_moves():
    scene = boxes_scene()
    only = Highlight.of(scene, Query("blue mug"), boxes=True)
    moving = Moving(scene.gaussians, np.array([0.0, 0.5, 1.0]), Sliding(scene.gaussians))
    view = front(6.0, (320, 240))
    film = Film(moving, [view] * 12, 1.0, only, threads=1)
    seen = list(film.pictures())
    focal = view.K[0, 0]
    assert_array_equal(seen[0], as_pixels(render(scene.gaussians, view, threads=1).rgb))
    for number in (8, 11):
        outline = pixels_near(seen[number], PINK)
        middle = (outline[:, 1].min() + outline[:, 1].max()) / 2
        assert middle == pytest.approx(160 + focal * (number / 11) / 6.0, abs=4)


def test_heat_is_warm_where_it_fits():
    scene = boxes_scene()
    warm = Highlight.of(scene, Query("tall lamp"), heat=True)
    assert warm.is_heat
    assert warm.values[2 * EACH : 3 * EACH].min() > 0.9
    picture = list(Film(scene.gaussians, [front(5.0)] * 5, 1.0, warm, threads=1).pictures())[-1]
    red, _, blue = np.moveaxis(picture.astype(int), -1, 0)
    rows, columns = np.nonzero(red > blue + 60)
    assert len(rows) > 20
    assert columns.mean() > 55  # the lamp is on the right


def test_what_cannot_be_filmed(answer):
    with refused("got none"):
        Film(boxes_scene().gaussians, [], 1.0)
    with refused("the scene has 7"):
        Film(random_gaussians(7), views_of(2), 1.0, answer)


# --- one thing by its attributes ---


def test_attributes_of_one_thing_are_a_row_of_heat_maps():
    """The red mug is warm for its own name and for what shares a word with it, and cold for the lamp."""
    scene = boxes_scene()
    thing = scene.locate("red mug")[0]
    row = attribute_row(scene, thing, ["red mug", "tall lamp"])
    wide = (row.shape[1] - 14) // 3
    own, other = row[:, 14 + wide : 2 * wide], row[:, 14 + 2 * wide : 3 * wide]
    reddish = [((part[..., 0].astype(int) - part[..., 2]) > 60).mean() for part in (own, other)]
    assert reddish[0] > 0.01
    assert reddish[0] > 2 * reddish[1]
    with refused("1 to 12 words, got 0"):
        attribute_row(scene, thing, [])


# --- the command ---


@pytest.fixture(scope="module")
def room(tmp_path_factory) -> Path:
    folder = write_toy_capture(tmp_path_factory.mktemp("films"))
    argv = ["register", "scene.ply", "capture", "--features", "capture/language_features"]
    argv += ["--encoder-name", "drsplat-words", "-o", "room.field"]
    subprocess.run([sys.executable, "-m", "drsplat", *argv], cwd=folder, check=True)
    return folder


def called(room: Path, *more: object) -> list[object]:
    return ["render", room / "scene.ply", "--views", room / "capture", *more]


def film_of(path: str) -> list[np.ndarray]:
    pictures = []
    with Image.open(path) as film:
        for number in range(film.n_frames):
            film.seek(number)
            pictures.append(np.asarray(film.convert("RGB")))
    return pictures


def test_a_film_from_the_command_line(room, tmp_path, capsys):
    argv = called(room, "--path", "orbit", "--field", room / "room.field", "--query", "red mug", "--boxes")
    argv += ["--fps", 5, "--seconds", 2, "--size", "64x48", "-o", tmp_path / "film.webp"]
    report = answer_of(capsys, *argv)
    assert (report["num_frames"], report["fps"], report["size"], report["film_seconds"]) == (10, 5, [64, 48], 2.0)
    assert (report["num_matches"], report["num_selected"]) == (1, 150)
    assert report["bytes"] == (tmp_path / "film.webp").stat().st_size
    seen = film_of(report["file"])
    assert len(seen) == 10
    assert len(pixels_near(seen[-1], PINK, 90)) > len(pixels_near(seen[0], PINK, 90)) + 5
    assert "exists already: pass --overwrite" in error_of(capsys, *argv)
    assert "10 pictures of 64x48" in text_of(capsys, *argv, "--overwrite")


@pytest.mark.parametrize("around", ["match", "scene"])
def test_a_swing_around_what_was_found(around, room, tmp_path, capsys):
    """The blue plate is in the middle of the picture all the way, where the swing is around it."""
    argv = called(room, "--path", "swing", "--field", room / "room.field", "--query", "blue plate", "--around", around)
    report = answer_of(capsys, *argv, "--fps", 4, "--seconds", 3, "--size", "80x60", "-o", tmp_path / "film.gif")
    blue = [np.argwhere((one[..., 2].astype(int) - one[..., 0]) > 60) for one in film_of(report["file"])]
    apart = [np.abs(where.mean(0) - (29.5, 39.5)).max() for where in blue]
    assert (max(apart) < 4) == (around == "match")


def test_photos_and_files_of_key_frames(room, tmp_path, capsys):
    report = answer_of(capsys, *called(room, "--path", "photos", "--fps", 2, "-o", tmp_path / "photos.webp"))
    assert (report["num_frames"], report["size"]) == (8, [96, 72])
    file = tmp_path / "camera_path.json"
    file.write_text(json.dumps(nerfstudio_file()))
    argv = ["render", room / "scene.ply", "--path", file, "-o", tmp_path / "file.webp"]
    report = answer_of(capsys, *argv)
    assert (report["num_frames"], report["fps"], report["size"]) == (5, 5.0, [160, 90])
    side = answer_of(capsys, *argv, "--overwrite", "--side-by-side", room / "scene.ply")
    assert side["size"] == [320, 90]
    left, right = np.split(film_of(side["file"])[0].astype(int), 2, axis=1)
    assert np.abs(left - right)[:, 2:-2].mean() < 3
    file.write_text('{"camera_path": []}')
    assert "list of 1 to 20,000" in error_of(capsys, *argv, "--overwrite")
    assert len(film_of(side["file"])) == 5  # what was there is there


def test_attributes_from_the_command_line(room, tmp_path, capsys):
    argv = called(room, "--field", room / "room.field", "--query", "red mug", "--attributes", "red mug", "blue plate")
    report = answer_of(capsys, *argv, "-o", tmp_path / "row.png")
    with Image.open(report["files"][0]) as row:
        assert row.size[0] > 3 * 400
    argv = called(
        room, "--field", room / "room.field", "--query", "elephant", "--attributes", "red", "-o", tmp_path / "x.png"
    )
    assert "'elephant' has no match" in error_of(capsys, *argv)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--path", "orbit"], "expected --output FILE"),
        (["--path", "orbit", "-o", "film.avi"], "films are written as .mp4, .webm, .webp or .gif"),
        (["--path", "orbit", "-o", "film.webp", "--fps", "0"], "--fps: expected 0.01 to 240"),
        (["--path", "orbit", "-o", "film.webp", "--fps", "1e-300"], "--fps: expected 0.01 to 240"),
        (["--path", "orbit", "-o", "film.webp", "--seconds", "1e9"], "--seconds"),
        (["--path", "orbit", "-o", "film.webp", "--size", "99999x99999"], "--size: expected 2x2"),
        (["--path", "orbit", "-o", "film.webp", "--size", "65x48", "--side-by-side"], "a multiple of 2 across"),
        (["--path", "nowhere.json", "-o", "film.webp"], "got 'nowhere.json', and there is no such file"),
        (
            ["--path", "orbit", "--size", "33x24", "--side-by-side", "SCENE", "-o", "film.webp"],
            "a multiple of 2 across",
        ),
        (["--path", "orbit", "-o", "film.webp", "--around", "match"], "--around: a match or an object is of a field"),
        (["--path", "orbit", "-o", "film.webp", "--up", "w"], "--up: w: expected one of"),
        (["--path", "orbit", "-o", "film.webp", "--depth"], "drop --depth and --alpha"),
        (["--path", "orbit", "-o", "film.webp", "--boxes"], "give --query WORDS"),
        (["--attributes", "red", "-o", "x.png"], "give --query WORDS"),
        (["--view", "photo_0", "--fps", "3"], "--fps is of a film"),
        ([], "expected a point of view"),
    ],
)
def test_what_is_wrong_is_said_before_any_picture(more, said, room, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert said in error_of(capsys, *called(room), *more)
    assert list(tmp_path.iterdir()) == []


def test_stills_can_have_boxes_too(room, tmp_path, capsys):
    argv = called(room, "--view", "photo_0", "--field", room / "room.field", "--query", "red mug", "-o", tmp_path)
    plain = np.asarray(Image.open(answer_of(capsys, *argv)["files"][0]))
    boxed = np.asarray(Image.open(answer_of(capsys, *argv, "--boxes", "--overwrite")["files"][0]))
    assert len(pixels_near(boxed, PINK)) > len(pixels_near(plain, PINK))


def test_pictures_of_one_view_need_poses(room, capsys):
    assert "expected --views CAPTURE" in error_of(capsys, "render", room / "scene.ply", "--view", "photo_0")


def first_of(path: Path) -> np.ndarray:
    with Image.open(path) as pictures:
        return np.asarray(pictures.convert("RGB"))


def test_annotations_are_in_pictures_and_films(room, tmp_path):
    scene = tmp_path / "scene.ply"
    shutil.copy(room / "scene.ply", scene)
    AnnotationFile.beside(scene).add([Annotation.at("the mug", (-0.7, 0.0, 0.0))])
    views = ["--views", str(room / "capture")]
    for name, more in (("plain", []), ("noted", ["--annotations"])):
        out = tmp_path / name
        assert cli.main(["render", str(scene), *views, "--view", "photo_0", "-o", str(out), *more]) == 0
        film = ["--path", "orbit", "--seconds", "0.5", "--fps", "4", "--size", "64x48", "-o", str(out / "a.gif")]
        assert cli.main(["render", str(scene), *views, *film, *more]) == 0
    for file in ("photo_0.png", "a.gif"):
        plain, noted = (first_of(tmp_path / name / file) for name in ("plain", "noted"))
        assert plain.shape == noted.shape
        assert (plain != noted).any()


def test_a_scene_that_moves_is_filmed_and_drawn(room, tmp_path):
    """The toy's frames: what moves is elsewhere in the last picture."""
    film = ["--path", "orbit", "--seconds", "1", "--fps", "3", "--size", "64x48", "-o", str(tmp_path / "a.gif")]
    assert cli.main(["render", str(room / "frames"), "--views", str(room / "capture"), *film]) == 0
    with Image.open(tmp_path / "a.gif") as pictures:
        assert pictures.n_frames == 3
    argv = ["render", str(room / "frames"), "--views", str(room / "capture"), "--view", "photo_0", "-o", str(tmp_path)]
    assert cli.main(argv) == 1  # photos without a time
