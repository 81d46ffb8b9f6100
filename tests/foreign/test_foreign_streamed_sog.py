"""A streamed SOG of ours in PlayCanvas's engine, level by level, and one of splat-transform's read here."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

import drsplat as ds
from browsing import needs_chromium
from drsplat.formats.streamed_sog import LOD_META, counts_of_levels, read_streamed_sog, write_streamed_sog
from drsplat.scene.labelled import LabelledScene
from foreign_programs import needs_node, needs_packages, splat_transform
from foreign_viewing import colourful, pictured, psnr, zoomed
from scene_files import random_gaussians

pytestmark = [pytest.mark.oracle, pytest.mark.slow]
LEAST_PSNR = 31.0  # dB; measured 33.4 and 34.2, of another level 17


@needs_chromium
@needs_packages("playcanvas")
@pytest.mark.parametrize("level", [0, 2])
def test_playcanvas_draws_the_level_that_we_read(level, edited_room, tmp_path, chromium):
    """Its Gaussians end a little earlier than ours. The other level would be another picture."""
    scene = replace(colourful(ds.read_gaussians(edited_room / "scene.ply")), extra={})
    write_streamed_sog(tmp_path / "out" / LOD_META, LabelledScene(scene), leaf_rows=500, chunk_rows=1200)
    view = zoomed(ds.read_views(edited_room / "capture")[0])
    shown = pictured(chromium, "playcanvas", tmp_path / "out", view, level=level)
    drawn = {one: ds.render(read_streamed_sog(tmp_path / "out" / LOD_META, one), view) for one in (0, 2)}
    same, other = (psnr(shown, drawn[one].rgb, drawn[level].alpha > 0.01) for one in (level, 2 - level))
    print(f"level {level}: PSNR {same:.1f} dB, of the other level {other:.1f}")
    assert same > LEAST_PSNR > other


@needs_node
@needs_packages("@playcanvas/splat-transform")
def test_what_splat_transform_writes_is_read(tmp_path):
    fine, coarse = (random_gaussians(np.random.default_rng(seed), 400 // (1 + 3 * seed), 1) for seed in (0, 1))
    for name, scene in (("fine.ply", fine), ("coarse.ply", coarse)):
        ds.write_gaussians(tmp_path / name, scene)
    (tmp_path / "out").mkdir()
    splat_transform(tmp_path / "fine.ply", "-l", 0, tmp_path / "coarse.ply", "-l", 1, tmp_path / "out" / LOD_META)
    assert counts_of_levels(tmp_path / "out" / LOD_META) == [400, 100]
    for level, scene in enumerate((fine, coarse)):
        read = read_streamed_sog(tmp_path / "out" / LOD_META, level)
        apart, rows = cKDTree(scene.means).query(read.means)
        assert apart.max() < 1e-3
        assert len(np.unique(rows)) == len(scene)
