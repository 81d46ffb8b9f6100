"""Edits and annotations from strangers: what is read is sound, what is not is refused in words, in little memory."""

from pathlib import Path

import numpy as np
import pytest
from test_edits import every_edit

from drsplat.authoring.editing import EditFile, EditList, Replace
from drsplat.authoring.editing.edits import drafted
from drsplat.formats.annotations import AnnotationFile
from drsplat.scene.labelled import Annotation
from mutations import quota, seeded, survivors
from scenes import random_gaussians

MUTANTS = quota(2000)
SCENE = random_gaussians(60)


def read_edits(path: Path) -> object:
    """Also applied, as far as no other file is needed."""
    listed = EditFile(path).read(SCENE)
    drafted(SCENE, [edit for edit in listed.active if not isinstance(edit.change, Replace)])
    return listed.edits


def read_annotations(path: Path) -> object:
    return AnnotationFile(path).read()


def write_edits(path: Path) -> None:
    EditFile(path).change(SCENE, lambda _: EditList(SCENE.fingerprint, every_edit(), 11))


def write_annotations(path: Path) -> None:
    notes = Annotation.at("größe 🥤", (1, 2.5, -3)), Annotation.box("a box", np.ones(3), np.eye(3), np.ones(3))
    AnnotationFile(path).add(notes)


@pytest.mark.slow
@pytest.mark.parametrize(("write", "read"), [(write_edits, read_edits), (write_annotations, read_annotations)])
def test_damaged_files(write, read, tmp_path, bounded_memory):
    path = tmp_path / "given.json"
    write(path)
    assert read(path)
    assert survivors(path, read, seeded(path.stat().st_size), MUTANTS) < MUTANTS * 2 / 3
