"""People in photos: found, left out, and kept where they stand as still as all else."""

import json
import signal
import subprocess
import sys
import time
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from test_capture import has_colmap

from drsplat.base.progress import track
from drsplat.cli import main
from drsplat.formats.captures import SparsePoints
from drsplat.formats.poses import write_cameras_json
from drsplat.fronts.commands.options import without_people as while_left_out
from drsplat.photos.models.people import finding, people, without_people
from drsplat.scene.photo_masks import load_mask
from drsplat.scene.views import View
from photographed_room import HEIGHT, exif_of, jpeg, photographed, room_views
from refusing import refused

data = pytest.importorskip("skimage.data")
SIDE = 200  # of the picture of somebody
Somebody = tuple[np.ndarray, np.ndarray]
PLACES = {1: 80, 2: 180}  # photos that somebody walks through, and where


@pytest.fixture(scope="module")
def somebody() -> Somebody:
    """An astronaut, and where she is in the picture."""
    picture = np.asarray(Image.fromarray(data.astronaut()).resize((SIDE, SIDE)))
    return picture, people(picture) > 0


def with_somebody(photo: np.ndarray, left: int, somebody: Somebody) -> tuple[np.ndarray, np.ndarray]:
    """Return the photo with somebody at the bottom, and where."""
    picture, shown = somebody
    pasted, where = photo.copy(), np.zeros(photo.shape[:2], bool)
    place = np.s_[HEIGHT - SIDE :, left : left + SIDE]
    pasted[place][shown], where[place] = picture[shown], shown
    return pasted, where


@pytest.fixture(scope="module")
def visited(somebody, tmp_path_factory) -> Path:
    """Photos of the room, through some of which somebody walks."""
    folder = tmp_path_factory.mktemp("visited") / "photos"
    folder.mkdir()
    for k, view in enumerate(room_views(6)):
        photo = photographed(view)
        photo = with_somebody(photo, PLACES[k], somebody)[0] if k in PLACES else photo
        (folder / view.name).write_bytes(jpeg(photo, exif_of(view)))
    return folder


def views_of(folder: Path) -> list[View]:
    return [replace(view, image_path=folder / view.name) for view in room_views(6)]


def masked(views: Sequence[View]) -> list[int]:
    return [k for k, view in enumerate(views) if view.mask_path is not None]


def test_people_are_found_and_nobody_else(somebody):
    assert 0.4 < somebody[1].mean() < 0.65
    for name in ("coffee", "chelsea", "rocket"):  # a cup, a cat, a rocket
        picture = Image.fromarray(getattr(data, name)())
        picture.thumbnail((finding.SIDE_PIXELS, finding.SIDE_PIXELS))
        assert not people(np.asarray(picture)).any()


def test_groups_are_numbered(somebody):
    two = np.concatenate([somebody[0], np.full((SIDE, 80, 3), 200, np.uint8), somebody[0]], axis=1)
    assert set(np.unique(people(two))) == {0, 1, 2}
    assert not people(np.zeros((0, 5, 3), np.uint8)).size
    with refused("at most 513"):
        people(np.zeros((514, 20, 3), np.uint8))


def test_who_walks_through_is_left_out(visited, somebody, tmp_path):
    views = without_people(views_of(visited), None, tmp_path, threads=2)
    assert masked(views) == list(PLACES)
    for k, left in PLACES.items():
        kept = load_mask(views[k])
        assert kept is not None
        where = with_somebody(photographed(views[k]), left, somebody)[1]
        assert (~kept)[where].mean() > 0.9
        assert (~kept)[~where].mean() < 0.05
    again = without_people(views_of(visited), None, tmp_path / "again", threads=1)
    assert [view.mask_path.read_bytes() for view in again if view.mask_path] == [
        view.mask_path.read_bytes() for view in views if view.mask_path
    ]


