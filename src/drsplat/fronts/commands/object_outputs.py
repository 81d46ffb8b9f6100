"""Output of `drsplat objects`, printed and written."""

from __future__ import annotations

import csv
import io
import json
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import InputError
from .declaring import Facts
from .query_options import check_outputs

if TYPE_CHECKING:
    from ...query import Scene

TABLE_FILE = "objects.json"
FORMULA_SIGNS = ("=", "+", "-", "@", "\t", "\r", "\n")  # spreadsheets compute a text that begins with one
BOX_NUMBERS = {"center": 3, "extent": 3, "axes": 9}


def check(saved: str | None, picture: str | None, overwrite: bool) -> None:
    """Check what can be checked before any work is done."""

    check_outputs(saved, picture, overwrite, ("",))
    if picture and Path(picture).suffix.lower() not in (".jpg", ".jpeg", ".png"):
        raise InputError(f"{picture}: pictures are written as .png or .jpg")
    if saved and Path(saved).suffix.lower() not in _WRITERS:
        raise InputError(f"{saved}: expected a name that ends in .npy, .ply, .json or .csv, or that of a folder")


def save(path: str, scene: Scene, listed: list[Facts], overwrite: bool) -> None:
    _WRITERS[Path(path).suffix.lower()](Path(path), scene, listed, overwrite)


def _save_npy(path: Path, scene: Scene, _: list[Facts], overwrite: bool) -> None:
    from ...formats.npy import write_npy

    write_npy(path, scene.object_ids(), overwrite)


def _save_ply(path: Path, scene: Scene, _: list[Facts], overwrite: bool) -> None:
    from ... import write_gaussians

    write_gaussians(path, scene.gaussians, {"object_id": scene.object_ids()}, overwrite=overwrite)


def _save_json(path: Path, scene: Scene, listed: list[Facts], overwrite: bool) -> None:
    from ...formats.replacing import replacing

    document = {"field": scene.field.fingerprint, "scene": scene.field.scene, "objects": listed}
    with replacing(path, overwrite) as file:
        file.write((json.dumps(document, indent=1) + "\n").encode())


def _save_csv(path: Path, _: Scene, listed: list[Facts], overwrite: bool) -> None:
    """Write a CSV table of objects.

    Each number of a box has a column, axes row by row; views share one, with semicolons between them; the last is 0 or
    1 for `agreed`.
    """
    from ...formats.replacing import replacing

    text = io.StringIO(newline="")
    columns = ("id", "label", "name", "num_gaussians", "mass", "num_views", "sure")
    rows = csv.writer(text)
    rows.writerow(
        [*columns, *(f"{key}_{i}" for key, count in BOX_NUMBERS.items() for i in range(count)), "views", "agreed"]
    )
    for document in listed:
        numbers = [*document["center"], *document["extent"], *chain(*document["axes"])]
        views = _cell(";".join(document["views"]))
        rows.writerow([*(_cell(document[key]) for key in columns), *numbers, views, int(document["agreed"])])
    with replacing(path, overwrite) as file:
        file.write(text.getvalue().encode())


def _cell(value: Any) -> Any:
    """Return a value that no spreadsheet takes for a formula: one that looks like it gets an apostrophe before it."""
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULA_SIGNS) else value


def _save_folder(path: Path, scene: Scene, listed: list[Facts], overwrite: bool) -> None:
    """Write a PLY of each object and a table of them; the folder appears whole or not at all."""
    from ... import write_gaussians
    from ...formats.field_folder import replacing_folder

    with replacing_folder(path, overwrite, TABLE_FILE) as folder:
        for match in scene.objects:
            write_gaussians(folder / f"object_{match.object_id:04d}.ply", scene.gaussians.subset(match.gaussian_ids))
        _save_json(folder / TABLE_FILE, scene, listed, False)


_WRITERS = {".npy": _save_npy, ".ply": _save_ply, ".json": _save_json, ".csv": _save_csv, "": _save_folder}
