"""`drsplat capture` on real photos whose poses other programs have found."""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from test_capture import differences

from drsplat.formats.captures import read_views
from drsplat.formats.georeference import read_georeference
from drsplat.photos.capture.capturing import capture
from drsplat.scene.geodesy import local_offsets

DATA = Path(__file__).resolve().parents[3] / "shared/data"
pytestmark = [
    pytest.mark.data,
    pytest.mark.slow,
    pytest.mark.skipif(not (DATA / "plush").is_dir(), reason="the shared real captures are not here"),
    pytest.mark.skipif(find_spec("pycolmap") is None, reason='needs pip install "drsplat[capture]"'),
]


def test_part_of_the_plush_capture_without_its_poses(tmp_path):
    """Every fourth photo. One overlaps so little that global mapping poses it 50 degrees off, on a single point."""
    photos = tmp_path / "photos"
    photos.mkdir()
    for path in sorted((DATA / "plush/images").iterdir())[::4]:
        (photos / path.name).symlink_to(path)
    record = capture(photos, tmp_path / "capture")
    assert record["num_photos"] == 25
    assert record["num_registered"] >= 24
    given = {view.name: view for view in read_views(DATA / "plush")}
    posed = read_views(tmp_path / "capture")
    away, turned, _ = differences(posed, [given[view.name] for view in posed])
    print(f"centres {100 * away:.2f} % of the mean radius (median), rotations at most {turned:.2f} degrees")
    assert away < 0.01
    assert turned < 2


def test_drone_photos_are_placed_by_their_exif_alone(tmp_path):
    record = capture(DATA / "brighton_beach/images", tmp_path / "capture")
    assert (record["num_registered"], record["unit"], record["up_from"]) == (18, "m", "GPS")
    assert record["gps_residual_m"] < 0.6
    given = {view.name: view for view in read_views(DATA / "brighton_beach")}
    posed = read_views(tmp_path / "capture")
    away, turned, tilt = differences(posed, [given[view.name] for view in posed])
    assert away < 0.01
    assert turned < 1
    assert tilt < 3
    ours, theirs = (read_georeference(folder) for folder in (tmp_path / "capture", DATA / "brighton_beach"))
    here, there = (np.array([view.center for view in each]) for each in (posed, [given[v.name] for v in posed]))
    origin = (theirs.longitude, theirs.latitude, theirs.height)
    apart = local_offsets(origin, ours.positions(here)) - local_offsets(origin, theirs.positions(there))
    print(f"cameras on the Earth: {np.linalg.norm(apart, axis=1).max():.2f} m at most from the given ones")
    assert np.linalg.norm(apart, axis=1).max() < 1
    spread = [np.linalg.norm(each - each.mean(axis=0)) for each in (here, there)]
    assert spread[0] / spread[1] == pytest.approx(1, abs=0.02)
