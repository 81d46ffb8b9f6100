"""Pictures and files that the live viewer gives, and scenes that it is given."""

import io
import json
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image
from test_film_paths import nerfstudio_file

from clients import Viewer, a_viewer, camera, error_of, room_viewer
from drsplat import open_scene, read_gaussians, write_gaussians
from drsplat.authoring.editing import Remove
from drsplat.authoring.filming.paths import read_path
from drsplat.errors import InputError
from drsplat.fronts.viewing import saving
from drsplat.fronts.viewing.live import files
from drsplat.fronts.viewing.live.uploads import root_of
from drsplat.fronts.viewing.session import Session
from glb_files import Read
from scenes import random_gaussians
from viewing_scenes import EACH, THINGS, boxes_scene

KEYS = [
    {"eye": [6.0, -9.0, 4.0], "target": [0, 0, 0], "fov": 50.0},
    {"eye": [-7, -8, 3], "target": [0, 0, 1], "fov": 40},
]


@pytest.fixture
def viewer(tmp_path: Path) -> Iterator[Viewer]:
    with a_viewer(folder=tmp_path / "saved") as one:
        yield one


@pytest.fixture
def furnished(room: Path) -> Iterator[Viewer]:
    with room_viewer(room) as one:
        yield one


def pixels_of(answer: Any, kind: str) -> np.ndarray:
    assert answer.status_code == 200, answer.text
    with Image.open(io.BytesIO(answer.content)) as picture:
        assert picture.format == kind
        return np.asarray(picture.convert("RGB"))


# --- pictures ---


def test_a_picture_is_what_the_renderer_draws_of_what_is_shown(viewer):
    viewer.ask("tall lamp")
    seen_from = camera(viewer)
    drawn = pixels_of(viewer.post("/view/picture", {"camera": seen_from}), "PNG")
    assert drawn.shape == (240, 320, 3)
    viewer.do("mode", mode="as it is")
    plain = pixels_of(viewer.post("/view/picture", {"camera": seen_from}), "PNG")
    assert (drawn != plain).any(axis=2).mean() > 0.01
    wide = pixels_of(viewer.post("/view/picture", {"camera": seen_from | {"width": 6400, "height": 1600}}), "PNG")
    assert wide.shape == (400, 1600, 3)
    error_of(viewer.post("/view/picture", {"camera": seen_from | {"width": 10**6}}), 422)
    error_of(viewer.post("/view/picture", {"camera": seen_from | {"eye": seen_from["target"]}}), 422)


def test_before_and_after_are_side_by_side(viewer):
    viewer.ask("red mug; tall lamp; blue mug")
    viewer.do("edit", change="remove")
    both = pixels_of(viewer.post("/view/before-after", {"camera": camera(viewer)}), "PNG").astype(int)
    before, after = both[:, :320], both[:, 320:]
    assert before.shape == after.shape == (240, 320, 3)
    assert (np.abs(before - after).max(axis=2) > 20).mean() > 0.005
    assert before.sum() > after.sum()


def test_photos_are_those_of_the_scene_and_no_others(furnished):
    name = furnished.header()["photos"][0]["name"]
    photo = pixels_of(furnished.get("/view/photo", name=name, side=32), "JPEG")
    assert max(photo.shape) == 32
    for bad in ("../secret.png", "/etc/passwd", ""):
        assert "no view" in error_of(furnished.get("/view/photo", name=bad), 422)
    for side in ("0", "99999", "-1", "x", "1" * 50):
        error_of(furnished.get("/view/photo", name=name, side=side), 422)


def test_objects_have_pictures_that_are_drawn_once(furnished, monkeypatch):
    red, blue = (pixels_of(furnished.get("/view/object-picture", number=n), "JPEG").astype(int) for n in (0, 1))
    assert red.shape == blue.shape
    assert (red != blue).any()
    monkeypatch.setattr(files, "pictures_of", None)
    assert_array_equal(pixels_of(furnished.get("/view/object-picture", number=0), "JPEG"), red)
    assert "no object 7" in error_of(furnished.get("/view/object-picture", number=7), 422)
    error_of(furnished.get("/view/object-picture"), 422)


def test_a_click_has_the_photo_of_most_support(furnished):
    assert "no photo" in error_of(furnished.get("/view/clicked-photo"), 422)
    session = furnished.session
    view = session.scene.views[0]
    x, y, depth = view.K @ (view.cam_from_world @ np.append(session.scene.objects[0].center, 1))[:3]
    assert furnished.do("click_photo", photo=view.name, x=x / depth, y=y / depth)["clicked"]["photo"]
    assert max(pixels_of(furnished.get("/view/clicked-photo"), "JPEG").shape) <= 480


