"""The layer that the commands, the viewer, the service and language models share."""

import json
import shutil
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drsplat import MiniEncoder, WordEncoder, write_gaussians
from drsplat.errors import InputError, MismatchError
from drsplat.query import Cut, Query, Scene, find_scene, open_scene
from drsplat.query.places import nearest_gaussian
from drsplat.query.regions import region
from drsplat.query.relations import gap, stands_on
from drsplat.scene.boxes import upward
from refusing import refused


@pytest.fixture(scope="module")
def room(household_story, household_folder) -> Scene:
    return open_scene(household_folder, threads=1)


@pytest.fixture(scope="module")
def centers(household_folder, room) -> dict[str, tuple[float, float, float]]:
    known = json.loads((household_folder / "truth.json").read_text(encoding="utf-8"))
    return {thing["category"]: tuple(thing["center"]) for thing in known["objects"]}


def vector(text: str) -> np.ndarray:
    return np.asarray(MiniEncoder().encode_texts([text])[0], np.float32)


@pytest.mark.parametrize("color", ["green", "blue"])
def test_a_thing_is_not_found_in_another_colour(color, room):
    """The vase is red; no other name fits it better."""
    assert room.ask("red vase").gaussian_ids.size > 1000
    assert not room.ask(f"{color} vase").gaussian_ids.size


def test_what_fits_half_of_a_query_is_left_out(room):
    """The room has a red bookcase too, which fits "red vase" better than any name of the list."""
    (vase,) = room.locate("red vase")
    assert max(vase.extent) < 0.3


def test_a_query_in_words_and_its_vector_have_the_same_scores(room):
    words = room.ask("red vase")
    same = room.ask(Query(vector=vector("red vase") * 4))
    assert_array_equal(words.scores, same.scores)
    assert (words.rule, same.rule) == ("list", "auto")
    assert_array_equal(words.gaussian_ids, room.field.gaussian_ids[words.values > words.threshold])


def test_a_point_a_gaussian_and_a_click_mean_the_thing_that_is_there(room, centers):
    vase = room.locate("red vase")[0]
    there = room.locate(Query(point=centers["red vase"]))[0]
    overlap = np.intersect1d(vase.gaussian_ids, there.gaussian_ids)
    assert len(overlap) > 0.7 * len(vase)
    view = room.best_view(vase.gaussian_ids)
    seen = view.K @ (view.cam_from_world @ np.append(vase.center, 1))[:3]
    click = (view.name, float(seen[0] / seen[2]), float(seen[1] / seen[2]))
    nearest = room.nearest(centers["red vase"])
    for place in (centers["red vase"], click, nearest):
        assert room.what_is(place)[0].text == "red vase"
        assert [one.text for one in room.what_is(place, ["mug", "vase"])] == ["vase", "mug"]
    assert np.linalg.norm(room.point_at(click) - vase.center) < 0.15


def test_an_image_is_asked_like_its_vector(room):
    picture = np.zeros((40, 40, 3), np.uint8)
    picture[5:35, 5:35] = (200, 30, 30)
    asked = room.ask(Query(image=picture))
    assert asked.measure == "cosine"
    assert_allclose(asked.vector, MiniEncoder().encode_images([picture])[0], atol=1e-6)


def test_evidence_names_photos_of_the_scene(room):
    names = {view.name for view in room.views}
    for found in room.locate("toys"):
        assert 0 < len(found.support) <= 3
        assert {one.view_name for one in found.support} <= names
    assert room.locate("laptop") == []
    assert len(room.locate("toys", top=1)) == 1


def test_classes_are_those_that_are_there(room):
    found = room.segment(["red vase", "laptop", "orange sofa"])
    counts = found.counts
    assert counts[1] == 0
    assert min(counts[0], counts[2]) > 500
    assert found.labels.shape == (len(room.gaussians),)
    for bad in ([], ["mug", "mug"]):
        with refused("different classes"):
            room.segment(bad)


@pytest.mark.slow
def test_a_region_is_what_lies_in_it(room, centers):
    found = region(room, centers["red vase"], 0.2)
    assert found[0].name == "red vase"
    assert sum(one.share for one in found) <= 1 + 1e-9
    assert [one.num_gaussians for one in found] == sorted((one.num_gaussians for one in found), reverse=True)
    larger = {one.name for one in region(room, centers["red vase"], 0.6)}
    assert {"table", "red vase"} <= larger
    with refused("positive radius"):
        region(room, centers["red vase"], 0.0)
    with refused("no Gaussian with a feature"):
        region(room, (90.0, 0.0, 0.0), 1.0)
    with refused("no Gaussian with a feature"):
        region(room, (1e300, 0.0, 0.0), 1e200)
    everything = [region(room, (0.0, 0.0, 0.0), radius) for radius in (1e3, 1e300)]
    first, second = ([one.name for one in parts] for parts in everything)
    assert first == second


def test_how_things_lie(room):
    """Truth: the demo's z is up, the duck is on the table, the stacking toy is not, nor is the table on the duck."""
    up = upward(room.views)
    assert up[2] > 0.99
    duck, stack, table = (room.locate(text)[0] for text in ("toy duck", "stacking toy", "table"))
    assert stands_on(room.gaussians, duck, table, up)
    assert not stands_on(room.gaussians, stack, table, up)
    assert not stands_on(room.gaussians, table, duck, up)
    apart = float(np.linalg.norm(duck.center - stack.center))
    assert 0 < gap(room.gaussians, duck, stack) < apart
    assert gap(room.gaussians, duck, stack) == gap(room.gaussians, stack, duck)
    assert gap(room.gaussians, duck, duck) == 0
    with refused("has none"):
        upward([])


