"""What belongs together: choosing nodes of a forest, and the true things of rendered rooms."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from drsplat import Gaussians, LanguageField, Registration, View
from drsplat.errors import InputError
from drsplat.field.evidence.changing import without_views
from drsplat.field.evidence.evidence import Evidence, MaskIds
from drsplat.field.forest import GROUP, PART, THING
from drsplat.field.objects.choosing import best_nodes, choose
from drsplat.field.objects.finding import divided, find_objects, views_beyond
from drsplat.formats.gaussian_ply import vertex_columns
from drsplat.formats.ply import write_vertices
from drsplat.kernels import Forest


def forest(parents: list[int], sizes: list[int], fits: list[float], spreads: list[float] | None = None) -> Forest:
    count = len(parents)
    return Forest(
        np.array(parents, np.int32),
        np.ones(count, np.float32),
        np.array(sizes, np.int32),
        np.array(sizes, np.float32),
        np.array(fits, np.float32),
        np.array(spreads or [0.0] * count, np.float32),
    )


@given(st.integers(0, 10_000), st.integers(1, 11))
def test_the_chosen_set_is_the_best_of_all(seed, count):
    """Against all sets of nodes of which none is above another."""
    rng = default_rng(seed)
    parents = np.array([rng.integers(k + 1, count + 1) if k < count - 1 else count for k in range(count)])
    parents = np.where(parents == count, -1, parents).astype(np.int32)
    worth = np.where(rng.random(count) < 0.2, -1.0, rng.random(count))
    above = np.zeros((count, count), bool)
    for node in range(count):
        up = parents[node]
        while up >= 0:
            above[node, up] = True
            up = parents[up]
    best = 0.0
    for number in range(2**count):
        chosen = [k for k in range(count) if number >> k & 1]
        if worth[chosen].min(initial=0) >= 0 and not above[np.ix_(chosen, chosen)].any():
            best = max(best, float(worth[chosen].sum()))
    found = best_nodes(parents, worth)
    assert not above[np.ix_(found, found)].any()
    assert worth[found].sum() == pytest.approx(best)


def test_levels_of_a_small_forest():
    """Rows 0 to 5; 6 = {0, 1}, 7 = {2, 3} make the thing 8; 9 = {4, 5}; 10 holds both: a group, as 11 is more."""
    parents = [6, 6, 7, 7, 9, 9, 8, 8, 10, 10, 11, -1]
    sizes = [20] * 6 + [40, 40, 80, 40, 120, 300]
    fits = [0.0] * 6 + [0.6, 0.6, 0.9, 0.8, 0.1, 0.05]
    chosen = choose(forest(parents, sizes, fits), np.arange(6), 30)
    assert chosen.levels.tolist() == [PART, PART, THING, THING, GROUP]
    assert chosen.node_of.tolist() == [0, 0, 1, 1, 3, 3]
    assert chosen.parents.tolist() == [2, 2, 4, 4, -1]
    assert_allclose(chosen.sure, [0.6, 0.6, 0.9, 0.8, 0.1])


def test_a_plate_is_not_the_table_that_it_is_on():
    """Rows 0 to 4. 5 = {0} is the plate, 6 = {1, 2} and 7 = {3} the table, 8 = {5, 6}, and 9 all: the best thing."""
    parents, sizes = [5, 6, 6, 7, -1, 8, 8, 9, 9, -1], [10] * 5 + [40, 800, 800, 840, 1640]
    fits = [0.0] * 5 + [0.3, 0.5, 0.5, 0.5, 0.7]
    chosen = choose(forest(parents, sizes, fits), np.arange(5), 30)
    assert chosen.levels.tolist() == [THING, PART, PART, THING, GROUP]
    assert chosen.parents.tolist() == [4, 3, 3, 4, -1]
    assert chosen.node_of.tolist() == [0, 1, 1, 2, -1]
    assert_allclose(chosen.sure, [0.3, 0.5, 0.5, 0.7, 0.7])
    assert choose(forest(parents, sizes, [*fits[:5], 0.1, *fits[6:]]), np.arange(5), 30).levels.tolist() == [
        PART,
        PART,
        THING,
    ]
    large = [*sizes[:5], 200, *sizes[6:]]
    assert THING not in choose(forest(parents, large, fits), np.arange(5), 30).levels[:-1]


def test_things_that_look_unlike_are_not_one():
    parents, sizes = [2, 2, -1], [40, 40, 80]
    alike = choose(forest(parents, sizes, [0.5, 0.5, 0.9], [0, 0, 0.1]), np.arange(2), 30)
    unlike = choose(forest(parents, sizes, [0.5, 0.5, 0.9], [0, 0, 0.6]), np.arange(2), 30)
    assert (alike.levels == THING).sum() == 1
    assert (unlike.levels == THING).sum() == 2


def gaussians(points: np.ndarray) -> Gaussians:
    count = len(points)
    return Gaussians(
        means=points.astype(np.float32),
        quats=np.tile(np.float32([1, 0, 0, 0]), (count, 1)),
        scales=np.full((count, 3), 0.02, np.float32),
        opacities=np.full(count, 0.9, np.float32),
        sh=np.zeros((count, 1, 3), np.float32),
    )


def registered(num_views: int, owner: np.ndarray, points: np.ndarray, masks: int) -> tuple[Gaussians, LanguageField]:
    """A field of Gaussians that each view sees, with mask `owner` of each."""
    from scipy.sparse import csr_array

    from drsplat import EncoderIdentity

    count = len(owner)
    columns = owner[None] + masks * np.arange(num_views)[:, None]
    w = csr_array(
        (np.ones(columns.size, np.float32), (np.tile(np.arange(count), num_views), columns.ravel())),
        shape=(count, masks * num_views),
    )
    ids = MaskIds(
        tuple(f"{v}.jpg" for v in range(num_views)),
        np.repeat(np.arange(num_views, dtype=np.int32), masks),
        np.tile(np.arange(masks, dtype=np.int32), num_views),
    )
    embeddings = np.tile(np.eye(masks, 8, dtype=np.float32), (num_views, 1))
    embeddings[~embeddings.any(axis=1), 0] = 1
    scene = gaussians(points)
    evidence = Evidence(w, ids, embeddings)
    return scene, Registration(evidence, scene.fingerprint, EncoderIdentity("test", 8)).to_field()


def clusters(rng: np.random.Generator, count: int, each: int) -> tuple[np.ndarray, np.ndarray]:
    owner = np.repeat(np.arange(count), each)
    return owner, rng.normal(0, 0.1, (count * each, 3)) + owner[:, None] * np.array([0.35, 0, 0])


def test_of_more_weights_those_of_some_views_are_looked_at(monkeypatch):
    owner, points = clusters(default_rng(0), 3, 200)
    scene, field = registered(7, owner, points, 3)
    assert field.evidence is not None
    whole = field.evidence
    assert not views_beyond(whole, whole.weights.nnz).any()
    gone = views_beyond(whole, int(2.5 * len(points)))
    assert np.count_nonzero(~gone) == 2
    names = np.array(whole.masks.view_names)
    fewer = without_views(whole, np.arange(7) == np.flatnonzero(gone)[0])
    left = np.array(fewer.masks.view_names)[~views_beyond(fewer, int(2.5 * len(points)))]
    assert left.tolist() == names[~gone].tolist()  # a view that is not drawn changes nothing
    monkeypatch.setattr("drsplat.field.objects.finding.MAX_WEIGHTS", int(2.5 * len(points)))
    monkeypatch.setattr("drsplat.field.objects.finding.WEIGHTS_PER_ROW", 0)
    kept = divided(whole, points.astype(np.float32)).nodes.scene.arrays["kept"]
    assert kept.tolist() == (~gone)[whole.masks.views].tolist()
    assert find_objects(field, scene).num_views.tolist() == [7, 7, 7]  # described from all


def test_three_things_side_by_side_are_three_objects():
    owner, points = clusters(default_rng(0), 3, 200)
    scene, field = registered(4, owner, points, 3)
    objects = find_objects(field, scene)
    assert len(objects) == 3
    numbers = objects.thing_of()
    assert (numbers >= 0).mean() > 0.97  # a few lie apart from all others
    assert all(len(np.unique(numbers[(owner == k) & (numbers >= 0)])) == 1 for k in range(3))
    again = find_objects(field, scene, threads=5)
    for name, array in objects.tensors().items():
        assert_array_equal(array, again.tensors()[name])


@pytest.mark.parametrize("masks", [1, 2])
def test_one_view_is_enough_to_say_something(masks):
    owner, points = clusters(default_rng(1), masks, 100)
    scene, field = registered(1, owner, points, masks)
    assert len(find_objects(field, scene)) == masks


def test_many_masks_of_one_pixel_are_no_objects():
    """A mask for each Gaussian in each view: nothing belongs together, and nothing breaks."""
    rng = default_rng(2)
    scene, field = registered(3, np.arange(400), rng.random((400, 3)), 400)
    objects = find_objects(field, scene)
    assert len(objects.node_of) == 400
    assert len(find_objects(*reversed(registered(1, np.zeros(3, int), rng.random((3, 3)), 1)))) == 0


def test_a_field_without_evidence_says_what_to_do():
    owner, points = clusters(default_rng(3), 2, 50)
    scene, field = registered(2, owner, points, 2)
    with pytest.raises(InputError, match="without: register again"):
        find_objects(replace(field, evidence=None), scene)


SCENE = Path(__file__).parents[2] / "world" / "scenes" / "room_5"


@pytest.mark.slow
def test_the_true_things_of_a_room_are_objects():
    """With true masks nearly each thing of 60 Gaussians is one object; the number is that of the page, less some."""
    from benchmarks.suite.masks import features_of
    from benchmarks.suite.scenes import owners, read_scene

    from drsplat import MiniEncoder, read_views, register

    scene = read_scene(SCENE, 2)
    field = register(scene.gaussians, scene.views, features_of(scene, "true", MiniEncoder())).to_field()
    truth = json.loads((SCENE / "truth.json").read_text(encoding="utf-8"))
    known = owners(SCENE, scene.gaussians, read_views(SCENE), len(truth["objects"]) + len(truth["structures"]))
    numbers = np.full(field.num_gaussians, -1)
    numbers[field.gaussian_ids] = find_objects(field, scene.gaussians).thing_of()
    best = []
    for thing in truth["objects"]:
        mine = known == thing["id"]
        if mine.sum() >= 60:
            shared = np.bincount(numbers[mine & (numbers >= 0)], minlength=numbers.max() + 1)
            whole = np.bincount(numbers[numbers >= 0], minlength=numbers.max() + 1)
            best.append((shared / (whole + mine.sum() - shared)).max())
    assert len(best) > 10
    assert np.mean(np.array(best) >= 0.5) > 0.85
    assert np.mean(best) > 0.85


@pytest.mark.slow
def test_objects_are_the_same_wherever_and_however_large_a_room_is(tmp_path):
    """Rounded to float32 at z = 100, Gaussians of nearly one depth would change places."""
    from benchmarks.suite.masks import features_of
    from benchmarks.suite.scenes import read_scene

    from drsplat import PQ, MiniEncoder, read_gaussians, register

    scene = read_scene(SCENE, 5)
    features = features_of(scene, "true", MiniEncoder())
    found = []
    for scale, at in ((1.0, (0.0, 0, 0)), (1.0, (0.0, 0, 100)), (0.1, (5e5, 5.4e6, 100))):
        place, path = np.array(at), tmp_path / f"{len(found)}.ply"
        write_placed(path, scene.gaussians, scale, place)
        gaussians = read_gaussians(path)
        views = [seen_from(view, scale, place) for view in scene.views]
        field = register(gaussians, views, features).to_field(PQ(2))
        found.append(
            dict(zip(field.gaussian_ids.tolist(), find_objects(field, gaussians).node_of.tolist(), strict=True))
        )
    assert len(set(found[0].values())) > 20
    assert found[1:] == found[:1] * 2


def write_placed(path: Path, gaussians: Gaussians, scale: float, at: np.ndarray) -> None:
    """Write a scene at another size and place, its positions as double."""
    columns = vertex_columns(replace(gaussians, scales=gaussians.scales * np.float32(scale)))
    positions = gaussians.positions * scale + at
    write_vertices(path, columns | dict(zip("xyz", positions.T, strict=True)))


def seen_from(view: View, scale: float, at: np.ndarray) -> View:
    """Return the camera that sees such a scene as `view` sees the scene itself."""
    pose = view.cam_from_world.copy()
    pose[:3, 3] = pose[:3, 3] * scale - pose[:3, :3] @ at
    return replace(view, cam_from_world=pose)
