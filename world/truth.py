"""What is known of a rendered room, read back from its folder."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from drsplat.base.arrays import MaskIds, Pixels

Label = tuple[str, str, str]  # name, colour, material; "" where that is not known


@dataclass(frozen=True)
class Truth:
    """known: all of truth.json. labels: by id. objects: ids of things, the others are structures."""

    folder: Path
    known: dict[str, Any]
    scene: str
    labels: dict[int, Label]
    objects: tuple[int, ...]
    views: tuple[str, ...]

    @property
    def capture(self) -> Path:
        """The folder with photos and a COLMAP model."""
        return self.folder / "lerf_ovs" / self.scene

    def photos(self) -> Iterator[tuple[Pixels, MaskIds]]:
        """Each photo and the id of what its pixels show, -1 for nothing."""
        for name in self.views:
            yield np.asarray(Image.open(self.capture / "images" / name)), self.ids(name)

    def ids(self, view: str) -> MaskIds:
        stored = Image.open(self.folder / "ids" / f"{Path(view).stem}.png")
        return np.asarray(stored).astype(np.int32) - 1


def read_truth(folder: Path) -> Truth:
    """Of a folder that `python -m world` wrote."""
    known = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    labels = {thing["id"]: (thing["name"], thing["color"], thing["material"]) for thing in known["objects"]}
    structures = {part["id"]: (part["name"], "", "") for part in known["structures"]}
    views = tuple(view["name"] for view in known["views"])
    return Truth(folder, known, known["scene"], labels | structures, tuple(labels), views)