def test_nearest_is_among_the_candidates(room):
    rng = np.random.default_rng(0)
    for _ in range(20):
        some = np.sort(rng.choice(len(room.gaussians), 500, replace=False))
        target = int(rng.choice(some))
        x, y, z = (float(value) for value in room.gaussians.means[target])
        found = nearest_gaussian(room.gaussians, some, (x, y, z))
        assert found in some
    with refused("no Gaussian of this scene"):
        nearest_gaussian(room.gaussians, np.empty(0, np.int64), (0.0, 0.0, 0.0))
    with refused("three finite numbers"):
        room.nearest((float("nan"), 0.0, 0.0))
    for far in (50.0, 1e20, 1e39, 1e160, 1e300):
        for point in ((far, 0.0, 0.0), (0.0, -far, far)):
            with refused("the nearest Gaussian is"):
                room.nearest(point)


def test_pictures_keep_the_answer_in_colour(room):
    asked = room.ask("orange sofa")
    view = room.best_view(asked.gaussian_ids)
    plain = room.picture(view)
    assert plain.shape == (view.height, view.width, 3)
    shown = room.picture(view.name, asked, max_side=320)
    assert max(shown.shape) == 320
    grey = room.picture(view, np.empty(0, np.int64))
    assert np.ptp(grey.astype(int), axis=-1).max() < 4
    assert np.ptp(shown.astype(int), axis=-1).max() > 100
    photo = room.picture(view, photo=True)
    assert 0 < np.abs(photo.astype(int) - plain).mean() < 40
    with refused("no view 'nowhere'"):
        room.picture("nowhere")


WRONG = [
    (lambda: Query(), "exactly one of"),
    (lambda: Query(text="a", point=(0.0, 0.0, 0.0)), "exactly one of"),
    (lambda: Query(point=(0.0, 0.0, 0.0), exclude=("red",)), "in words"),
    (lambda: Query(text="a", threshold="best"), "'auto'"),
    (lambda: Query(text="a", threshold=0.5, top_share=0.1), "drop one"),
    (lambda: Query(text="a", threshold="auto", relevancy=True), "drop relevancy=True"),
    (lambda: Query(text="a", objects="always"), "objects: expected 'auto' or 'never', got 'always'"),
    (lambda: Cut(objects=""), "objects: expected 'auto' or 'never', got ''"),
]


@pytest.mark.parametrize(("make", "message"), WRONG)
def test_queries_that_are_none(make, message):
    with refused(message):
        make()


def test_what_is_asked_wrongly_of_a_scene(room):
    with pytest.raises(MismatchError, match="7 numbers"):
        room.ask(Query(vector=np.ones(7, np.float32)))
    with refused("has no feature"):
        room.what_is(len(room.gaussians) + 5)
    with refused("has no feature"):
        room.what_is(-1)
    nobody = Scene(room.field, room.gaussians, encoder=raising)
    with refused("none stored: pass negatives=WORDS"):
        nobody.ask(Query(point=(0.3, 0.14, 0.82), relevancy=True))
    assert room.ask(Query(point=(0.3, 0.14, 0.82), relevancy=True)).measure == "relevancy"


def raising() -> MiniEncoder:
    raise InputError("no encoder is known")


def test_threads_ask_at_once_what_one_asks_alone(household_folder, room):
    texts = ["red vase", "toys", "candle", "sofa", "apple", "plant", "carrot", "laptop"] * 3
    fresh = open_scene(household_folder, threads=1)
    with ThreadPoolExecutor(8) as pool:
        together = list(pool.map(lambda text: fresh.ask(text), texts))
    for text, asked in zip(texts, together, strict=True):
        alone = room.ask(text)
        assert_array_equal(asked.values, alone.values)
        assert asked.threshold == alone.threshold


def test_the_scene_that_was_registered_is_found_among_others(household_folder, room, story, demo_folder, tmp_path):
    folder = tmp_path / "room"
    folder.mkdir()
    with refused("expected a searchable scene"):
        find_scene(folder)
    shutil.copytree(demo_folder / "room.field", folder / "room.field")
    with refused("expected a scene"):
        find_scene(folder)
    write_gaussians(folder / "a_part.ply", story.gaussians.subset(np.arange(50)))
    with pytest.raises(MismatchError, match="50"):
        open_scene(folder)
    shutil.copy(demo_folder / "scene.ply", folder / "the_scene.ply")
    opened = open_scene(folder)
    assert opened.gaussians.fingerprint == story.gaussians.fingerprint
    assert opened.views == ()
    with refused("no views"):
        opened.picture()
    assert isinstance(opened.encoder, WordEncoder)
    with refused("takes any words"):
        opened.what_is(int(opened.field.gaussian_ids[0]))
    shutil.copytree(folder / "room.field", folder / "other.field")
    with refused(r"other\.field, .*room\.field"):
        open_scene(folder)
    with refused("no such file or folder"):
        open_scene(folder / "none")