def points_of(view: View, photo: np.ndarray, distance: float = 2.0) -> SparsePoints:
    """Points that a photo shows, at a distance, in its colours."""
    rows, columns = np.mgrid[2 : view.height : 5, 2 : view.width : 5]
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(rows.shape)], axis=-1).reshape(-1, 3)
    ahead = pixels @ np.linalg.inv(view.K).T * distance
    colors = photo[rows, columns].reshape(-1, 3) // 2  # of another exposure
    return SparsePoints(ahead @ view.cam_from_world[:3, :3] + view.center, colors)


def test_who_stands_still_is_kept(visited, somebody, tmp_path):
    """A statue has the colours of the points there, somebody who passes has not."""
    view = views_of(visited)[1]
    empty = photographed(view)
    statue = with_somebody(empty, PLACES[1], somebody)[0]
    assert masked(without_people([view], points_of(view, empty), tmp_path)) == [0]
    assert masked(without_people([view], points_of(view, statue), tmp_path)) == []
    few = points_of(view, statue)
    few = SparsePoints(few.positions[:20], few.colors[:20])
    assert masked(without_people([view], few, tmp_path)) == [0]


def options_for(capture: Path, keep_people: bool = False) -> Namespace:
    quiet = partial(track, quiet=True)
    return Namespace(capture=str(capture), keep_people=keep_people, json=False, threads=2, track=quiet)


def test_verbs_look_for_people_unless_somebody_has_decided(visited, tmp_path, capsys):
    views = views_of(visited)
    write_cameras_json(tmp_path / "cameras.json", views)
    with while_left_out(options_for(tmp_path), views, None) as used:
        assert masked(used) == list(PLACES)
        paths = [view.mask_path for view in used if view.mask_path is not None]
        assert all(path.is_file() for path in paths)
    assert not any(path.exists() for path in paths)
    assert capsys.readouterr().err == "drsplat: people in 2 of 6 photos are left out\n"
    own = [replace(views[0], mask_path=visited / "photo_00.jpg"), *views[1:]]
    (tmp_path / "capture.json").write_text('{"num_with_people": null}')
    for options, given in [
        (options_for(visited, keep_people=True), views),
        (options_for(visited), own),
        (options_for(tmp_path), views),
    ]:
        with while_left_out(options, given, None) as used:
            assert used is given
    assert not capsys.readouterr().err


@pytest.mark.slow
@has_colmap
def test_a_capture_leaves_people_out_and_keeps_them_when_asked(visited, tmp_path, capsys):
    assert main(["capture", str(visited), "--output", str(tmp_path / "c"), "--threads", "2"]) == 0
    assert "people in 2 of 6 photos are left out" in capsys.readouterr().out
    assert json.loads((tmp_path / "c/capture.json").read_text())["num_with_people"] == len(PLACES)
    assert sorted(path.name for path in (tmp_path / "c/masks").iterdir()) == [f"photo_0{k}.jpg.png" for k in PLACES]
    line = ["capture", str(visited), "--output", str(tmp_path / "all"), "--threads", "2", "--keep-people", "--json"]
    assert main(line) == 0
    assert json.loads(capsys.readouterr().out)["num_with_people"] is None
    assert not (tmp_path / "all/masks").exists()


@pytest.mark.slow
@has_colmap
def test_a_run_that_is_killed_while_it_looks_for_people_goes_on(visited, tmp_path):
    line = [sys.executable, "-m", "drsplat", "capture", str(visited), "--output", str(tmp_path / "c"), "--threads", "1"]
    process = subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None and not (tmp_path / "c/.work/new/images").exists():
        time.sleep(0.01)
    process.send_signal(signal.SIGTERM)
    process.kill()
    process.wait()
    assert main(line[3:]) == 0
    assert sorted(path.name for path in (tmp_path / "c/masks").iterdir()) == [f"photo_0{k}.jpg.png" for k in PLACES]
    assert len(list((tmp_path / "c/images").iterdir())) == 6
