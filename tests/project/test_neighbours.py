"""The layouts of other tools' exports lead to the same answer (docs/neighbours.md)."""

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import drsplat as ds
from toy_capture import NEGATIVES, THINGS
from written_captures import model_of, transforms_document, write_colmap_text, write_json

NEIGHBOURS = Path(__file__).resolve().parents[2] / "examples/neighbours"
TURN = np.eye(4)
TURN[:3, :3] = Rotation.from_euler("xyz", (20, -50, 110), degrees=True).as_matrix()
TURN[:3, 3] = (1.0, -2.0, 0.5)
SCALE = 0.37  # of nerfstudio's frame


def colmap_model(views: list[ds.View], folder: Path) -> None:
    """As text, and photos without points."""
    write_colmap_text(folder, *model_of(views), [])


def document_of(views: list[ds.View]) -> dict[str, Any]:
    return transforms_document(*model_of(views)) | {"camera_model": "OPENCV"}


def postshot(views, folder):
    colmap_model(views, folder / "sparse/0")


def realityscan(views, folder):
    colmap_model(views, folder / "model")
    for file in (folder / "model").iterdir():
        shutil.move(file, folder / file.name)


def metashape(views, folder):
    colmap_model(views, folder / "sparse")


def polycam(views, folder):
    """Intrinsics with each frame."""
    document = document_of(views)
    for number, frame in enumerate(document["frames"]):
        frame |= {"depth_file_path": f"depth/{number}.png"}  # which is not there, and not needed
    write_json(folder / "transforms.json", document)


def record3d(views, folder):
    """Intrinsics once."""
    document = document_of(views)
    for frame in document["frames"]:
        document |= {key: frame.pop(key) for key in ("fl_x", "fl_y", "cx", "cy", "w", "h")}
        frame.pop("camera_model")
        frame["file_path"] = f"./{frame['file_path']}"
    write_json(folder / "transforms.json", document)


def nerfstudio(views, folder):
    record3d(views, folder)
    record = {"transform": TURN[:3].tolist(), "scale": SCALE}
    write_json(folder / "dataparser_transforms.json", record)


def in_its_frame(gaussians: ds.Gaussians) -> ds.Gaussians:
    means = SCALE * (gaussians.means @ TURN[:3, :3].T + TURN[:3, 3])
    return replace(gaussians, means=means.astype(np.float32), scales=(SCALE * gaussians.scales).astype(np.float32))


@pytest.mark.parametrize("layout", [postshot, realityscan, metashape, polycam, record3d, nerfstudio])
def test_a_layout_leads_to_the_answer(layout, edited_room, tmp_path):
    shutil.copytree(edited_room / "capture/images", tmp_path / "images")
    layout(ds.read_views(edited_room / "capture"), tmp_path)
    gaussians, at = ds.read_gaussians(edited_room / "scene.ply"), np.array(THINGS["red mug"])
    if layout is nerfstudio:
        gaussians, at = in_its_frame(gaussians), SCALE * (TURN[:3, :3] @ at + TURN[:3, 3])
    encoder = ds.WordEncoder()
    features = ds.read_features(edited_room / "capture/language_features", encoder=encoder.identity)
    views = ds.read_views(tmp_path)
    assert all(view.image_path is not None for view in views)
    field = ds.register(gaussians, views, features).to_field()
    field = field.with_negatives(encoder.encode_texts(NEGATIVES), tuple(NEGATIVES))
    matches = ds.Scene(field, gaussians, views, encoder).locate("red mug")
    assert len(matches) == 1
    assert np.abs(matches[0].center - at).max() < 0.1


def test_photos_to_an_answer_is_a_script_that_goes_on(tmp_path):
    """Its commands, in their order, by programs that write down that they were called."""
    for name in ("drsplat", "colmap"):
        made = 'mkdir -p "$2/sparse/0"' if name == "colmap" else ":"
        program = tmp_path / "bin" / name
        program.parent.mkdir(exist_ok=True)
        program.write_text(f'#!/bin/sh\necho {name} "$1" >> {tmp_path}/calls\nset -- "$2" "$3"; {made}\n')
        program.chmod(0o755)
    command = ["bash", NEIGHBOURS / "colmap_to_answer.sh", tmp_path / "room", "red mug"]
    subprocess.run(command, check=True, env={"PATH": f"{tmp_path}/bin:/usr/bin:/bin"})
    calls = (tmp_path / "calls").read_text().split("\n")[:-1]
    verbs = ["train", "embed", "register", "locate"]
    assert calls == ["colmap automatic_reconstructor", *(f"drsplat {verb}" for verb in verbs)]
