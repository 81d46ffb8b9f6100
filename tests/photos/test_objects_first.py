"""Which photos, which crops: embedding with the scene at hand."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image
from scipy.sparse import csc_array, csr_array

import drsplat as ds
from command_line import error_of
from drsplat import cli
from drsplat.errors import InputError
from drsplat.field.evidence.evidence import Evidence, MaskIds
from drsplat.field.registration import register
from drsplat.formats.langsplat import read_features
from drsplat.formats.poses import write_cameras_json
from drsplat.photos.embedding.embed import embed
from drsplat.photos.embedding.keeping import WithoutEmbedding
from drsplat.photos.embedding.objects_first import (
    CROPS,
    MASKS,
    MAX_CROPS_PER_OBJECT,
    _spread,
    embed_objects,
    node_fits,
    share_crops,
)
from drsplat.photos.embedding.view_choice import SIGHTS_PER_GAUSSIAN, choose_views, greedy
from drsplat.scene.views import View
from fake_models import ColorSegmenter, LargeSegmenter, ThumbnailEncoder
from scenes import look_at_view
from toy_capture import HEIGHT, WIDTH, balls

COUNT = 16


@pytest.fixture(scope="module")
def scene() -> ds.Gaussians:
    return balls()


@pytest.fixture(scope="module")
def photos(tmp_path_factory, scene) -> list[View]:
    """Photos of the two balls, from an arc in front of them."""
    folder = tmp_path_factory.mktemp("balls")
    return [_photo(folder, scene, number) for number in range(COUNT)]


def _photo(folder: Path, scene: ds.Gaussians, number: int) -> View:
    turn = 0.25 * (number - COUNT / 2)
    at = look_at_view((4 * np.sin(turn), -4 * np.cos(turn), 0.5), width=WIDTH, height=HEIGHT)
    view = replace(at, name=f"photo_{number:02}.png", image_path=folder / f"photo_{number:02}.png")
    Image.fromarray(np.clip(ds.render(scene, view).rgb * 255, 0, 255).astype(np.uint8)).save(view.image_path)
    return view


def _evidence(scene: ds.Gaussians, photos: list[View], folder: Path) -> Evidence:
    embed(photos, folder, LargeSegmenter(), WithoutEmbedding())
    return register(scene, photos, read_features(folder)).evidence


# --- which crops ----------------------------------------------------------------------------------


def test_a_few_masks_of_each_ball_are_embedded_and_stand_for_the_others(scene, photos, tmp_path):
    evidence = _evidence(scene, photos, tmp_path / "masks")
    shared = share_crops(evidence, scene, photos)
    in_ball = np.array([evidence.weights[rows].sum(axis=0) for rows in (slice(0, 150), slice(150, 300))])
    ball_of = in_ball.argmax(0)
    assert len(ball_of) == 2 * COUNT
    assert np.bincount(ball_of[shared.chosen]).tolist() == [MAX_CROPS_PER_OBJECT] * 2
    assert_allclose(shared.shares.sum(axis=1), 1)
    rows = np.repeat(np.arange(len(ball_of)), np.diff(shared.shares.indptr))
    assert_array_equal(ball_of[rows], ball_of[shared.chosen[shared.shares.indices]])


def test_the_crop_of_the_nearest_camera_has_half_of_the_say(scene, photos, tmp_path):
    evidence = _evidence(scene, photos, tmp_path / "masks")
    shared = share_crops(evidence, scene, photos)
    centers = np.array([view.center for view in photos])[evidence.masks.views]
    heaviest = shared.chosen[shared.shares.toarray().argmax(1)]
    for column, stands in enumerate(heaviest):
        same = shared.chosen[shared.shares.toarray()[column] > 0]
        nearest = np.linalg.norm(centers[same] - centers[column], axis=1).min()
        assert np.linalg.norm(centers[stands] - centers[column]) == pytest.approx(nearest)
    assert_allclose(shared.shares.toarray().max(1), 0.5 + 0.5 / MAX_CROPS_PER_OBJECT)


def test_a_mask_that_shows_no_object_stands_for_itself(scene, photos, tmp_path):
    """Two masks of one more photo, each half of both balls, where each ball is an object."""
    whole = _evidence(scene, photos, tmp_path / "masks")
    seen = whole.weights[:, whole.masks.views == COUNT // 2].toarray().sum(axis=1)
    is_even = np.arange(len(seen)) % 2 == 0
    halves = np.stack([seen * is_even, seen * ~is_even], 1)
    weights = csr_array(np.hstack([whole.weights.toarray(), halves]).astype(np.float32))
    names = (*whole.masks.view_names, "photo_99.png")
    views, ids = np.append(whole.masks.views, [COUNT] * 2), np.append(whole.masks.ids, [0, 1])
    masks = MaskIds(names, views.astype(np.int32), ids.astype(np.int32))
    evidence = Evidence(weights, masks, np.ones((len(views), 1), np.float32))
    shared = share_crops(evidence, scene, [*photos, replace(photos[0], name="photo_99.png")])
    assert_array_equal(shared.chosen[-2:], len(views) + np.array([-2, -1]))
    assert_array_equal(shared.shares.toarray()[-2:], np.eye(len(shared.chosen))[-2:])


def test_the_choice_of_crops_does_not_depend_on_threads(scene, photos, tmp_path):
    evidence = _evidence(scene, photos, tmp_path / "masks")
    one, three = (share_crops(evidence, scene, photos, threads=threads) for threads in (1, 3))
    assert_array_equal(one.chosen, three.chosen)
    assert_array_equal(one.shares.toarray(), three.shares.toarray())


def test_the_fit_of_a_node_is_its_iou_by_weight_in_the_photo_of_the_mask():
    """Two photos of two masks; node 0 is mask 0 and half of mask 1, and nothing in the second photo."""
    weights = csr_array(np.float32([[4.0, 2, 0, 0], [0, 2, 3, 1]]))
    masks = MaskIds(("a", "b"), np.int32([0, 0, 1, 1]), np.int32([0, 1, 0, 1]))
    evidence = Evidence(weights, masks, np.ones((4, 1), np.float32))
    inside = csr_array(np.array([[4.0, 2, 0, 0], [0, 0, 3, 0]]))
    assert_allclose(node_fits(inside, evidence).toarray(), [[4 / 6, 2 / 8, 0, 0], [0, 0, 1, 0]])


def test_crops_are_of_cameras_far_from_each_other():
    centers = np.array([0.0, 0.1, 0.2, 5.0, 5.1, 10.0])[:, None] * (1, 0, 0)
    picks, distances = _spread(np.ones(6), centers, 3)
    assert sorted(picks.tolist()) == [0, 3, 5]
    assert_allclose(distances, np.abs(centers[:, :1] - centers[picks, 0]))
    assert _spread(np.array([1.0, 1, 9, 1, 1, 1]), centers, 1)[0].tolist() == [2]
    assert len(_spread(np.ones(4), np.zeros((4, 3)), 3)[0]) == 1  # all of one photo


# --- features -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_features_are_what_the_chosen_crops_give(scene, photos, tmp_path):
    encoder = ThumbnailEncoder()
    report = embed_objects(photos, tmp_path / "out", LargeSegmenter(), encoder, scene, parts=tmp_path / "parts")
    assert encoder.asked == report.crops == 2 * MAX_CROPS_PER_OBJECT
    assert (report.photos, dict(report.masks)) == (COUNT, {"large": 2 * COUNT})
    every = ThumbnailEncoder()
    embed(photos, tmp_path / "every", LargeSegmenter(), every)
    assert every.asked == 2 * COUNT
    shared = share_crops(_evidence(scene, photos, tmp_path / "masks"), scene, photos)
    whole, made = read_features(tmp_path / "every"), read_features(tmp_path / "out")
    rows = np.concatenate([whole[view.name].embeddings for view in photos])
    expected = shared.embeddings(rows[shared.chosen])
    assert_allclose(np.concatenate([made[view.name].embeddings for view in photos]), expected, atol=2e-3)
    for view in photos:
        assert_array_equal(made[view.name].mask_ids, whole[view.name].mask_ids)
    assert made.encoder == encoder.identity
    register(scene, photos, made)


@pytest.mark.slow
def test_a_second_run_asks_nothing_and_a_new_photo_asks_for_little(scene, photos, tmp_path):
    paths = {"output_dir": tmp_path / "out", "parts": tmp_path / "parts"}
    segmenter, encoder = LargeSegmenter(), ThumbnailEncoder()
    embed_objects(photos[:-1], segmenter=segmenter, encoder=encoder, gaussians=scene, **paths)
    first = encoder.asked
    report = embed_objects(photos[:-1], segmenter=segmenter, encoder=encoder, gaussians=scene, **paths)
    assert (segmenter.asked, encoder.asked, report.reused) == (COUNT - 1, first, COUNT - 1)
    report = embed_objects(photos, segmenter=segmenter, encoder=encoder, gaussians=scene, **paths)
    assert (segmenter.asked, report.photos) == (COUNT, COUNT)
    fresh = tmp_path / "fresh"
    embed_objects(photos, fresh / "out", segmenter, encoder, scene, parts=fresh / "parts")
    for view in photos:
        again, anew = (read_features(folder)[view.name] for folder in (tmp_path / "out", fresh / "out"))
        assert_array_equal(again.embeddings, anew.embeddings)


@pytest.mark.slow
def test_overwriting_asks_both_models_anew(scene, photos, tmp_path):
    paths = {"output_dir": tmp_path / "out", "parts": tmp_path / "parts"}
    segmenter, encoder = LargeSegmenter(), ThumbnailEncoder()
    embed_objects(photos, segmenter=segmenter, encoder=encoder, gaussians=scene, **paths)
    once = segmenter.asked, encoder.asked
    embed_objects(photos, segmenter=segmenter, encoder=encoder, gaussians=scene, overwrite=True, **paths)
    assert (segmenter.asked, encoder.asked) == (2 * once[0], 2 * once[1])


@pytest.mark.slow
def test_a_run_that_is_stopped_while_crops_are_embedded_goes_on(scene, photos, tmp_path):
    class Stopped(ThumbnailEncoder):
        def encode_images(self, images):
            if self.asked >= 4:
                raise KeyboardInterrupt
            return super().encode_images(images)

    stopped, segmenter = Stopped(), LargeSegmenter()
    with pytest.raises(KeyboardInterrupt):
        embed_objects(photos, tmp_path / "out", segmenter, stopped, scene, parts=tmp_path / "parts")
    assert not list((tmp_path / "out").glob("*.safetensors"))
    encoder = ThumbnailEncoder()
    embed_objects(photos, tmp_path / "out", segmenter, encoder, scene, parts=tmp_path / "parts")
    assert stopped.asked + encoder.asked == 2 * MAX_CROPS_PER_OBJECT
    assert segmenter.asked == COUNT


def test_masks_of_four_levels_are_refused(scene, photos, tmp_path):
    with pytest.raises(InputError, match="crops of objects are of one level of masks"):
        embed_objects(photos, tmp_path / "out", ColorSegmenter(), ThumbnailEncoder(), scene, parts=tmp_path / "parts")


# --- which photos ---------------------------------------------------------------------------------


@given(st.integers(1, 7), st.integers(1, 12), st.integers(0, 2**32 - 1))
def test_each_view_is_the_one_that_shows_most_of_what_is_left(views, rows, seed):
    """Beside a plain loop that looks at every view each time."""
    rng = np.random.default_rng(seed)
    shares = rng.random((rows, views)) * (rng.random((rows, views)) < 0.7)
    order, seen = greedy(csc_array(shares), 1.0, views)
    have, score, total = np.zeros(rows), 0.0, np.minimum(shares.sum(1), SIGHTS_PER_GAUSSIAN).sum()
    for view, share in zip(order, seen, strict=True):
        gains = (
            np.minimum(have[:, None] + shares, SIGHTS_PER_GAUSSIAN) - np.minimum(have, SIGHTS_PER_GAUSSIAN)[:, None]
        ).sum(0)
        assert gains[view] >= gains[[v for v in range(views) if v not in order[: order.index(view)]]].max() - 1e-9
        have, score = have + shares[:, view], score + gains[view]
        assert share == pytest.approx(score / total)
    assert not order or seen[-1] == pytest.approx(1)


def test_what_has_been_seen_often_enough_is_not_looked_at_again(scene, photos):
    several = [replace(photos[0], name=f"same_{number:02}.png") for number in range(12)]
    choice = choose_views(scene, several, enough=0.999)
    assert len(choice.views) == SIGHTS_PER_GAUSSIAN
    assert_allclose(choice.seen, np.arange(1, SIGHTS_PER_GAUSSIAN + 1) / SIGHTS_PER_GAUSSIAN)
    another = choose_views(scene, [*several, photos[-1]], enough=0.999)
    assert photos[-1] in another.views


def test_a_near_photo_is_worth_more_than_one_that_shows_the_same_from_afar(scene):
    places = [(0, -8, 0.5), (0, -4, 0.5), (0, -8, 0.6)]
    far, near, another = (look_at_view(place, width=WIDTH, height=HEIGHT) for place in places)
    assert choose_views(scene, [far, near, another], most=1).views == [near]


def test_as_many_photos_as_are_asked_for_and_the_same_at_any_threads(scene, photos):
    one, two = (choose_views(scene, photos, enough=1.0, most=5, threads=threads) for threads in (1, 2))
    assert len(one.views) == 5
    assert (one.views, one.seen) == (two.views, two.seen)
    fewer = choose_views(scene, photos, enough=0.5)
    assert fewer.seen[-1] >= 0.5
    assert len(fewer.views) < COUNT
    assert choose_views(scene, []).views == []


# --- the command ----------------------------------------------------------------------------------


def test_the_command_embeds_a_few_crops_of_a_few_photos(scene, photos, tmp_path, capsys):
    capture = tmp_path / "capture"
    (capture / "images").mkdir(parents=True)
    for view in photos:
        (capture / "images" / view.name).write_bytes(view.image_path.read_bytes())
    write_cameras_json(capture / "cameras.json", photos)
    ds.write_gaussians(tmp_path / "scene.ply", scene)
    line = ["embed", str(capture), "--segmenter", "graph", "--encoder", "drsplat-mini"]
    with_scene = [*line, "--scene", str(tmp_path / "scene.ply"), "--views", "6", "--crops", "objects"]
    assert cli.main(with_scene) == 0
    said = capsys.readouterr().out
    assert f"{COUNT - 6} photos; the chosen ones show" in said
    assert (capture / "language_features.parts" / MASKS).is_dir()
    assert (capture / "language_features.parts" / CROPS).is_dir()
    assert len(read_features(capture / "language_features")) == 6
    assert "--views auto needs the scene of the photos: give --scene SCENE" in error_of(
        capsys, *line, "--views", "auto"
    )
    assert "--crops objects needs the scene of the photos" in error_of(capsys, *line, "--crops", "objects")


def test_without_embedding_every_mask_has_the_same_vector():
    assert WithoutEmbedding().encode_images([np.zeros((2, 2, 3), np.uint8)] * 3).tolist() == [[1.0]] * 3
