"""Films as photos: which frames are chosen, and poses of a film of the made-up room."""

import json
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import UInt8
from PIL import Image, ImageFilter
from test_capture import differences, has_colmap

from drsplat.cli import main
from drsplat.formats.captures import read_views
from drsplat.photos.capture.capturing import capture
from drsplat.photos.capture.videos import Film, choose, is_video, movement, shift_of, some_frames
from photographed_room import photographed, room_views
from refusing import refused

has_av = pytest.mark.skipif(find_spec("av") is None, reason='needs pip install "drsplat[capture]"')
TEXTURE = np.random.default_rng(0).integers(0, 255, (260, 400), np.uint8)
SMOOTH = np.asarray(Image.fromarray(TEXTURE).filter(ImageFilter.GaussianBlur(2)))


def write_film(path: Path, frames: Sequence[UInt8[np.ndarray, "h w 3"]]) -> None:
    import av

    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=24)
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt, stream.bit_rate = "yuv420p", 20_000_000
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())


def blurred(frame: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    return np.asarray(Image.fromarray(frame).filter(ImageFilter.GaussianBlur(6)))


@pytest.mark.parametrize("shift", [(0, 0), (3, 0), (-5, 8), (0, -12)])
def test_a_shift_is_found(shift):
    down, across = shift
    before, now = SMOOTH[50:114, 60:124], SMOOTH[50 + down : 114 + down, 60 + across : 124 + across]
    assert shift_of(before, now) == pytest.approx(np.hypot(down, across), abs=1.5)


def test_a_picture_without_texture_has_not_moved():
    grey = np.full((192, 256), 90, np.uint8)
    assert movement(grey, grey) == 0


def test_movement_is_a_share_of_the_width():
    assert movement(SMOOTH[:192, :256], SMOOTH[:192, 8:264]) == pytest.approx(8 / 256, abs=0.004)


def test_frames_follow_the_picture_and_not_the_clock():
    """A walk, then a stop, then a walk twice as fast: frames are chosen by the way."""
    moved = np.concatenate([np.full(200, 0.02), np.zeros(300), np.full(100, 0.04)])
    choice = choose(Film(np.full(600, 10.0), moved))
    stopped = (choice.frames >= 201) & (choice.frames < 500)
    assert stopped.sum() <= 1
    walked, ran = (choice.frames < 200).sum(), (choice.frames >= 500).sum()
    assert walked == pytest.approx(ran, abs=3)
    assert choice.num_still == 300


def test_the_sharpest_frame_of_each_step_is_chosen_and_blurred_ones_never():
    rng = np.random.default_rng(0)
    sharpness = rng.uniform(9, 11, 400)
    sharpness[100:110] = 2
    choice = choose(Film(sharpness, np.full(400, 0.012)))
    assert not ((choice.frames >= 100) & (choice.frames < 110)).any()
    assert choice.num_blurred == 10
    assert sharpness[choice.frames].mean() > 10.4


def test_long_films_do_not_give_more_photos_than_can_be_matched():
    assert len(choose(Film(np.full(50_000, 10.0), np.full(50_000, 0.05))).frames) <= 1001


@pytest.mark.slow
@has_colmap
@has_av
def test_a_film_of_the_room_is_posed(tmp_path, capsys):
    """Every frame comes twice, and every fourth once more, blurred."""
    views = room_views(20)
    frames, index_of_view = [], []
    for k, view in enumerate(views):
        pixels = photographed(view)
        index_of_view += [k, k] + [-1] * (k % 4 == 1)
        frames += [pixels, pixels] + [blurred(pixels)] * (k % 4 == 1)
    write_film(tmp_path / "walk.mp4", frames)
    assert is_video(tmp_path / "walk.mp4")
    line = ["capture", str(tmp_path / "walk.mp4"), "--output", str(tmp_path / "capture"), "--threads", "2"]
    assert main(line) == 0
    assert "became photos" in capsys.readouterr().out
    record = json.loads((tmp_path / "capture/capture.json").read_text())
    assert record["video"]["num_frames"] == len(frames)
    assert record["video"]["num_blurred"] >= 5
    posed = read_views(tmp_path / "capture")
    chosen = [index_of_view[int(view.name[6:12])] for view in posed]
    assert -1 not in chosen
    assert len(set(chosen)) == len(chosen) > 12
    away, turned, tilt = differences(posed, [views[k] for k in chosen])
    assert away < 0.01
    assert turned < 0.5
    assert tilt < 3
    before = read_views(tmp_path / "capture")
    assert main([*line, "--scale", "2", "--overwrite"]) == 0
    assert np.linalg.norm(read_views(tmp_path / "capture")[0].center) == pytest.approx(
        2 * np.linalg.norm(before[0].center)
    )


@pytest.mark.slow
@has_colmap
@has_av
def test_films_that_show_nothing_are_errors(tmp_path):
    still = np.repeat(SMOOTH[:192, :256, None], 3, axis=2)
    write_film(tmp_path / "still.mp4", [still] * 30)
    with refused(r"the camera hardly moves \(30 frames"):
        capture(tmp_path / "still.mp4", tmp_path / "c")
    (tmp_path / "text.mp4").write_text("no film")
    with refused("cannot be read as a video"):
        capture(tmp_path / "text.mp4", tmp_path / "c")
    whole = (tmp_path / "still.mp4").read_bytes()
    (tmp_path / "cut.mp4").write_bytes(whole[: len(whole) // 2])
    with refused(r"cannot be read as a video|no picture|hardly moves"):
        capture(tmp_path / "cut.mp4", tmp_path / "c")
    (tmp_path / "empty.mp4").touch()
    with refused("cannot be read as a video: it is empty, damaged or cut off"):
        capture(tmp_path / "empty.mp4", tmp_path / "c")


@has_colmap
@has_av
def test_a_film_of_sound_alone_is_an_error(tmp_path):
    import av

    with av.open(str(tmp_path / "sound.mp4"), "w") as container:
        stream = container.add_stream("aac", rate=44100)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 44100), np.float32), format="fltp", layout="mono")
        frame.sample_rate = 44100
        for packet in [*stream.encode(frame), *stream.encode()]:
            container.mux(packet)
    with refused("there are no pictures in it, sound alone"):
        capture(tmp_path / "sound.mp4", tmp_path / "c")


@has_av
def test_some_frames_are_evenly_spaced(tmp_path):
    greys = [np.full((48, 64, 3), 10 * number, np.uint8) for number in range(24)]
    write_film(tmp_path / "film.mp4", greys)
    shown = [float(frame.mean()) / 10 for frame in some_frames(tmp_path / "film.mp4", 4)]
    assert len(shown) == 4
    assert shown == sorted(shown)
    assert shown[-1] > shown[0] + 5
