"""A GLB of ours in programs of others: PlayCanvas draws it, CesiumJS reads its names, Khronos's validator judges it,
and what splat-transform writes as GLB is read here.
"""

import json
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import drsplat as ds
import scene_files
from browsing import a_page, needs_chromium
from drsplat.authoring.exporting import export
from drsplat.formats.axes import standing_up
from drsplat.formats.known import write_scene
from drsplat.scene.labelled import Annotation, LabelledScene, Thing
from drsplat.scene.similarity import Similarity
from foreign_programs import NODE, NPM_FOLDER, needs_node, needs_packages, splat_transform
from foreign_viewing import colourful, pictured, psnr, serving, turned, zoomed

pytestmark = [pytest.mark.oracle, pytest.mark.slow]
LEAST_PSNR = 32.3  # dB; measured 33.4, shifted by a pixel 31.2, harmonics not turned 23
UPS = ((0.0, -1.0, 0.0), (0.2, 0.3, 0.9))


def labelled_scene() -> LabelledScene:
    """Everything that a GLB may hold."""
    g = scene_files.random_gaussians(np.random.default_rng(0), 60, 3)
    things = tuple(
        Thing(name, 0.5, np.array([number, 2.0, 3.0]), np.eye(3), np.ones(3), 0, np.float32([0.6, 0.8]), number)
        for number, name in enumerate(("red mug", "<b>кружка</b> 😀", "a/../b"))
    )
    notes = (Annotation.at("here", [0.0, 1, 2]), Annotation.box("box", np.zeros(3), np.eye(3), np.ones(3)))
    owners = (np.arange(60) % 4 - 1).astype(np.int32)
    group = replace(things[0], name="kitchen", parent=-1, embedding=None, number=-1)
    return LabelledScene(g, "room", things, (group,), owners, "mug", g.opacities, things[:1], notes, (0.0, 0.0, 1.0))


@needs_chromium
@needs_packages("playcanvas")
@pytest.mark.parametrize("up", UPS)
def test_playcanvas_draws_it(up, edited_room, tmp_path, chromium):
    """Judged where the scene is. Its Gaussians end a little earlier than ours; shifted by a pixel, or with harmonics
    that do not turn along with the node, the picture would be another.
    """
    turn = standing_up(np.array(up))
    scene = colourful(ds.read_gaussians(edited_room / "scene.ply"))
    write_scene(tmp_path / "scene.glb", LabelledScene(scene, up=up))
    view = zoomed(ds.read_views(edited_room / "capture")[0])
    shown = pictured(chromium, "playcanvas", tmp_path / "scene.glb", view, turned(turn))
    drawn = ds.render(scene, view)
    unturned = replace(scene, sh=Similarity(1.0, turn, np.zeros(3)).moved(scene).sh)
    pictures = drawn.rgb, np.roll(drawn.rgb, 1, axis=1), ds.render(unturned, view).rgb
    same, shifted, other = (psnr(shown, ours, drawn.alpha > 0.01) for ours in pictures)
    print(f"PSNR {same:.1f} dB, shifted by a pixel {shifted:.1f}, harmonics not turned {other:.1f}")
    assert same > LEAST_PSNR > max(shifted, other)


@needs_chromium
@needs_packages("cesium")
def test_cesium_reads_the_table_of_objects(tmp_path, chromium):
    scene = labelled_scene()
    write_scene(tmp_path / "scene.glb", scene)
    with serving(tmp_path / "scene.glb") as address, a_page(chromium) as page:
        page.goto(f"{address}/cesium.html")
        page.wait_for_function("window.loaded")
        objects = page.evaluate("window.objects")
    assert [one["name"] for one in objects] == [thing.name for thing in scene.things]
    assert [one["number"] for one in objects] == [0, 1, 2]
    assert_allclose([one["center"] for one in objects], [thing.center for thing in scene.things])


@needs_node
@needs_packages("gltf-validator")
def test_the_validator_of_khronos_finds_no_fault(tmp_path):
    """It does not know the extension yet, and calls the names of its attributes, which have a colon, invalid."""
    write_scene(tmp_path / "scene.glb", labelled_scene())
    finished = subprocess.run(
        [str(NODE), str(NPM_FOLDER / "validate.cjs"), str(tmp_path / "scene.glb")], capture_output=True, text=True
    )
    assert finished.returncode == 0, finished.stderr
    issues = json.loads(finished.stdout)["issues"]
    own_names = "attributes/KHR_gaussian_splatting:"
    faults = [one for one in issues["messages"] if one["severity"] < 2 and own_names not in one["pointer"]]
    assert faults == []
    assert issues["numWarnings"] == 0
    assert issues["numErrors"] == 19  # those names: rotation, scale, opacity and 16 coefficients
    informed = {one["code"] for one in issues["messages"] if one["severity"] == 2}
    assert informed == {"UNSUPPORTED_EXTENSION", "UNUSED_OBJECT"}  # what the extensions use


@needs_node
@needs_packages("@playcanvas/splat-transform")
@pytest.mark.parametrize("degree", [0, 3])
def test_what_splat_transform_writes_is_what_it_was_given(degree, tmp_path):
    """It turns the numbers themselves, harmonics too."""
    scene = scene_files.random_gaussians(np.random.default_rng(1), 300, degree)
    ds.write_gaussians(tmp_path / "scene.ply", scene)
    splat_transform(tmp_path / "scene.ply", tmp_path / "theirs.glb")
    theirs = ds.read_gaussians(tmp_path / "theirs.glb")
    np.testing.assert_array_equal(theirs.positions, scene.positions)
    signs = np.sign((theirs.quats * scene.quats).sum(axis=1, keepdims=True))
    assert_allclose(theirs.quats * signs, scene.quats, atol=1e-5)
    for name in ("scales", "opacities", "sh"):
        assert_allclose(getattr(theirs, name), getattr(scene, name), atol=1e-5)


def test_a_scene_without_a_field_is_drawn_alike_after_the_way_through_a_file(edited_room, tmp_path):
    scene = ds.read_gaussians(edited_room / "scene.ply")
    export(tmp_path / "scene.glb", scene)
    view = ds.read_views(edited_room / "capture")[0]
    drawn = [ds.render(one, view).rgb for one in (scene, ds.read_gaussians(tmp_path / "scene.glb"))]
    assert np.array_equal(*drawn)
