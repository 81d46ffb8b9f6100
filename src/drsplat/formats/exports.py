"""Writing a scene with what was found in it, in the format that the name of the output says."""

from collections.abc import Callable, Mapping
from os import PathLike
from pathlib import Path
from types import MappingProxyType

import numpy as np

from ..errors import InputError, did_you_mean
from ..scene.labelled import LabelledScene
from .replacing import replacing
from .scenes import write_gaussians
from .spz_writing import spz_bytes

Writer = Callable[[Path, LabelledScene, bool], None]


def write_scene(path: str | PathLike[str], scene: LabelledScene, overwrite: bool = False) -> None:
    """Write a scene as the suffix of `path` says; it appears whole or not at all.

    Raises: InputError: a suffix that nothing is written as, a scene that the format cannot hold, or `path` exists and
    not `overwrite`.
    """
    path = Path(path)
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        near = did_you_mean(path.suffix.lower(), WRITERS)
        raise InputError(f"{path.name}: expected a name that ends in {', '.join(WRITERS)}.{near}")
    writer(path, scene, overwrite)


def columns_of(scene: LabelledScene) -> dict[str, np.ndarray]:
    """Return the columns of a PLY that say each Gaussian's object and relevancy."""
    columns = {"object_id": scene.object_of, "relevancy": scene.relevancy}
    return {name: column for name, column in columns.items() if column is not None}


def _write_ply(path: Path, scene: LabelledScene, overwrite: bool) -> None:
    write_gaussians(path, scene.gaussians, columns_of(scene), overwrite)


def _write_spz(path: Path, scene: LabelledScene, overwrite: bool) -> None:
    content = spz_bytes(scene.gaussians)
    with replacing(path, overwrite=overwrite) as file:
        file.write(content)


WRITERS: Mapping[str, Writer] = MappingProxyType({".ply": _write_ply, ".spz": _write_spz})
