"""What moves between photos: found by what the other photos do not lack, left out of training, and of what follows."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

import drsplat as ds
from captures_to_train import HEIGHT, WIDTH, known_scene, perturbed_points, photographed, ring
from drsplat.cli import main
from drsplat.drawing.rendering import render
from drsplat.formats.captures import SparsePoints
from drsplat.formats.ply import write_vertices
from drsplat.formats.poses import write_cameras_json
from drsplat.scene.photo_masks import load_mask
from drsplat.scene.photos import load_image
from drsplat.training import everyday, transients
from drsplat.training.transients import with_masks, without_transients

SQUARE = np.s_[26:46, 30:60]
VISITED = (3, 10, 13)  # photos with something in them that the others do not show
CLOTH = np.full((20, 30, 3), [250, 20, 220], np.uint8)
CLOTH[5:15, 8:22] = [20, 250, 40]


def changed(views: list[ds.View], folder: Path, change: dict[int, object]) -> list[ds.View]:
    """Write the photos again, some of them with a change."""
    found = []
    for number, view in enumerate(views):
        photo = ds.load_image(view).copy()
        if number in change:
            photo = change[number](photo)
        path = folder / view.name
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(photo).save(path)
        found.append(replace(view, image_path=path))
    return found


def with_cloth(photo: np.ndarray) -> np.ndarray:
    photo[SQUARE] = CLOTH
    return photo


def in_the_shade(photo: np.ndarray) -> np.ndarray:
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    light = 1 - 0.7 * np.exp(-((rows - 36) ** 2 + (columns - 45) ** 2) / (2 * 14**2))
    return np.uint8(photo * light[..., None])


@pytest.fixture(scope="module")
def scene() -> ds.Gaussians:
    return known_scene()


@pytest.fixture(scope="module")
def views(scene, tmp_path_factory) -> list[ds.View]:
    return photographed(tmp_path_factory.mktemp("photos"), scene, ring(16))


@pytest.fixture(scope="module")
def points(scene) -> SparsePoints:
    return perturbed_points(scene)


@pytest.fixture(scope="module")
def visited(views, tmp_path_factory) -> list[ds.View]:
    return changed(views, tmp_path_factory.mktemp("visited"), dict.fromkeys(VISITED, with_cloth))


@pytest.fixture(scope="module")
def marked(visited, scene, tmp_path_factory) -> list[ds.View]:
    return without_transients(visited, scene, tmp_path_factory.mktemp("marked"), threads=3)


def left_out(view: ds.View) -> np.ndarray:
    kept = load_mask(view)
    return np.zeros((view.height, view.width), bool) if kept is None else ~kept


def test_what_one_photo_shows_alone_is_left_out_there(marked):
    assert [k for k, view in enumerate(marked) if view.mask_path] == list(VISITED)
    for k in VISITED:
        out = left_out(marked[k])
        assert out[SQUARE].mean() > 0.9
        out[23:49, 27:63] = False
        assert out.mean() < 0.03


def test_what_stands_still_is_kept(views, scene, tmp_path):
    assert without_transients(views, scene, tmp_path / "masks") == views
    assert not (tmp_path / "masks").exists()


def test_a_shadow_is_not_something_that_moves(views, scene, tmp_path):
    shaded = changed(views, tmp_path / "photos", {VISITED[0]: in_the_shade})
    assert without_transients(shaded, scene, tmp_path / "masks") == shaded


def test_what_no_photo_agrees_on_with_the_scene_is_the_scenes_fault(views, scene, tmp_path):
    """A scene that lacks something everywhere does not make all of its photos wrong."""
    poor = scene.subset(np.linalg.norm(scene.means, axis=1) > 0.5)
    found = without_transients(views, poor, tmp_path / "masks")
    assert sum(view.mask_path is not None for view in found) <= 2


def test_a_photo_that_is_wrong_all_over_has_a_wrong_pose_and_nothing_that_moves():
    photo, drawn = np.random.default_rng(0).random((2, HEIGHT, WIDTH, 3))
    compared = transients._Compared(photo, drawn, np.abs(photo - drawn).mean(axis=2), np.ones((HEIGHT, WIDTH), bool))
    half = np.zeros((HEIGHT, WIDTH), bool)
    half[: HEIGHT // 2] = True
    third = half & (np.arange(HEIGHT) < HEIGHT // 3)[:, None]
    level = np.full((HEIGHT, WIDTH), 0.05)
    assert not transients._moving(half, compared, level).any()
    assert transients._moving(third, compared, level)[: HEIGHT // 3].all()


def test_photos_that_are_held_out_are_judged_and_do_not_judge(visited, scene, tmp_path):
    judges = [view for k, view in enumerate(visited) if k != VISITED[1]]
    alone = without_transients(judges, scene, tmp_path / "alone", threads=1)
    both = without_transients(judges, scene, tmp_path / "both", threads=3, held_out=[visited[VISITED[1]]])
    assert len(both) == len(visited)
    assert left_out(both[-1])[SQUARE].mean() > 0.9
    for one, other in zip(alone, both, strict=False):
        assert_array_equal(left_out(one), left_out(other))


def test_masks_that_are_there_stay(visited, scene, tmp_path):
    """Also inverted ones: what is written is white where it is kept."""
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[:, :12] = True
    for inverted in (False, True):
        path = tmp_path / f"{inverted}.png"
        Image.fromarray(mask if inverted else ~mask).save(path)
        given = [replace(view, mask_path=path, mask_inverted=inverted) for view in visited]
        marked = without_transients(given, scene, tmp_path / f"masks_{inverted}")
        for k, view in enumerate(marked):
            assert left_out(view)[:, :12].all()
            assert (left_out(view)[SQUARE].mean() > 0.9) == (k in VISITED)
        assert not marked[VISITED[0]].mask_inverted


def test_the_mask_is_made_for_the_photo_as_it_is_stored(visited, scene, tmp_path, monkeypatch):
    """The lens bends the photo, and the mask with it."""
    bent = replace(visited[VISITED[0]], distortion=(0.2, 0.0, 0.0, 0.0))
    moving = np.zeros((HEIGHT, WIDTH), bool)
    moving[SQUARE] = True
    monkeypatch.setattr(transients._Jury, "judged", lambda *_, **__: moving)
    (marked,) = without_transients([bent], scene, tmp_path)
    with Image.open(marked.mask_path) as mask:
        assert mask.size == (WIDTH, HEIGHT)
    assert (left_out(marked) & moving).sum() > 0.95 * moving.sum()


def test_sums_are_those_of_a_loop(visited, scene):
    """Weights of a photo, weights times the difference, and the squared sum of weights, of each Gaussian."""
    jury, view = transients._Jury(scene, 0), visited[VISITED[0]]
    compared = jury.compared(view)
    found = ds.kernels.topk_contributions(jury.splats, view, transients.NUM_WEIGHTS)
    weight, lacking = np.zeros(len(scene)), np.zeros(len(scene))
    for row in range(HEIGHT):
        for column in range(WIDTH):
            for index, share in zip(found.ids[row, column], found.weights[row, column], strict=True):
                if share > 0 and compared.seen[row, column]:
                    weight[index] += float(share)
                    lacking[index] += float(share) * compared.difference[row, column]
    assert_allclose(jury.sums(view, compared), [weight, lacking, weight**2], rtol=1e-9, atol=1e-12)


# --- in training ---


def everyday_of(views: list[ds.View], **chosen: object) -> ds.TrainingSettings:
    return everyday(views, 300, sh_degree=1, **chosen)


def masks_in(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted((folder / "masks").rglob("*.png"))}


@pytest.fixture(scope="module")
def trained(visited, points, tmp_path_factory) -> tuple[Path, Any]:
    folder = tmp_path_factory.mktemp("trained") / "m"
    return folder, ds.train(visited, everyday_of(visited), folder, points=points, device="cpu")


def in_square() -> np.ndarray:
    inside = np.zeros((HEIGHT, WIDTH), bool)
    inside[SQUARE] = True
    return inside


def test_training_leaves_out_what_moves_and_says_so(trained, visited, points, tmp_path):
    folder, found = trained
    masks = masks_in(folder)
    assert masks.keys() >= {f"{visited[k].name}.png" for k in VISITED}
    assert len(masks) <= len(VISITED) + 2  # the scene is a poor one by then
    assert found.num_transient == found.measures()["num_views_with_transients"] == len(masks)
    assert found.num_masked == 0
    marked = with_masks(visited, folder / "masks")
    assert np.mean([left_out(marked[k])[SQUARE].mean() for k in VISITED]) > 0.5  # of a scene of 150 iterations
    kept = ds.train(visited, everyday_of(visited, transients_at=0), tmp_path / "k", points=points, device="cpu")
    assert not masks_in(tmp_path / "k")
    assert kept.num_transient == 0
    for k in VISITED:  # what was pasted in is learnt less
        photo, square = load_image(visited[k]) / 255, left_out(marked[k]) & in_square()
        lacking, learnt = (np.abs(render(t.gaussians, visited[k]).rgb - photo)[square].mean() for t in (found, kept))
        assert lacking > learnt


@pytest.mark.slow
@pytest.mark.parametrize("at", [100, 150, 151, 200])
def test_a_run_that_is_killed_before_or_after_goes_on_to_the_same_bits(visited, points, tmp_path, trained, at):
    settings, (folder, whole) = everyday_of(visited), trained
    assert settings.transients_at == 150

    def stop(status):
        if status.iteration == at:
            raise KeyboardInterrupt

    shared = {"points": points, "device": "cpu", "checkpoint_every": 1}
    with pytest.raises(KeyboardInterrupt):
        ds.train(visited, settings, tmp_path / "cut", report=stop, **shared)
    again = ds.train(visited, settings, tmp_path / "cut", **shared)
    assert_array_equal(whole.gaussians.means, again.gaussians.means)
    assert masks_in(folder) == masks_in(tmp_path / "cut")
    assert again.num_transient == whole.num_transient


def test_overwriting_removes_masks_of_another_run(trained, views, points, tmp_path):
    folder = Path(shutil.copytree(trained[0], tmp_path / "m"))
    assert masks_in(folder)
    ds.train(views, everyday(views, 20, sh_degree=1), folder, points=points, device="cpu", overwrite=True)
    assert not masks_in(folder)


@pytest.mark.slow
def test_embed_leaves_out_what_training_found_beside_the_scene(visited, points, tmp_path, capsys):
    """The same photos with poses in cameras.json: train, then embed with and without the scene."""
    capture = tmp_path / "capture"
    (capture / "images").mkdir(parents=True)
    for view in visited:
        (capture / "images" / view.name).write_bytes(view.image_path.read_bytes())
    write_cameras_json(capture / "cameras.json", visited)
    write_vertices(tmp_path / "points.ply", dict(zip("xyz", points.positions.astype(np.float32).T, strict=True)))
    line = [str(capture), "--iterations", "300", "--points", str(tmp_path / "points.ply"), "--json"]
    assert main(["train", *line, "--output-dir", str(tmp_path / "m")]) == 0
    found = json.loads(capsys.readouterr().out)["num_views_with_transients"]
    masks = masks_in(tmp_path / "m")
    assert found == len(masks) >= 1
    models = ["--segmenter", "graph", "--encoder", "drsplat-mini", "--json"]
    scene = ["--scene", str(tmp_path / "m")]
    counts = []
    for name, more in {"without": [], "with": scene, "kept": [*scene, "--keep-people"]}.items():
        assert main(["embed", str(capture), *models, "-o", str(tmp_path / name), *more]) == 0
        features = ds.read_features(tmp_path / name)
        capsys.readouterr()
        counts.append(sum(int((features[Path(one).name.split(".")[0]].mask_ids >= 0).sum()) for one in masks))
    assert counts[0] == counts[2] > counts[1]
    assert main(["train", *line, "--output-dir", str(tmp_path / "k"), "--keep-people"]) == 0
    assert json.loads(capsys.readouterr().out)["num_views_with_transients"] == 0
