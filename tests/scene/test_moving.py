"""Scenes that move: between their times, in both formats, and against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drsplat import Gaussians, write_gaussians
from drsplat.errors import MismatchError
from drsplat.formats.moving_scenes import MOTION, SCENE, is_moving, read_moving, read_scene, write_moving
from drsplat.scene.moving import Frames, Moving, between
from moving_scenes import drifting, still
from refusing import malformed, refused
from scene_files import ply_bytes, ply_columns
from scenes import random_gaussians

SHAPES = ("means", "quats", "scales", "opacities", "sh")


def same(one: Gaussians, other: Gaussians, tolerance: float = 0.0) -> bool:
    return all(np.abs(getattr(one, name) - getattr(other, name)).max() <= tolerance for name in SHAPES)


@given(time=st.floats(0, 1))
def test_what_stands_still_keeps_its_bits_at_every_time(time):
    gaussians = random_gaussians(40)
    assert same(still(gaussians).at(time), gaussians)


@given(time=st.floats(0, 2))
def test_between_frames_means_go_straight(time):
    moving = drifting()
    first, last = moving.at(0.0).means.astype(np.float64), moving.at(2.0).means.astype(np.float64)
    assert np.abs(moving.at(time).means - (first + (last - first) * time / 2)).max() < 1e-5


def test_a_rotation_goes_the_shorter_way_and_stays_a_rotation():
    gaussians = random_gaussians(3)
    half = np.sqrt(0.5)
    one = replace(gaussians, quats=np.float32([[1, 0, 0, 0], [1, 0, 0, 0], [0, 1, 0, 0]]))
    other = replace(gaussians, quats=np.float32([[half, 0, 0, half], [-1, 0, 0, 0], [0, 1, 0, 0]]))
    middle = between(one, other, 0.5).quats
    eighth = np.pi / 8  # half of a quarter turn; a quaternion has half of the angle
    assert np.allclose(middle[0], [np.cos(eighth), 0, 0, np.sin(eighth)], atol=1e-6)
    assert np.array_equal(middle[1:], one.quats[1:])  # q and -q are one rotation


def test_a_frame_has_the_rows_and_the_fingerprint_of_the_canonical_scene():
    moving = drifting()
    assert moving.at(1.3).fingerprint == moving.canonical.fingerprint
    assert len(moving.at(1.3)) == len(moving) == 120
    assert not np.array_equal(moving.at(1.3).means, moving.canonical.means)
    own = [replace(moving.at(time)) for time in moving.times.tolist()]
    assert Moving(own[0], moving.times, Frames(moving.times, own.__getitem__)).at(2.0).fingerprint == own[0].fingerprint
    assert own[-1].fingerprint != own[0].fingerprint  # what was given stays what it is


def test_two_frames_are_held_and_no_more():
    gaussians, read = random_gaussians(5), []

    def frame(number):
        read.append(number)
        return gaussians

    frames = Frames(np.arange(5.0), frame)
    for time in (0.5, 0.7, 1.0, 0.2, 3.5, 0.5):
        frames.at(time)
    assert read == [0, 1, 3, 4, 0, 1]


@pytest.mark.parametrize("time", [-0.1, 2.1, np.inf, np.nan])
def test_a_time_outside_of_the_span_is_refused(time):
    with refused("outside of this scene's span, 0 to 2"):
        drifting().at(time)


def test_the_ends_of_the_span_forgive_rounding():
    assert same(drifting().at(2 + 1e-10), drifting().at(2.0))


@pytest.mark.parametrize("times", [[0.0], [0, 0], [1, 0], [0, np.nan], [0, np.inf]])
def test_times_have_to_increase(times):
    stamps = np.array(times, np.float64)
    with refused("times: expected"):
        Moving(random_gaussians(3), stamps, Frames(stamps, lambda _: random_gaussians(3)))


def test_both_formats_agree_on_one_scene(tmp_path):
    """Values pass through logarithms in PLY files."""
    film = drifting()
    write_moving(tmp_path / "film.motion", film)
    write_moving(tmp_path / "frames", film)
    ours, frames = read_moving(tmp_path / "film.motion"), read_moving(tmp_path / "frames", film.span)
    assert np.allclose(ours.times, film.times)
    for time in (*film.span, *np.linspace(*film.span, 7)[1:-1]):
        assert same(ours.at(time), film.at(time), 2e-6)
        assert same(frames.at(time), film.at(time), 2e-6)


def test_spacetime_gaussians_are_not_taken_for_a_still_scene(tmp_path):
    columns = ply_columns(random_gaussians(3)) | {"trbf_center": np.zeros(3, np.float32)}
    (tmp_path / "film.ply").write_bytes(ply_bytes(columns))
    with malformed("numbered PLY files"):
        read_scene(tmp_path / "film.ply")


def test_our_motion_is_read_as_it_was_written(tmp_path):
    moving = drifting()
    write_moving(tmp_path / "a.motion", moving)
    again = read_scene(tmp_path / "a.motion" / MOTION)
    assert isinstance(again, Moving)
    assert again.canonical.fingerprint == moving.canonical.fingerprint
    assert np.array_equal(again.times, moving.times)
    for time in (0.0, 0.5, 1.7):
        assert np.array_equal(again.at(time).means, moving.at(time).means)
        assert same(again.at(time), moving.at(time), 1e-6)


def test_a_scene_far_from_zero_moves_where_it_is(tmp_path):
    near = drifting()
    far = np.array([2.0**19, 2.0**22, 0.0])  # what a reader counts from as well
    frames = [replace(near.at(time), origin=far) for time in near.times.tolist()]
    moving = Moving(frames[0], near.times, Frames(near.times, frames.__getitem__))
    write_moving(tmp_path / "far.motion", moving)
    write_moving(tmp_path / "far", moving)
    for folder in ("far.motion", "far"):
        times = (0.0, 2.0) if folder == "far" else None
        at = read_moving(tmp_path / folder, times).at(1.25)
        assert np.abs(at.positions - far - near.at(1.25).means).max() < 1e-5


@pytest.mark.parametrize(("names", "times"), [(("time_00000", "time_00001", "time_00004"), [0, 1, 4]),
                                              (("frame0001", "frame0002", "frame0010"), [1, 2, 10])])  # fmt: skip
def test_numbered_ply_files_are_a_scene_that_moves(tmp_path, names, times):
    for number, name in enumerate(names):
        write_gaussians(tmp_path / f"{name}.ply", random_gaussians(20, number))
    moving = read_moving(tmp_path)
    assert moving.times.tolist() == times
    assert np.array_equal(moving.at(times[1]).means, random_gaussians(20, 1).means)
    assert read_moving(tmp_path, times=(0.0, 1.0)).times.tolist() == [0, 0.5, 1]


def test_frames_of_other_counts_are_refused(tmp_path):
    write_gaussians(tmp_path / "frame0.ply", random_gaussians(20))
    write_gaussians(tmp_path / "frame1.ply", random_gaussians(21))
    with malformed(r"frame1.ply: 21 rows, frame0.ply has 20: rows are one Gaussian"):
        read_scene(tmp_path)


def test_two_sequences_in_a_folder_are_refused(tmp_path):
    for name in ("a0", "a1", "b0"):
        write_gaussians(tmp_path / f"{name}.ply", random_gaussians(5))
    with malformed(r"got a\*.ply and b\*.ply"):
        read_scene(tmp_path)
    (tmp_path / "b0.ply").rename(tmp_path / "a00.ply")
    with malformed("the same number"):
        read_scene(tmp_path)


def test_a_frame_with_other_harmonics_is_refused_when_it_is_needed(tmp_path):
    write_gaussians(tmp_path / "f0.ply", random_gaussians(5, sh_degree=1))
    write_gaussians(tmp_path / "f1.ply", random_gaussians(5, sh_degree=0))
    moving = read_moving(tmp_path)
    moving.at(0)
    with malformed("harmonics"):
        moving.at(1)


def test_still_scenes_are_read_as_before(tmp_path):
    write_gaussians(tmp_path / "scene.ply", random_gaussians(5))
    assert isinstance(read_scene(tmp_path / "scene.ply"), Gaussians)
    assert not is_moving(tmp_path / "scene.ply")
    with refused("stands still"):
        read_moving(tmp_path / "scene.ply")
    with refused("numbered PLY files only"):
        read_scene(tmp_path / "scene.ply", times=(0.0, 1.0))


def test_motion_of_other_gaussians_is_refused(tmp_path):
    write_moving(tmp_path / "a.motion", drifting())
    write_gaussians(tmp_path / "a.motion" / SCENE, random_gaussians(120, 9), overwrite=True)
    with pytest.raises(MismatchError, match="keep the two files together"):
        read_scene(tmp_path / "a.motion")


def test_nothing_is_replaced_unasked(tmp_path):
    for name in ("a.motion", "frames"):
        write_moving(tmp_path / name, drifting(10))
        with refused("exists already"):
            write_moving(tmp_path / name, drifting(10))
        write_moving(tmp_path / name, drifting(11), overwrite=True)
        assert len(read_moving(tmp_path / name)) == 11
    (tmp_path / "other").mkdir()
    with refused("not ours to replace"):
        write_moving(tmp_path / "other", drifting(10), overwrite=True)
