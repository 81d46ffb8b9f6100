"""`objects` of a scene in tiles: what `field.objects.finding` does, by tasks that leave files.

W goes to the store in pieces. A task adds up a piece, finds the nodes of a block, compares it with others, looks at the
borders of pieces in a view, grows things from some pieces, or describes some nodes.

Held are the rows and nodes of a block, and some bytes of each Gaussian; shapes and W are maps of files.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...formats.tiles import Tiles
from ...scene.gaussians import Gaussians
from ...scene.views import View
from .. import LanguageField
from ..codes import Track, untracked
from ..forest import Objects
from ..objects import finding
from .launching import ONE_PROCESS, Launcher
from .seeing import Gallery, with_tiles
from .store import store_of
from .tasks import ByTasks
from .transposing import filed

OBJECTS_FOLDER = "objects"
ROW_SHAPES: dict[str, tuple[int, ...]] = {"means": (3,), "quats": (4,), "scales": (3,), "opacities": ()}  # of a row


def find_objects(
    field: LanguageField,
    tiles: Tiles,
    *,
    parts: str,
    views: Sequence[View] | None = None,
    launcher: Launcher = ONE_PROCESS,
    threads: int = 0,
    track: Track = untracked,
) -> Objects:
    """Find the things of a scene in tiles; the bits are those of `field.objects.finding.find_objects`.

    parts: as of `register_tiles`. threads: of each worker. track: shows progress.

    Raises: as the other, and as `Launcher.results`.
    """
    field.check_scene(tiles)
    store = store_of(parts)
    scene, scenery = mapped(tiles, store.folder / OBJECTS_FOLDER), Gallery(tiles, store=with_tiles(store, tiles))
    work = ByTasks(store, launcher, threads, track, OBJECTS_FOLDER)
    return finding.find_objects(field, scene, views=views, scenery=scenery, work=work)


def mapped(tiles: Tiles, folder: Path) -> Gaussians:
    """Return the shapes of all Gaussians, mapped from files, without colours."""
    folder.mkdir(parents=True, exist_ok=True)
    means, quats, scales, opacities = (
        filed(
            folder / f"{name}.npy", np.float32, (len(tiles), *shape),
            (getattr(tiles.shapes(tile), name) for tile in tiles.tiles),
        )
        for name, shape in ROW_SHAPES.items()
    )  # fmt: skip
    colours = np.broadcast_to(np.zeros((1, 1, 3), np.float32), (len(tiles), 1, 3))
    return Gaussians(means, quats, scales, opacities, colours, origin=tiles.origin, antialiased=tiles.antialiased)
