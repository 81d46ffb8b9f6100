"""Make the pictures of docs/export.md: the demo's room in programs of others.

    python scripts/make_export_pictures.py DEMO OUTPUT_DIR

Writes export_viewers.jpg, the same photo's camera in drsplat and three viewers of the web, and export_earth.jpg, the
room on the Earth in CesiumJS. Needs Chromium, `pip install playwright` and `npm install --prefix tests/foreign`.
"""

import argparse
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests/support"))

import drsplat as ds
from browsing import a_browser
from drsplat.authoring.exporting import export, labelled
from drsplat.authoring.exporting.writing import written_tiles3d
from drsplat.drawing.pictures import contact_sheet, titled
from drsplat.formats.axes import HALF_TURN, Z_UP_FROM_PLY, standing_as_ply, standing_up
from drsplat.formats.georeference import Georeference
from drsplat.scene.geodesy import enu_axes, geocentric
from drsplat.scene.labelled import LabelledScene
from foreign_viewing import pictured, turned

WIDTH, HEIGHT, GAP = 480, 360, 8
LONGITUDE, LATITUDE = 8.55, 47.37
EYE, TARGET = (3.9, -4.2, 3.0), (-0.35, 0.4, 0.55)  # metres east, north and up of the room's origin
LOW, HIGH = (-2.4, -1.75, -0.1), (1.55, 2.35, 2.2)  # what is left of the room: without the two walls in front
QUALITY = 88


def place_of(scene: LabelledScene) -> Georeference:
    """Return a place on the Earth where the lowest of the room's floor touches the ground."""
    enu = Z_UP_FROM_PLY @ standing_as_ply(np.array(scene.up))
    low = np.quantile((scene.gaussians.positions @ enu.T)[:, 2], 0.001)
    return Georeference(LONGITUDE, LATITUDE, float(-low), enu, 1.0)


def earth_from_enu(place: Georeference) -> np.ndarray:
    at = (place.longitude, place.latitude, place.height)
    matrix = turned(enu_axes(at).T)
    matrix[:3, 3] = geocentric(np.array([at]))[0]
    return matrix


def opened(scene: LabelledScene) -> LabelledScene:
    """Return the room without the walls that one would look through."""
    means = scene.gaussians.positions
    kept = ((means > LOW) & (means < HIGH)).all(axis=1)
    owners = None if scene.object_of is None else scene.object_of[kept]
    return replace(scene, gaussians=scene.gaussians.subset(kept), object_of=owners)


def from_outside(view: ds.View) -> ds.View:
    """Return a view of the room's surroundings, in metres east, north and up."""
    forward = np.subtract(TARGET, EYE) / np.linalg.norm(np.subtract(TARGET, EYE))
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = [right, np.cross(forward, right), forward]
    pose[:3, 3] = -pose[:3, :3] @ EYE
    return replace(view, cam_from_world=pose)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("demo", type=Path)
    parser.add_argument("output", type=Path)
    given = parser.parse_args()
    scene = labelled(ds.open_scene(given.demo), edits="none")
    view = ds.read_views(given.demo)[0].resized(WIDTH, HEIGHT)
    place = place_of(scene)
    earth = earth_from_enu(place)
    with tempfile.TemporaryDirectory() as name, a_browser() as browser:
        folder = Path(name)
        for file in ("room.glb", "room.spz"):
            export(folder / file, scene)
        written_tiles3d(folder / "tiles", scene, place)
        up, on_earth = np.array(scene.up), earth @ turned(place.enu_from_world)
        shown = {
            "drsplat": np.clip(ds.render(scene.gaussians, view).rgb, 0, 1),
            "PlayCanvas, GLB": pictured(browser, "playcanvas", folder / "room.glb", view, turned(standing_up(up))),
            "Spark, SPZ": pictured(browser, "spark", folder / "room.spz", view, turned(HALF_TURN)),
            "CesiumJS, 3D Tiles": pictured(browser, "tiles3d", folder / "tiles", view, on_earth),
        }
        written_tiles3d(folder / "opened", opened(scene), place)
        outside = pictured(browser, "tiles3d", folder / "opened", from_outside(view), earth, globe=True)
    tiles = [titled((picture * 255).astype(np.uint8), title) for title, picture in shown.items()]
    given.output.mkdir(parents=True, exist_ok=True)
    Image.fromarray(contact_sheet(tiles, 2, tile_width=WIDTH, gap=GAP)).save(
        given.output / "export_viewers.jpg", quality=QUALITY
    )
    Image.fromarray((outside * 255).astype(np.uint8)).save(given.output / "export_earth.jpg", quality=QUALITY)


if __name__ == "__main__":
    main()
