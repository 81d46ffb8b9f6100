"""A tileset of ours in CesiumJS, in a real browser: where it lies, which level is loaded, and what is shown."""

import numpy as np
import pytest

from browsing import a_page, eventually, needs_chromium, pixels_of
from drsplat.formats.georeference import Georeference
from drsplat.formats.tiles3d_writing import write_tiles3d
from drsplat.scene.gaussians import Gaussians
from drsplat.scene.labelled import LabelledScene
from foreign_programs import needs_packages
from foreign_viewing import serving
from scenes import gaussians_at

pytestmark = [needs_chromium, needs_packages("cesium"), pytest.mark.oracle, pytest.mark.slow]
NORTH_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # of a PLY, whose y is down
COUNT, ROWS = 400, 100


def wall() -> Gaussians:
    """Make a wall that faces south: green above, red below on its left, and blue below on its right."""
    rng = np.random.default_rng(0)
    means = rng.uniform(-1, 1, (COUNT, 3)) * [3, 3, 0.05]
    above, left = means[:, 1] < 0, means[:, 0] < 0
    colors = np.where(above[:, None], [0, 1, 0], np.where(left[:, None], [1, 0, 0], [0, 0, 1]))
    return gaussians_at(means, 0.15, colors)


@pytest.mark.parametrize(("error", "splats"), [(0.01, COUNT), (100.0, ROWS)])
def test_cesium_draws_our_tilesets(error, splats, chromium, tmp_path):
    """From the south: what is above is above, west is left. A large error allows for the coarsest level."""
    place = Georeference(8.5, 47.4, 400.0, NORTH_UP, 2.0)
    write_tiles3d(tmp_path / "out", LabelledScene(wall()), georeference=place, rows=ROWS)
    with serving(tmp_path / "out") as address, a_page(chromium, 320, 240) as page:
        page.goto(f"{address}/tiles3d.html?error={error}&scene=/scene")
        page.wait_for_function("window.loaded || window.failed")
        eventually(lambda: page.evaluate("window.numSplats()") == splats)
        page.wait_for_timeout(3000)
        pixels = pixels_of(page, 320)
        failed, center = page.evaluate("[window.failed ?? null, window.center]")
    assert failed is None
    expected = np.radians([8.5, 47.4])
    np.testing.assert_allclose([center["longitude"], center["latitude"]], expected, atol=1e-6)
    shown = pixels.max(axis=2) > 0.4
    ys, xs = np.nonzero(shown)
    assert len(ys) > 1000
    top, low = ys < np.median(ys) - 15, ys > np.median(ys) + 15
    west, east = xs < np.median(xs) - 15, xs > np.median(xs) + 15
    for where, channel in ((top, 1), (low & west, 0), (low & east, 2)):
        assert pixels[ys[where], xs[where]].mean(0).argmax() == channel
