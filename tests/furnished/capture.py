"""The room as files, such as a person with a phone, COLMAP and a 3DGS trainer would have them."""

from collections.abc import Sequence
from pathlib import Path

from drsplat.drawing.pictures import as_pixels, write_picture
from drsplat.drawing.rendering import render
from drsplat.formats.gaussian_ply import write_gaussians
from drsplat.formats.langsplat import write_features
from drsplat.scene.views import View
from written_captures import model_of, write_colmap_text

from .masks import MaskMaker
from .room import Room

BACKGROUND = (0.93, 0.94, 0.95)


def write_capture(folder: Path, room: Room, views: Sequence[View], masks: MaskMaker) -> None:
    """scene.ply; images/; sparse/0/ (COLMAP text); language_features/ (LangSplat, one level)."""
    for name in ("images", "sparse/0", "language_features"):
        (folder / name).mkdir(parents=True)
    write_gaussians(folder / "scene.ply", room.gaussians)
    write_colmap_text(folder / "sparse/0", *model_of(views), [])
    for view in views:
        photo = render(room.gaussians, view, background=BACKGROUND).rgb
        write_picture(folder / "images" / view.name, as_pixels(photo), overwrite=False)
        seen = masks.features(view)
        write_features(folder / "language_features", Path(view.name).stem, seen.mask_ids, seen.embeddings)
