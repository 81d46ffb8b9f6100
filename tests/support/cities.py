"""The toy's room as a city: in tiles of 37 Gaussians, and the same rows in one file, with one field of both."""

import shutil
from dataclasses import replace
from pathlib import Path

import drsplat as ds
from drsplat.field.tiles.cutting import cut
from drsplat.formats.sources import blocks_of
from toy_capture import balls_field, write_toy_capture

ROWS = 37  # of a tile: each ball lies in several


def write_city(folder: Path) -> Path:
    """In `tiled` and in `whole`: a scene, its field with two objects, and the photos."""
    tiled, whole = write_toy_capture(folder / "tiled"), folder / "whole"
    tiles = cut(blocks_of([tiled / "scene.ply"]), tiled / "city.tiles", ROWS)
    for name in ("scene.ply", "points.ply"):
        (tiled / name).unlink()
    shutil.rmtree(tiled / "frames")
    balls_field(tiled, tiles.gaussians()).save(tiled / "city.field")
    for part in ("sparse", "transforms.json"):
        if (tiled / part).exists():
            shutil.move(tiled / part, tiled / "capture" / part)
    shutil.copytree(tiled, whole, ignore=shutil.ignore_patterns("city.tiles"))
    ds.write_gaussians(whole / "scene.ply", replace(tiles.gaussians(), extra={}))
    return folder
