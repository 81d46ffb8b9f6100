"""Scenes written with what was found in them, by the suffix of the output."""

import numpy as np
import pytest
from numpy.random import default_rng

from drsplat import read_gaussians
from drsplat.formats.known import write_scene
from drsplat.scene.labelled import LabelledScene, Thing
from refusing import refused
from scene_files import random_gaussians


def labelled(count: int = 40) -> LabelledScene:
    """Make a scene of two objects, of which one lies in a group, and Gaussians of neither."""
    gaussians = random_gaussians(default_rng(0), count)
    box = {"center": np.zeros(3), "axes": np.eye(3), "extent": np.ones(3)}
    things = (Thing("red mug", 0.9, **box, parent=0), Thing("object 1", 0.4, **box))
    object_of = np.arange(count, dtype=np.int32) % 3 - 1
    return LabelledScene(gaussians, "room", things, (Thing("dishes", 1.0, **box),), object_of)


@pytest.mark.parametrize("suffix", [".ply", ".spz"])
def test_a_scene_is_written_as_its_suffix_says(tmp_path, suffix):
    scene = labelled()
    write_scene(tmp_path / f"out{suffix}", scene)
    read = read_gaussians(tmp_path / f"out{suffix}")
    np.testing.assert_allclose(read.means, scene.gaussians.means, atol=1e-5)
    with refused("exists already"):
        write_scene(tmp_path / f"out{suffix}", scene)


def test_a_ply_keeps_the_object_of_each_gaussian(tmp_path):
    scene = labelled()
    write_scene(tmp_path / "out.ply", scene)
    np.testing.assert_array_equal(read_gaussians(tmp_path / "out.ply").extra["object_id"], scene.object_of)


def test_an_unknown_suffix_names_those_there_are(tmp_path):
    with refused(r"ends in .*Did you mean '\.ply'"):
        write_scene(tmp_path / "out.plyy", labelled())


def test_objects_that_there_are_not_are_refused():
    with refused("from -1 to -1"):
        LabelledScene(random_gaussians(default_rng(0), 2), object_of=np.zeros(2, np.int32))
    with refused("expected 2 numbers"):
        LabelledScene(random_gaussians(default_rng(0), 2), relevancy=np.zeros(3, np.float32))
