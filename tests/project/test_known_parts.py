"""Registration on the shipped scene, against a truth that is known of every Gaussian."""

from pathlib import Path

import pytest

import drsplat as ds
from known_parts import divide, search_parts


@pytest.mark.slow
def test_parts_of_the_shipped_scene_are_found_again():
    folder = Path(ds.__file__).parent / "evaluation/demo/scene"
    gaussians = ds.read_gaussians(folder / "scene.compressed.ply")
    views = [view.resized(240, 180) for view in ds.read_views(folder)[::2]]
    parts = divide(gaussians, 12)
    found = search_parts(gaussians, views, parts)
    assert found.registration.num_registered > 0.9 * len(gaussians)
    assert found.ious.mean() > 0.95
    assert found.ious.min() > 0.9
    rows = found.field.gaussian_ids
    inside = parts.margin[rows] > 2 * gaussians.scales[rows].max(1)
    assert inside.mean() > 0.8
    assert found.wrong[inside].mean() < 0.01
