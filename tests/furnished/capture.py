"""The room as files, such as a person with a phone, COLMAP and a 3DGS trainer would have them."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from scipy.spatial.transform import Rotation

from drsplat.drawing.pictures import as_pixels, write_picture
from drsplat.drawing.rendering import render
from drsplat.formats.gaussian_ply import write_gaussians
from drsplat.formats.langsplat import write_features
from drsplat.formats.replacing import replacing
from drsplat.scene.views import View

from .masks import MaskMaker
from .room import Room

BACKGROUND = (0.93, 0.94, 0.95)


def write_capture(folder: Path, room: Room, views: Sequence[View], masks: MaskMaker) -> None:
    """scene.ply; images/; sparse/0/ (COLMAP text); language_features/ (LangSplat, one level)."""
    for name in ("images", "sparse/0", "language_features"):
        (folder / name).mkdir(parents=True)
    write_gaussians(folder / "scene.ply", room.gaussians)
    write_model(folder / "sparse/0", views)
    for view in views:
        photo = render(room.gaussians, view, background=BACKGROUND).rgb
        write_picture(folder / "images" / view.name, as_pixels(photo), overwrite=False)
        seen = masks.features(view)
        write_features(folder / "language_features", Path(view.name).stem, seen.mask_ids, seen.embeddings)


def write_model(folder: Path, views: Sequence[View]) -> None:
    """A COLMAP text model without points.

    Source: https://colmap.github.io/format.html
    """
    cameras = [_camera_line(index, view) for index, view in enumerate(views, 1)]
    images = [_image_lines(index, view) for index, view in enumerate(views, 1)]
    for name, lines in (("cameras.txt", cameras), ("images.txt", images), ("points3D.txt", [])):
        with replacing(folder / name) as file:
            file.write("".join(lines).encode())


def _camera_line(index: int, view: View) -> str:
    intrinsics = (view.K[0, 0], view.K[1, 1], view.K[0, 2], view.K[1, 2])
    return f"{index} PINHOLE {view.width} {view.height} {_numbers(intrinsics)}\n"


def _image_lines(index: int, view: View) -> str:
    x, y, z, w = Rotation.from_matrix(view.cam_from_world[:3, :3]).as_quat()
    return f"{index} {_numbers((w, x, y, z, *view.cam_from_world[:3, 3]))} {index} {view.name}\n\n"


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