# --- files ---


def test_a_scene_and_a_selection_are_saved_and_sent(viewer, tmp_path):
    viewer.ask("tall lamp")
    whole = viewer.post("/view/save", {"what": "scene"})
    assert whole.headers["content-disposition"] == 'attachment; filename="found.ply"'
    path = Path(unquote(whole.headers["x-drsplat-saved"]))
    assert path == tmp_path / "saved/found.ply"
    assert path.read_bytes() == whole.content
    assert (read_gaussians(path).extra["match_id"] == 0).sum() == EACH
    part = viewer.post("/view/save", {"what": "selection"})
    assert part.headers["content-disposition"] == 'attachment; filename="selection.ply"'
    assert len(read_gaussians(tmp_path / "saved/selection.ply")) == EACH
    viewer.do("clear")
    assert "nothing is selected" in error_of(viewer.post("/view/save", {"what": "selection"}), 422)


def test_without_a_folder_files_are_only_sent(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    with a_viewer() as viewer:
        answer = viewer.post("/view/save", {"what": "scene"})
        assert "x-drsplat-saved" not in answer.headers
        assert answer.content.startswith(b"ply")
        assert list(tmp_path.iterdir()) == []
        monkeypatch.setattr(saving, "MAX_SENT_BYTES", 1)
        assert "--save-dir" in error_of(viewer.post("/view/save", {"what": "scene"}), 422)


def test_a_swing_is_about_the_best_match_or_what_is_looked_at(viewer, monkeypatch):
    targets = []

    def swung(session: Session, eye: np.ndarray, target: np.ndarray, up: np.ndarray) -> bytes:
        targets.append(target)
        return b"GIF89a"

    monkeypatch.setattr(files, "flight_gif", swung)
    assert "camera" in error_of(viewer.post("/view/save", {"what": "swing"}), 422)
    looked = camera(viewer, target=(0.5, 0.5, 0.5))
    assert viewer.post("/view/save", {"what": "swing", "camera": looked}).content == b"GIF89a"
    viewer.ask("tall lamp")
    viewer.post("/view/save", {"what": "swing", "camera": looked})
    assert_allclose(targets[0], (0.5, 0.5, 0.5), atol=1e-6)
    assert_allclose(targets[1], viewer.session.results[0].matches[0].center)


def test_a_path_is_saved_as_render_takes_it_and_comes_back(viewer, tmp_path):
    sent = viewer.post("/view/path", {"keys": KEYS, "seconds": 3.0, "closed": True})
    path, frame = read_path(tmp_path / "saved/path.json"), viewer.session.shown.frame
    assert (path.seconds, path.closed, len(path.keys)) == (3.0, True, 2)
    assert_allclose(path.keys[0].eye, frame.world(np.array(KEYS[0]["eye"])))
    back = viewer.post("/view/load-path", sent.content)
    assert back.status_code == 200
    loaded = back.json()
    assert (loaded["seconds"], loaded["closed"]) == (3.0, True)
    for own, other in zip(KEYS, loaded["keys"], strict=True):
        assert_allclose(other["eye"], own["eye"], atol=1e-6)
        ahead = np.array(own["target"], float) - own["eye"]
        assert_allclose(np.array(other["target"]) - other["eye"], ahead / np.linalg.norm(ahead), atol=1e-6)
        assert other["fov"] == pytest.approx(own["fov"])


def test_a_path_of_nerfstudio_is_loaded_and_what_is_none_is_refused(viewer, tmp_path):
    document = nerfstudio_file()
    loaded = viewer.post("/view/load-path", json.dumps(document).encode()).json()
    assert len(loaded["keys"]) == len(document["camera_path"])
    for junk in (b"", b"{}", b"[1]", b"\xff", b'{"key_frames": []}', b"[" * 10_000):
        error_of(viewer.post("/view/load-path", junk), 422)


@pytest.mark.parametrize(
    "keys", [[], KEYS[:1], [KEYS[0]] * 201, [{"eye": [0, 0, 0], "target": [0, 0, 0], "fov": 50}] * 2]
)
def test_what_is_no_path_is_refused(viewer, keys):
    for path, more in (("/view/path", {}), ("/view/film", {"format": ".gif"})):
        error_of(viewer.post(path, {"keys": keys} | more), 422)


def test_a_film_is_drawn_in_the_colours_of_the_moment(viewer, monkeypatch):
    monkeypatch.setattr(files, "FILM_SIZE_PIXELS", (64, 48))
    film = viewer.post("/view/film", {"keys": KEYS, "seconds": 0.25, "format": ".gif"})
    assert film.headers["content-disposition"] == 'attachment; filename="film.gif"'
    with Image.open(io.BytesIO(film.content)) as picture:
        assert (picture.format, picture.size, picture.n_frames) == ("GIF", (64, 48), 6)
    monkeypatch.setattr(files, "film_formats", lambda: (".webp", ".gif"))
    assert "ffmpeg" in error_of(viewer.post("/view/film", {"keys": KEYS, "seconds": 0.25, "format": ".mp4"}), 422)
    error_of(viewer.post("/view/film", {"keys": KEYS, "seconds": 61, "format": ".gif"}), 422)
    error_of(viewer.post("/view/film", {"keys": KEYS, "format": "/../x.gif"}), 422)


def test_a_film_that_nobody_waits_for_ends(viewer, tmp_path):
    gone = threading.Event()
    gone.set()
    asked = files.Film.model_validate_json(json.dumps({"keys": KEYS, "seconds": 60, "format": ".gif"}))
    with pytest.raises(InputError, match="not waited for"):
        files.film(viewer.shared.saves, viewer.shared.stage, asked, gone)
    assert list((tmp_path / "saved").iterdir()) == []


def test_a_page_has_the_queries_that_are_answered_now(furnished):
    furnished.ask("red mug; blue mug")
    page = furnished.post("/view/page", {})
    assert page.status_code == 200, page.text
    assert page.headers["content-disposition"] == 'attachment; filename="page.html"'
    assert b"blue mug" in page.content
    assert furnished.state()["mode"] == "answer"  # what is on show stays


# --- scenes that are sent ---


def test_a_scene_that_is_sent_is_shown_in_place_of_the_one_before(viewer, tmp_path):
    write_gaussians(tmp_path / "sent.ply", random_gaussians(70))
    before = viewer.ask("red mug")
    state = viewer.post("/view/open?name=sent.ply", (tmp_path / "sent.ply").read_bytes()).json()
    assert state["scene"] == before["scene"] + 1
    assert state["results"] == []
    assert "sent" in state["message"]
    assert not state["kept"]
    assert viewer.header()["title"] == "sent"
    assert len(viewer.arrays("/view/splats")["opacity"]) == 70
    root = viewer.shared.uploads.root
    assert len(list(root.rglob("*.ply"))) == 1
    viewer.post("/view/open?name=again.ply", (tmp_path / "sent.ply").read_bytes())
    assert [path.name for path in root.rglob("*.ply")] == ["again.ply"]  # the files of the one before are gone


def test_a_folder_that_is_sent_file_by_file_answers_words(viewer, room):
    viewer.ask("red mug")
    for path in sorted(room.rglob("*")):
        if path.is_file():
            name = f"room/{path.relative_to(room)}"
            answer = viewer.post(f"/view/upload?batch=b1&name={name}", path.read_bytes())
            assert answer.status_code == 200, answer.text
    state = viewer.do("open", batch="b1")
    assert state["message"].startswith("opened room")
    assert viewer.ask("red mug")["selection"] > 0
    assert viewer.header()["can"]["objects"]
    assert "sent before" in viewer.refused("open", batch="b1")


def test_what_cannot_be_opened_leaves_what_is_shown(viewer, room, tmp_path):
    before = viewer.ask("red mug")
    for name, data in (("a.ply", b"ply\nnonsense"), ("a.txt", b"hello"), ("a.sog", b"PK\x03\x04"), ("a.splat", b"x")):
        error_of(viewer.post(f"/view/open?name={name}", data), 422)
    shutil.rmtree(room / "room.field")
    viewer.post("/view/upload?batch=b&name=room.field/manifest.json", b"{}")
    viewer.refused("open", batch="b")
    after = viewer.state()
    assert after["results"] == before["results"]
    assert after["scene"] == before["scene"]
    assert [path for path in viewer.shared.uploads.root.rglob("*") if path.is_file()] == []


def test_lists_of_edits_that_are_sent_are_not_done(viewer, room):
    """They may name any scene of this machine to take an object from."""
    own = open_scene(room / "room.field", scene=room / "scene.ply", threads=1)
    session = Session(own)
    session.choose_object(0)
    session.edit(Remove())
    assert (room / "scene.edits.json").exists()
    for path in room.rglob("*"):
        if path.is_file() and "capture" not in path.parts:
            viewer.post(f"/view/upload?batch=b&name={path.relative_to(room)}", path.read_bytes())
    assert viewer.do("open", batch="b")["edits"] == []


@pytest.mark.parametrize(
    ("files", "root"),
    [
        (["a.ply"], "a.ply"),
        (["model/point_cloud/iteration_7/point_cloud.ply"], "model/point_cloud/iteration_7/point_cloud.ply"),
        (["demo/room.field/manifest.json", "demo/scene.ply"], "demo"),
        (["room.field/manifest.json"], ""),
        (["film.motion/motion.safetensors"], "film.motion/motion.safetensors"),
        (["frames/0001.ply", "frames/0002.ply"], "frames"),
    ],
)
def test_what_is_sent_is_found_in_its_folders(files, root, tmp_path):
    for name in files:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    assert root_of(tmp_path) == tmp_path / root


# --- without a scene ---


def test_where_no_scene_is_open_that_is_said():
    with a_viewer(Session(boxes_scene(), words=THINGS)) as viewer:
        full = set(viewer.state()), set(viewer.header()["can"])
        viewer.shared._stage = None
        viewer.shared.note()
        assert (set(viewer.state()), set(viewer.header()["can"])) == full
        assert len(viewer.arrays("/view/splats")["centers"]) == 0
        assert len(viewer.arrays("/view/paint")["owner"]) == 0
        assert "no scene is open" in viewer.refused("ask", text="mug")
        for path in ("/view/clicked-photo", "/view/object-picture?number=0", "/view/photo?name=x"):
            assert "no scene is open" in error_of(viewer.get(path), 422)
        assert "no scene is open" in error_of(viewer.post("/view/save", {"what": "scene"}), 422)
        assert "no catalogue" in error_of(viewer.post("/view/catalogue", {"text": "mug"}), 422)
        assert "no catalogue" in viewer.refused("open_entry", number=0)


def test_nothing_is_left_on_the_disk_when_the_viewer_ends(viewer):
    viewer.post("/view/upload?batch=b&name=a.ply", b"ply")
    root = viewer.shared.uploads.root
    assert root.exists()
    viewer.close()
    assert not root.exists()


def test_a_flight_passes_the_key_frames_as_the_film_does(viewer):
    keys = [{"eye": [4.0 * k, -8.0, 3.0], "target": [0.0, 0.0, float(k)], "fov": 50.0} for k in range(3)]
    flight = viewer.post("/view/flight", {"keys": keys, "seconds": 2.0}).json()
    assert flight["seconds"] == 2.0
    assert len(flight["eyes"]) == len(flight["targets"]) == len(flight["fovs"]) == 24
    assert_allclose(flight["eyes"][0], keys[0]["eye"], atol=1e-3)
    assert_allclose(flight["eyes"][-1], keys[-1]["eye"], atol=1e-3)
    apart = np.linalg.norm(np.array(flight["eyes"]) - keys[1]["eye"], axis=1)
    assert apart.min() < 0.5
    ahead = np.array(flight["targets"][0]) - flight["eyes"][0]
    meant = np.array(keys[0]["target"]) - keys[0]["eye"]
    assert_allclose(ahead / np.linalg.norm(ahead), meant / np.linalg.norm(meant), atol=1e-3)


def test_a_scene_is_saved_with_its_objects_matches_and_edits(furnished, tmp_path):
    furnished.ask("red mug")
    answer = furnished.post("/view/save", {"what": "scene", "format": ".glb"})
    assert answer.status_code == 200, answer.text
    glb = Read.of(answer.content)
    assert glb.table(0)["number"] == [0, 1]
    (number,) = next(node for node in glb.document["nodes"] if node["name"] == "matches")["children"]
    before = glb.document["nodes"][number]
    assert before["extras"]["query"] == "red mug"
    furnished.do("edit", change="move", by=[0.0, 0.0, 2.0])
    moved = Read.of(furnished.post("/view/save", {"what": "scene", "format": ".glb"}).content)
    assert_allclose(
        np.array(moved.document["nodes"][number]["translation"]) - before["translation"], [0, 0, 2], atol=1e-4
    )
    part = Read.of(furnished.post("/view/save", {"what": "selection", "format": ".glb"}).content)
    assert len(part.table(0)["number"]) == 1
    assert len(part.attribute("POSITION")) < len(glb.attribute("POSITION"))
    (tmp_path / "a.spz").write_bytes(furnished.post("/view/save", {"what": "scene", "format": ".spz"}).content)
    assert len(read_gaussians(tmp_path / "a.spz")) == len(glb.attribute("POSITION"))
    error_of(furnished.post("/view/save", {"what": "scene", "format": ".obj"}), 422)


def test_pictures_of_objects_are_drawn_before_anybody_asks(furnished, monkeypatch):
    furnished.app.state.viewer.prepare()
    furnished.lanes.files.complete(lambda: None).result(60)
    monkeypatch.setattr(files, "pictures_of", None)
    furnished.lanes.files.submit = None  # type: ignore[method-assign, assignment]  # nor are they waited for
    assert pixels_of(furnished.get("/view/object-picture", number=1), "JPEG").size
