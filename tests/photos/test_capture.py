"""`drsplat capture` on photos of a made-up room whose cameras are known, with all that people have in their folders."""

import io
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from command_line import answer_of
from drsplat.cli import main
from drsplat.errors import MissingExtraError
from drsplat.formats.captures import read_sparse_points, read_views
from drsplat.photos.capture import program
from drsplat.photos.capture.capturing import _bring_all, capture
from drsplat.photos.capture.finding import find_photos
from drsplat.photos.capture.measuring import KnownDistance, Place, _meeting, read_places
from drsplat.photos.capture.posing import camera_key
from drsplat.photos.capture.settings import CaptureSettings
from drsplat.photos.capture.work import Work, _remove
from drsplat.photos.capture.world import umeyama
from drsplat.scene.photos import load_image
from drsplat.scene.views import View
from photographed_room import exif_of, jpeg, photographed, room_views, write_room
from refusing import malformed, refused

has_colmap = pytest.mark.skipif(find_spec("pycolmap") is None, reason='needs pip install "drsplat[capture]"')
pytestmark = pytest.mark.slow
NUM_GOOD = 10
ORIENTATION = 0x0112


@pytest.fixture(scope="module")
def views() -> list[View]:
    return room_views(NUM_GOOD)


@pytest.fixture(scope="module")
def good_photos(views, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("good") / "photos"
    write_room(folder, views)
    return folder


@pytest.fixture(scope="module")
def mixed_photos(views, tmp_path_factory) -> Path:
    """The room, and beside it what else a folder may hold."""
    folder = tmp_path_factory.mktemp("mixed") / "photos"
    named = [replace(view, name=f"room/Über {k} .jpg") for k, view in enumerate(views)]
    (folder / "room").mkdir(parents=True)
    write_room(folder, named)
    _lay_on_its_side(folder / named[3].name)
    _write_transparent(folder / "room/Über 4 .png", folder / named[4].name)
    elsewhere = [replace(view, name=f"elsewhere_{k}.jpg") for k, view in enumerate(views[2:6])]
    write_room(folder, elsewhere, seed=7)
    whole = (folder / named[0].name).read_bytes()
    (folder / "z_copy.jpg").write_bytes(whole)
    (folder / "cut.jpg").write_bytes(whole[: len(whole) // 2])
    (folder / "empty.jpg").touch()
    (folder / "text.jpg").write_text("no photo")
    (folder / "wall.jpg").write_bytes(jpeg(np.full((300, 400, 3), 200, np.uint8)))
    (folder / ".hidden.jpg").write_bytes(whole)
    return folder


def _lay_on_its_side(path: Path) -> None:
    """Store a photo as a phone does that is held upright: turned, with an orientation in its EXIF."""
    with Image.open(path) as photo:
        turned, exif = photo.transpose(Image.Transpose.ROTATE_90), photo.getexif()
        exif[ORIENTATION] = 6
        turned.save(path, "JPEG", quality=95, exif=exif)


def _write_transparent(path: Path, source: Path) -> None:
    with Image.open(source) as photo:
        photo.convert("RGBA").save(path)
    source.unlink()


@pytest.fixture(scope="module")
def mixed(mixed_photos, tmp_path_factory) -> tuple[Path, dict[str, Any]]:
    output = tmp_path_factory.mktemp("mixed_capture") / "capture"
    return output, capture(mixed_photos, output, threads=2)


def differences(posed: list[View], true: list[View]) -> tuple[float, float, float]:
    """Return the median distance of centres as a share of their spread, the largest rotation, and the tilt, degrees."""
    here, there = (np.array([view.center for view in views]) for views in (posed, true))
    similarity = umeyama(here, there)
    away = np.linalg.norm(similarity.positions(here) - there, axis=1)
    spread = np.linalg.norm(there - there.mean(axis=0), axis=1).mean()
    turns = [
        Rotation.from_matrix(b.cam_from_world[:3, :3] @ similarity.rotation @ a.cam_from_world[:3, :3].T).magnitude()
        for a, b in zip(posed, true, strict=True)
    ]
    tilt = float(np.degrees(np.arccos(np.clip(similarity.rotation[2, 2], -1, 1))))
    return float(np.median(away) / spread), float(np.degrees(max(turns))), tilt


@has_colmap
def test_the_room_is_posed(mixed, views):
    output, record = mixed
    posed = {view.name: view for view in read_views(output)}
    assert sorted(posed) == sorted(f"room/Über {k} .{'png' if k == 4 else 'jpg'}" for k in range(NUM_GOOD))
    assert record["num_registered"] == NUM_GOOD
    away, turned, tilt = differences([posed[name] for name in sorted(posed)], views)
    assert away < 0.005
    assert turned < 0.3
    assert tilt < 3
    points = read_sparse_points(output)
    assert len(points.positions) == record["num_points"] > 300


@has_colmap
def test_inspect_and_train_take_the_capture(mixed, tmp_path, capsys):
    assert answer_of(capsys, "inspect", mixed[0])["num_photos"] == NUM_GOOD
    line = ["train", str(mixed[0]), "-o", str(tmp_path / "model"), "--iterations", "2", "--resolution", "64", "--json"]
    assert main([*line, "--max-gaussians", "100000"]) == 0  # the budget of such small photos is less than the points
    assert json.loads(capsys.readouterr().out)["start"]["given"] == mixed[1]["num_points"]


@has_colmap
def test_a_world_of_unknown_size_is_in_units(mixed):
    _, record = mixed
    assert (record["unit"], record["scale_from"], record["up"], record["up_from"]) == ("units", "", "+z", "horizons")
    assert record["georeferenced"] is False


@has_colmap
def test_photos_are_upright_and_show_what_they_showed(mixed, views):
    for view in read_views(mixed[0]):
        true = views[int(view.name.split()[1].partition(".")[0])]
        difference = np.abs(load_image(replace(view, distortion=None)).astype(int) - photographed(true))
        assert difference.mean() < 12  # another photo differs by some 50


@has_colmap
def test_every_photo_without_a_pose_has_its_reason(mixed):
    reasons = {one["name"]: one["reason"] for one in mixed[1]["left_out"]}
    expected = {
        "z_copy.jpg": "same file as room/Über 0 .jpg", "cut.jpg": "damaged", "empty.jpg": "empty",
        "text.jpg": "no photo", "wall.jpg": "hardly any texture, or is blurred",
        **{f"elsewhere_{k}.jpg": "another place, together with 3 other photos" for k in range(4)},
    }  # fmt: skip
    assert set(reasons) == set(expected)
    for name, words in expected.items():
        assert words in reasons[name], reasons[name]


@has_colmap
def test_the_photos_are_only_read(good_photos, tmp_path):
    before = {path: (path.stat().st_mtime_ns, path.read_bytes()) for path in good_photos.iterdir()}
    assert main(["capture", str(good_photos), "--output", str(tmp_path / "capture"), "--json", "--threads", "2"]) == 0
    assert before == {path: (path.stat().st_mtime_ns, path.read_bytes()) for path in good_photos.iterdir()}
    assert sorted(path.name for path in (tmp_path / "capture").iterdir()) == ["capture.json", "images", "sparse"]
    assert (tmp_path / "capture/images/photo_00.jpg").read_bytes() == (good_photos / "photo_00.jpg").read_bytes()


@has_colmap
def test_a_killed_run_goes_on_and_ends_as_one_that_was_not(good_photos, tmp_path, capsys):
    line = [sys.executable, "-m", "drsplat", "capture", str(good_photos), "--output", str(tmp_path / "c"), "--json"]
    for until in ("photos.jsonl", "radial.json", "batch.txt"):
        process = subprocess.Popen([*line, "--threads", "1"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while process.poll() is None and not (tmp_path / "c/.work" / until).exists():
            time.sleep(0.01)
        process.kill()
        process.wait()
        assert not (tmp_path / "c/sparse").exists()
    assert main([*line[3:], "--threads", "1"]) == 0
    assert main(["capture", str(good_photos), "--output", str(tmp_path / "whole"), "--json", "--threads", "1"]) == 0
    capsys.readouterr()
    ours, whole = (json.loads((tmp_path / name / "capture.json").read_text()) for name in ("c", "whole"))
    assert ours["num_registered"] == whole["num_registered"] == NUM_GOOD
    away, turned, _ = differences(read_views(tmp_path / "c"), read_views(tmp_path / "whole"))
    assert away < 1e-3
    assert turned < 0.05


@has_colmap
def test_an_interrupted_run_says_how_to_go_on_and_keeps_photos(good_photos, tmp_path):
    line = [sys.executable, "-m", "drsplat", "capture", str(good_photos), "--output", str(tmp_path / "c")]
    process = subprocess.Popen(line, stderr=subprocess.PIPE, text=True)
    while process.poll() is None and not (tmp_path / "c/.work/colmap.log").exists():
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "give the same command again" in said
    assert len((tmp_path / "c/.work/photos.jsonl").read_text().splitlines()) == NUM_GOOD


@has_colmap
def test_a_run_that_is_stopped_while_it_moves_things_into_place_is_finished_by_the_next(
    good_photos, tmp_path, monkeypatch
):
    def stop(*_):
        raise KeyboardInterrupt

    record = capture(good_photos, tmp_path / "c", threads=1)
    with monkeypatch.context() as context:
        context.setattr("drsplat.photos.capture.work._remove", _after(2, stop))
        with pytest.raises(KeyboardInterrupt):
            capture(good_photos, tmp_path / "c", CaptureSettings(lens="opencv"), overwrite=True, threads=1)
    assert not (tmp_path / "c/sparse").exists()
    again = capture(good_photos, tmp_path / "c", CaptureSettings(lens="opencv"), overwrite=True, threads=1)
    assert (record["settings"]["lens"], again["settings"]["lens"]) == ("radial", "opencv")
    assert len(read_views(tmp_path / "c")) == NUM_GOOD
    assert not (tmp_path / "c/.work").exists()


def _after(calls: int, stop: Callable[[], None]) -> Callable[[Path], None]:
    """Return what removes so many things, and then stops."""
    left = [calls]

    def remove(path: Path) -> None:
        left[0] -= 1
        if left[0] < 0:
            stop()
        _remove(path)

    return remove


@has_colmap
def test_a_run_on_one_thread_gives_the_same_bits_again(good_photos, tmp_path):
    for name in ("one", "other"):
        capture(good_photos, tmp_path / name, threads=1)
    for part in ("cameras", "images", "points3D"):
        one, other = (tmp_path / name / f"sparse/0/{part}.bin" for name in ("one", "other"))
        assert one.read_bytes() == other.read_bytes(), part


def test_importing_the_verb_imports_no_extra():
    code = "import sys; import drsplat.fronts.commands.capture; "
    code += "import drsplat.photos.capture.capturing, drsplat.photos.capture.videos; "
    code += "print(*{'pycolmap', 'av', 'pi_heif'} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split() == []


@has_colmap
def test_photos_that_are_added_to_a_stopped_run_are_taken(good_photos, tmp_path):
    some = tmp_path / "photos"
    some.mkdir()
    for path in sorted(good_photos.iterdir())[:2]:
        (some / path.name).write_bytes(path.read_bytes())
    with refused(r"expected at least 3 different photos, got 2 of 2"):
        capture(some, tmp_path / "c")
    for path in sorted(good_photos.iterdir())[2:5]:
        (some / path.name).write_bytes(path.read_bytes())
    assert capture(some, tmp_path / "c", threads=2)["num_registered"] == 5


@has_colmap
def test_a_capture_is_replaced_only_on_demand_and_stays_until_then(mixed, good_photos, tmp_path):
    output, _ = mixed
    with refused("exists already: pass overwrite=True"):
        capture(good_photos, output)
    (tmp_path / "bare").mkdir()
    (tmp_path / "bare/one.jpg").touch()
    with refused("expected at least 3"):
        capture(tmp_path / "bare", output, overwrite=True)
    assert len(read_views(output)) == NUM_GOOD


def test_what_is_not_ours_is_not_replaced(good_photos, tmp_path, monkeypatch):
    monkeypatch.setattr(program, "find_spec", lambda name: name)
    (tmp_path / "capture/images").mkdir(parents=True)
    with refused("holds images, which drsplat capture did not make"):
        capture(good_photos, tmp_path / "capture", overwrite=True)


@pytest.mark.parametrize("place", [".", "inside", ".."])
def test_an_output_in_or_around_the_photos_is_refused(place, good_photos, monkeypatch):
    monkeypatch.setattr(program, "find_spec", lambda name: name)
    with refused("name an output beside their folder"):
        capture(good_photos, good_photos / place)


def test_without_pycolmap_the_error_says_what_to_install(good_photos, tmp_path, monkeypatch):
    monkeypatch.setattr(program, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r'pip install .*\[capture\]"'):
        capture(good_photos, tmp_path / "capture")
    assert not (tmp_path / "capture").exists()


@has_colmap
@pytest.mark.parametrize(
    ("photos", "message"),
    [
        ({"a.jpg": 0}, r"got 1 of 1"),
        ({"a.jpg": 0, "b.jpg": 0, "c.jpg": 0}, r"got 1 of 3; 2 are copies of others"),
        ({"a.jpg": 0, "b.jpg": None, "c.jpg": None}, r"got 1 of 3; 2 cannot be used: b.jpg \(the file is empty\)"),
    ],
    ids=["one", "alike", "empty"],
)
def test_too_few_photos_are_an_error_that_says_why(photos, message, views, tmp_path):
    (tmp_path / "photos").mkdir()
    for name, index in photos.items():
        content = b"" if index is None else jpeg(photographed(views[index]), exif_of(views[index]))
        (tmp_path / "photos" / name).write_bytes(content)
    with refused(message):
        capture(tmp_path / "photos", tmp_path / "capture")


@has_colmap
def test_photos_without_texture_are_an_error_that_names_them(tmp_path):
    (tmp_path / "photos").mkdir()
    for k in range(4):
        (tmp_path / f"photos/{k}.jpg").write_bytes(jpeg(np.full((300, 400, 3), 100 + k, np.uint8)))
    with refused(r"no two photos overlap: 0\.jpg \(it shows hardly any texture"):
        capture(tmp_path / "photos", tmp_path / "capture")


@has_colmap
def test_a_camera_that_never_moved_is_an_error_that_says_so(views, tmp_path):
    """The same photo saved again and again: other bytes, the same place."""
    (tmp_path / "photos").mkdir()
    for k in range(4):
        Image.fromarray(photographed(views[0])).save(tmp_path / f"photos/{k}.jpg", quality=85 + k)
    with refused(r"0\.jpg \(too little movement: [\d,]+ places in common with another photo"):
        capture(tmp_path / "photos", tmp_path / "capture", threads=2)


@has_colmap
def test_portrait_and_landscape_are_posed_together(views, tmp_path):
    upright = np.array([[views[0].K[0, 0], 0, 150], [0, views[0].K[1, 1], 200], [0, 0, 1.0]])
    taken = [replace(view, K=upright, width=300, height=400) if k % 3 == 1 else view for k, view in enumerate(views)]
    write_room(tmp_path / "photos", taken)
    assert capture(tmp_path / "photos", tmp_path / "c", threads=2)["num_registered"] == len(views)
    posed = read_views(tmp_path / "c")
    assert [(view.width, view.height) for view in posed] == [(view.width, view.height) for view in taken]
    assert differences(posed, taken)[0] < 0.01


@has_colmap
def test_heic_photos_are_taken(good_photos, tmp_path):
    pytest.importorskip("pi_heif", reason='needs pip install "drsplat[capture]"')
    heif = pytest.importorskip("pillow_heif", reason="needs pillow-heif, which can write HEIC")
    (tmp_path / "photos").mkdir()
    for path in sorted(good_photos.iterdir())[:5]:
        with Image.open(path) as photo:
            content = io.BytesIO()
            heif.from_pillow(photo).save(content, quality=90)
        (tmp_path / "photos" / f"{path.stem}.HEIC").write_bytes(content.getvalue())
    assert capture(tmp_path / "photos", tmp_path / "capture", threads=2)["num_registered"] == 5
    assert {view.name for view in read_views(tmp_path / "capture")} == {f"photo_0{k}.jpg" for k in range(5)}


def test_an_unknown_lens_is_refused():
    with refused("lens: expected one of pinhole, radial"):
        CaptureSettings(lens="bent")


def pixel_of(view: View, point: tuple[float, float, float]) -> tuple[float, float]:
    """Where a camera of the room sees a point, metres."""
    seen = view.K @ (view.cam_from_world[:3, :3] @ point + view.cam_from_world[:3, 3])
    return float(seen[0] / seen[2]), float(seen[1] / seen[2])


@has_colmap
def test_a_known_distance_gives_metres_and_keeps_the_poses(good_photos, views, tmp_path, capsys):
    """Two places on a side of the lower box, 80 cm apart, one of them at its edge, each in a photo of its own."""
    line = ["capture", str(good_photos), "--output", str(tmp_path / "c"), "--threads", "2", "--json"]
    assert main(line) == 0
    before = read_views(tmp_path / "c")
    places = [(views[2], (0.4, -0.48, 0.6)), (views[4], (0.4, 0.32, 0.6))]
    known = [part for view, point in places for part in (view.name, *map(str, pixel_of(view, point)))]
    assert main([*line, "--known-distance", *known, "0.8", "--overwrite"]) == 0
    record = json.loads((tmp_path / "c/capture.json").read_text())
    assert (record["unit"], record["scale_from"]) == ("m", "known distance")
    after = read_views(tmp_path / "c")
    here, there = (np.array([view.center for view in each]) for each in (after, views))
    assert umeyama(here, there).scale == pytest.approx(1, abs=0.02)
    away, turned, _ = differences(before, after)
    assert (away, turned) == pytest.approx((0, 0), abs=1e-4)
    assert (tmp_path / "c/images/photo_00.jpg").is_file()
    assert main([*line, "--scale", "2", "--overwrite"]) == 0
    ratio = np.linalg.norm(read_views(tmp_path / "c")[0].center) / np.linalg.norm(before[0].center)
    assert ratio == pytest.approx(2)
    capsys.readouterr()
    for wrong, words in (
        (["nobody.jpg", "1", "1", *known[3:], "1"], "'nobody.jpg' has no pose"),
        ([*known[:3], known[3], "4000", "1", "1"], "is not on photo_04.jpg, which is 400x300 upright"),
        ([*known[:3], *known[:3], "1"], "both places are one"),
    ):
        assert main([*line, "--known-distance", *wrong, "--overwrite"]) == 1
        assert words in capsys.readouterr().out
    assert main([*line, "--known-distance", *known, "x", "--overwrite"]) == 2
    assert len(read_views(tmp_path / "c")) == NUM_GOOD


@has_colmap
def test_named_places_are_where_their_rays_meet(good_photos, views, tmp_path, capsys):
    """A marker in the air, where no point is, and one on a box that a single photo shows; in metres of the room."""
    line = ["capture", str(good_photos), "--output", str(tmp_path / "c"), "--threads", "2", "--json"]
    assert main(line) == 0
    air, box = (0.9, 0.6, 1.3), (0.4, -0.48, 0.6)
    rows = [("air", view, air) for view in views[1:8:3]] + [("box", views[2], box)]
    rows += [("flat", view, air) for view in views[1:3]] + [
        ("torn", views[1], air),
        ("torn", views[7], (0.0, 1.0, 1.3)),
    ]
    table = [f"{name},{view.name},{','.join(map(str, pixel_of(view, point)))}" for name, view, point in rows]
    table += ["air,unposed.jpg,3,4", "lost,unposed.jpg,3,4", "lost,another.jpg,3,4"]
    (tmp_path / "places.csv").write_text("\n".join(["name,photo,x,y", *table]))
    named = [*line, "--overwrite", "--places", str(tmp_path / "places.csv")]
    metres = str(np.linalg.norm(np.subtract(air, box)))
    assert main([*named, "--known-distance", "air", "box", metres]) == 0
    record = json.loads((tmp_path / "c/capture.json").read_text())
    assert record["scale_from"] == "known distance"
    here, there = (np.array([view.center for view in each]) for each in (read_views(tmp_path / "c"), views))
    assert umeyama(here, there).scale == pytest.approx(1, abs=0.02)
    capsys.readouterr()
    for known, words in (
        (("air", "boxs"), "the table of places has no 'boxs': it has air, box, flat, lost, torn. Did you mean 'box'?"),
        (("torn", "box"), "the pixels of 'torn' are not of one place"),
        (("lost", "box"), "none of the photos 'unposed.jpg', 'another.jpg' has a pose"),
    ):
        assert main([*named, "--known-distance", *known, "1"]) == 1
        assert words in json.loads(capsys.readouterr().out)["error"]
    assert main([*line, "--overwrite", "--places", "places.csv"]) == 2
    assert main([*line, "--overwrite", "--known-distance", "air", "box", "1"]) == 2
    assert "or --places FILE.csv with NAME NAME METRES; got 3 values" in capsys.readouterr().err


def test_rays_of_one_direction_tell_no_depth():
    looks = [{"center": [x, 0.0, 0.0], "ray": [(2 - x) / 100, 0.0, 1.0]} for x in (0.0, 1.0)]
    with refused("from nearly one direction"):
        _meeting("'corner'", looks)
    looks = [{"center": [x, 0.0, 0.0], "ray": [(2 - x) / 4, 0.5, 1.0]} for x in (0.0, 1.0, 5.0)]
    assert _meeting("'corner'", looks) == pytest.approx([2, 2, 4])
    behind = [{"center": one["center"], "ray": [-part for part in one["ray"]]} for one in looks]
    with refused("are not of one place"):
        _meeting("'corner'", behind)


@pytest.mark.parametrize(
    "text",
    ["", "name,x,y,photo\n", "name,photo,x,y\na,b,1\n", "name,photo,x,y\na,b,1,nan\n", "name,photo,x,y\n,b,1,2\n",
     "name,photo,x,y\na,b,1,2\na,b,3,4\n", "\xff"],
)  # fmt: skip
def test_damaged_tables_of_places_are_refused(text, tmp_path):
    (tmp_path / "places.csv").write_text(text, encoding="latin-1")
    with malformed(r"places\.csv"):
        read_places(tmp_path / "places.csv")
    with refused("no such file"):
        read_places(tmp_path / "none.csv")


def test_lengths_are_said_once():
    known = KnownDistance(Place("a", 1, 2), Place("b", 3, 4), 1.0)
    with refused("give one"):
        CaptureSettings(scale=1.0, known_distance=known)
    with refused("scale: expected a number above 0, got 0"):
        CaptureSettings(scale=0.0)
    with refused("known_distance: expected metres above 0, got nan"):
        KnownDistance(Place("a", 1, 2), Place("b", 3, 4), np.nan)


@has_colmap
def test_fisheye_photos_become_what_a_pinhole_sees(views, tmp_path):
    """Some 160 degrees from corner to corner."""
    wide = np.array([[180.0, 0, 200], [0, 180, 150], [0, 0, 1]])
    fisheyes = [replace(view, K=wide) for view in views]
    (tmp_path / "photos").mkdir()
    for view in fisheyes:
        (tmp_path / "photos" / view.name).write_bytes(jpeg(photographed(view, fisheye=True)))
    record = capture(tmp_path / "photos", tmp_path / "c", CaptureSettings(lens="fisheye"), threads=2)
    assert record["num_registered"] == NUM_GOOD
    posed = read_views(tmp_path / "c")
    away, turned, _ = differences(posed, views)
    assert away < 0.01
    assert turned < 0.5
    for view, true in list(zip(posed, views, strict=True))[::4]:
        assert view.distortion is None
        as_pinhole = photographed(replace(view, cam_from_world=true.cam_from_world))
        assert np.abs(load_image(view).astype(int) - as_pinhole).mean() < 20  # another photo differs by some 50


LIMITED = """
import resource, sys
sys.dont_write_bytecode = True
resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))
from drsplat.cli import main
sys.exit(main(sys.argv[1:]))
"""


@has_colmap
@pytest.mark.parametrize("limit", [20_000, 400_000], ids=["for photos", "for features"])
def test_a_full_disk_is_a_sentence_and_the_same_command_goes_on(limit, good_photos, tmp_path):
    pytest.importorskip("resource", reason="this system has no limits on files")
    line = ["capture", str(good_photos), "--output", str(tmp_path / "c"), "--threads", "1"]
    program = [sys.executable, "-c", LIMITED.format(limit=limit)]
    ran = subprocess.run([*program, *line], capture_output=True, text=True)
    assert ran.returncode == 1
    assert "there is no room left" in ran.stderr
    assert ran.stderr.count("\n") == 1
    assert main([*line, "--json"]) == 0
    assert len(read_views(tmp_path / "c")) == NUM_GOOD


@has_colmap
def test_a_damaged_database_is_a_sentence(good_photos, tmp_path):
    (tmp_path / "c/.work").mkdir(parents=True)
    (tmp_path / "c/.work/radial.db").write_bytes(b"no database" * 1000)
    cameras = {camera_key(photo): 1 for photo in _bring_all(find_photos(good_photos), Work(tmp_path / "c"), quietly)}
    (tmp_path / "c/.work/radial.json").write_text(json.dumps(cameras))
    with malformed(r"database in .* is damaged.*remove that folder"):
        capture(good_photos, tmp_path / "c")


def quietly(*_: object) -> None:
    """Take progress and say nothing."""
