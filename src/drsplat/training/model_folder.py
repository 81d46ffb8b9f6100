"""The folder of a trained scene, laid out as tools for 3DGS expect it.

    point_cloud/iteration_N/point_cloud.ply   the Gaussians
    cameras.json                              the poses
    cfg_args                                  what 3DGS tools read to find the photos
    input.ply                                 the points that it started from
    settings.json                             every hyper-parameter
    test/NAME.png                             held-out photo, rendering, 4 x difference
    masks/NAME.png                            black where a photo shows what moves, or its mask leaves out
    results.json                              the measures; written last
    checkpoint.safetensors                    where an unfinished or a longer run goes on

Each file appears whole or not at all.
"""

import re
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..formats.captures import SparsePoints
from ..formats.gaussian_ply import write_gaussians
from ..formats.json_files import write_json
from ..formats.mask_files import FOLDER as MASKS
from ..formats.mask_files import photo_folder
from ..formats.ply import write_vertices
from ..formats.poses import write_cameras_json
from ..formats.replacing import LOCK, claimed_folder, replacing
from ..scene.gaussians import Gaussians, local_origin
from ..scene.views import View
from .settings import TrainingSettings

CHECKPOINT = "checkpoint.safetensors"
_LEFT_BEHIND = re.compile(r"\.[0-9a-f]{16}\.tmp")  # by a run that was killed while it wrote


@contextmanager
def model_folder(path: str | Path | None, overwrite: bool) -> Iterator["ModelFolder | None"]:
    """Prepare the folder and hold it against other processes while the block runs; None for None.

    Raises: InputError: as `ModelFolder.prepare`; another process trains in it.
    """
    if path is None:
        yield None
        return
    folder = ModelFolder(path)
    with claimed_folder(folder.path):
        folder.prepare(overwrite)
        yield folder


class ModelFolder:
    """One folder; nothing is written before `prepare`, which says whether a run in it goes on."""

    goes_on = False

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.start = self.path / "input.ply"
        self.checkpoint = self.path / CHECKPOINT
        self.results = self.path / "results.json"
        self.test_pictures = self.path / "test"
        self.masks = self.path / MASKS

    def prepare(self, overwrite: bool) -> None:
        """Take the folder over; a run that is in it goes on, unless `overwrite`.

        Raises: InputError: it holds anything else and not `overwrite`.
        """
        if overwrite:
            self._clear()
        self.goes_on = self.checkpoint.is_file()
        names = [file.name for file in self.path.iterdir()]
        left_behind = list(filter(_LEFT_BEHIND.fullmatch, names))
        early = {"cameras.json", "cfg_args", "settings.json", "input.ply", LOCK}  # before the first checkpoint
        if not (overwrite or self.goes_on or early.union(left_behind).issuperset(names)):
            raise InputError(
                f"{self.path} is not empty and holds no run to go on with: pass overwrite=True "
                "to replace the model in it, or name another output folder"
            )
        for name in left_behind:
            (self.path / name).unlink(missing_ok=True)

    def _clear(self) -> None:
        """Remove what another run may have left and this one might not replace."""
        for file in (self.results, self.checkpoint):
            file.unlink(missing_ok=True)
        for file in self.path.glob("point_cloud/iteration_*/point_cloud.ply"):
            file.unlink()
            if not any(file.parent.iterdir()):
                file.parent.rmdir()
        for pictures in (self.test_pictures, self.masks):
            shutil.rmtree(pictures, ignore_errors=True)

    def write_start(self, views: Sequence[View], points: SparsePoints) -> None:
        """Write cameras.json and input.ply. views: with photos."""
        # trained on photos whose lens was undone, so the cameras have none
        undistorted = [replace(view, distortion=None) for view in views]
        write_cameras_json(self.path / "cameras.json", undistorted, overwrite=True)
        zeros = np.zeros(len(points.positions), np.float32)
        kept = np.float64 if local_origin(points.positions).any() else np.float32
        columns = dict(zip("xyz", points.positions.astype(kept).T, strict=True))
        columns |= dict.fromkeys(("nx", "ny", "nz"), zeros)
        write_vertices(
            self.start, (columns | dict(zip(("red", "green", "blue"), points.colors.T, strict=True))), overwrite=True
        )

    def write_settings(self, views: Sequence[View], settings: TrainingSettings) -> None:
        """Write settings.json, and cfg_args: the arguments of 3DGS that other tools read back, as it writes them."""
        self.write_json("settings.json", asdict(settings))
        source, images = photo_folder(views[0]), "."
        if source.name.startswith("images"):
            source, images = source.parent, source.name
        arguments = {
            "data_device": "cpu", "eval": settings.test_every > 0, "images": images,
            "model_path": str(self.path.absolute()), "resolution": -1, "sh_degree": settings.sh_degree,
            "source_path": str(source.absolute()), "white_background": settings.background == "white",
        }  # fmt: skip
        text = f"Namespace({', '.join(f'{name}={value!r}' for name, value in arguments.items())})"
        with replacing(self.path / "cfg_args", overwrite=True) as file:
            file.write(text.encode())

    def write_scene(self, iteration: int, gaussians: Gaussians) -> Path:
        path = self.path / "point_cloud" / f"iteration_{iteration}" / "point_cloud.ply"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_gaussians(path, gaussians, overwrite=True)
        return path

    def write_json(self, name: str, document: object) -> None:
        write_json(self.path / name, document, overwrite=True, end="")
