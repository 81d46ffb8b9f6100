"""The scene in the package: photos, poses, trained Gaussians, and the content of the held-out photos.

Made by `world/packing.py` from a room of the procedural household world that no model here was trained on.
"""

import json
import shutil
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
from PIL import Image

from ...base.arrays import Bool
from ...errors import InputError
from ...formats.replacing import replacing, saying_what_is_full

SCENE = "scene.compressed.ply"
UNFINISHED = "UNFINISHED"  # name of the file that marks a folder of a demo that was stopped


@dataclass(frozen=True)
class Household:
    """Scene of the demo. categories: by id. held_out: photos that neither training nor registration used."""

    folder: Path
    categories: dict[int, str]
    held_out: tuple[str, ...]

    def mask(self, view_name: str, meant: Collection[str]) -> Bool[np.ndarray, "h w"]:
        """Return where a held-out photo shows one of these categories."""
        ids = np.asarray(Image.open(self.folder / "ids" / f"{Path(view_name).stem}.png"))
        numbers = [number for number, name in self.categories.items() if name in meant]
        return np.asarray(np.isin(ids.astype(np.int32) - 1, numbers))


def unpack_household(folder: Path, *, overwrite: bool = False) -> Household:
    """Copy the scene's files to `folder`, where a user finds them.

    Raises: InputError: the folder has something in it and not `overwrite`, or cannot be written to; the disk is full.
    """
    refuse_full(folder, overwrite)
    with as_file(files(__package__) / "scene") as shipped:
        _copy(shipped, folder)
    return read_household(folder)


def refuse_full(folder: Path, overwrite: bool) -> None:
    """Check a folder for output. Raises: InputError: it has something in it and not `overwrite`."""
    if folder.is_dir() and any(folder.iterdir()) and not overwrite:
        raise InputError(f"{folder} exists already: choose another folder, or pass overwrite=True to replace it")


@contextmanager
def resumable(folder: Path, overwrite: bool) -> Iterator[None]:
    """Mark a folder as unfinished until the block ends well, so that a stopped demo can be continued in it.

    Raises: InputError: the folder has something in it, that no stopped demo left, and not `overwrite`.
    """
    marker = folder / UNFINISHED
    refuse_full(folder, overwrite or marker.is_file())
    with saying_what_is_full(folder):
        folder.mkdir(parents=True, exist_ok=True)
        marker.write_text("drsplat demo was stopped here; the same command goes on.\n", encoding="utf-8")
    yield
    marker.unlink(missing_ok=True)


def _copy(shipped: Path, folder: Path) -> None:
    for file in sorted(shipped.rglob("*")):
        if file.is_file():
            place = folder / file.relative_to(shipped)
            with saying_what_is_full(place.parent):
                place.parent.mkdir(parents=True, exist_ok=True)
            with file.open("rb") as source, replacing(place, overwrite=True) as target:
                shutil.copyfileobj(source, target)


def read_household(folder: Path) -> Household:
    """Read the truth of an unpacked scene."""
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    categories = {thing["id"]: thing["category"] for thing in truth["objects"]}
    return Household(folder, categories, tuple(truth["held_out"]))
