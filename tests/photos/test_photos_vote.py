"""Photos of a field are looked at again, and vote for its objects."""

import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from PIL import Image

import drsplat as ds
from command_line import answer_of, error_of
from drsplat import Scene, cli
from drsplat.authoring.exporting.masking import draw_features
from drsplat.errors import DrSplatWarning, InputError
from drsplat.field.forest import JOINED, VOTED
from drsplat.field.growing import change_field, remove_views
from drsplat.field.objects.finding import find_objects
from drsplat.formats.poses import write_cameras_json
from drsplat.formats.tensors import read_tensors
from drsplat.photos.embedding import objects_first
from drsplat.photos.embedding.growing import grow_field
from drsplat.photos.embedding.voting import vote_for_objects, votes_beside
from drsplat.photos.models.outlines import region_tree
from drsplat.photos.models.outlines.regions import basins
from drsplat.scene.masks.masks import LEVELS
from growing_fields import files_of
from refusing import refused
from scenes import look_at_view
from toy_capture import PER_THING, balls

WIDTH, HEIGHT = 160, 120


WALL = 2  # number of what is behind both balls


@pytest.fixture(scope="module")
def scene() -> ds.Gaussians:
    """Two balls before a grey wall."""
    two = balls()
    along = np.arange(-2.5, 2.55, 0.1)
    means = np.stack([*map(np.ravel, np.meshgrid(along, [0.8], along))], -1)
    count = len(means)
    wall = (
        means, np.tile([1.0, 0, 0, 0], (count, 1)), np.full((count, 3), 0.08), np.full(count, 0.95),
        np.full((count, 1, 3), 0.3),
    )  # fmt: skip
    parts = (two.means, two.quats, two.scales, two.opacities, two.sh)
    return ds.Gaussians(*(np.concatenate(both).astype(np.float32) for both in zip(parts, wall, strict=True)))


def things(scene: ds.Gaussians) -> np.ndarray:
    """Of each Gaussian a ball, or WALL."""
    return np.append(np.repeat([0, 1], PER_THING), np.full(len(scene) - 2 * PER_THING, WALL))


@pytest.fixture(scope="module")
def photos(tmp_path_factory, scene) -> list[ds.View]:
    folder = tmp_path_factory.mktemp("photos")
    views = []
    for number, turn in enumerate(np.linspace(-0.6, 0.6, 5)):
        at = look_at_view((2.4 * np.sin(turn), -2.4 * np.cos(turn), 0.4), width=WIDTH, height=HEIGHT)
        view = replace(at, name=f"{number}.png", image_path=folder / f"{number}.png")
        picture = np.clip(ds.render(scene, view).rgb * 255, 0, 255).astype(np.uint8)
        Image.fromarray(picture).save(folder / view.name)
        views.append(view)
    return views


@pytest.fixture(scope="module")
def features(scene, photos) -> dict[str, ds.ViewFeatures]:
    """Masks that cut each ball in an upper and a lower half, in every photo; the wall is one."""
    number = 2 * things(scene) + ((scene.means[:, 2] > 0) & (things(scene) != WALL))
    found = {}
    for view in photos:
        share = ds.render(scene, view, values=np.eye(5, dtype=np.float32)[number]).channels
        found[view.name] = ds.ViewFeatures(share.argmax(2).astype(np.int32), np.eye(5, 8, dtype=np.float32))
    return found


@pytest.fixture(scope="module")
def halves(scene, photos, features) -> ds.LanguageField:
    return ds.register(scene, photos, features).to_field(ds.PQ(4))


def test_halves_of_a_ball_become_a_ball(scene, photos, halves, tmp_path):
    found = find_objects(halves, scene)
    voted = vote_for_objects(halves, scene, photos, kept=tmp_path)
    assert len(found) == 5
    assert len(voted) == 3
    owners = things(scene)[halves.gaussian_ids]
    for thing in voted.things.tolist():
        rows = voted.rows(thing)
        same = owners[rows] == np.bincount(owners[rows]).argmax()
        assert same.mean() > 0.95
        assert len(voted.below(thing)) == (0 if owners[rows[0]] == WALL else 2)


def test_the_result_is_the_same_at_any_number_of_threads_and_from_kept_parts(scene, photos, halves, tmp_path):
    one = vote_for_objects(halves, scene, photos, kept=tmp_path / "one", threads=1)
    three = vote_for_objects(halves, scene, photos, kept=tmp_path / "three", threads=3)
    files = {path: path.stat().st_mtime_ns for path in (tmp_path / "one").iterdir()}
    assert len(files) == 2 * len(photos)
    trees = [read_tensors(path)[0] for path in files if ".regions." in path.name]
    assert {len(tree["pairs"]) - 2 * tree["labels"].max() for tree in trees} == {0}  # of both orders
    again = vote_for_objects(halves, scene, photos, kept=tmp_path / "one")
    assert files == {path: path.stat().st_mtime_ns for path in (tmp_path / "one").iterdir()}
    next(iter(files)).write_bytes(b"damaged")
    mended = vote_for_objects(halves, scene, photos, kept=tmp_path / "one")
    for other in (three, again, mended):
        for name, array in one.tensors().items():
            assert_array_equal(array, other.tensors()[name], err_msg=name)


def test_what_an_earlier_version_kept_of_photos_is_made_again(scene, photos, halves, tmp_path, monkeypatch):
    kept = tmp_path / "kept"
    with monkeypatch.context() as patch:
        patch.setattr("drsplat.photos.embedding.voting.identity", lambda: "1 of earlier weights")
        vote_for_objects(halves, scene, photos, kept=kept)
    with refused("none of 0 photos is of this field"):
        vote_for_objects(halves, scene, [], kept=kept)
    with pytest.warns(DrSplatWarning, match="2 photos of the field do not vote.*: 3.png, 4.png"):
        vote_for_objects(halves, scene, photos[:3], kept=kept)
    mended = vote_for_objects(halves, scene, photos, kept=kept)
    fresh = vote_for_objects(halves, scene, photos, kept=tmp_path / "fresh")
    for name, array in fresh.tensors().items():
        assert_array_equal(array, mended.tensors()[name], err_msg=name)
    assert files_of(kept) == files_of(tmp_path / "fresh")


def test_photos_of_something_else_are_refused(scene, photos, halves, tmp_path):
    with refused(r"none of 0 photos is of this field, whose photos are named like '0.png'"):
        vote_for_objects(halves, scene, [replace(view, image_path=None) for view in photos], kept=tmp_path)
    with refused("keeps its evidence"):
        vote_for_objects(replace(halves, evidence=None, growth=None), scene, photos, kept=tmp_path)


def write_room(folder: Path, scene: ds.Gaussians, photos: list[ds.View]) -> None:
    ds.write_gaussians(folder / "scene.ply", scene)
    shutil.copytree(photos[0].image_path.parent, folder / "capture/images")
    write_cameras_json(folder / "capture/cameras.json", photos)


def test_the_verb_asks_the_photos(scene, photos, halves, tmp_path, capsys):
    write_room(tmp_path, scene, photos)
    halves.save(tmp_path / "room.field")
    line = ["objects", tmp_path / "room.field", "--scene", tmp_path / "scene.ply"]
    assert answer_of(capsys, *line)["num_objects"] == 5
    assert answer_of(capsys, *line, "--vote", "--views", tmp_path / "capture")["num_objects"] == 3
    assert not (tmp_path / "room.field.parts").exists()
    assert answer_of(capsys, *line, "--vote")["num_objects"] == 3  # of what is kept
    shutil.rmtree(votes_beside(tmp_path / "room.field"))
    assert "none of 0 photos is of this field" in error_of(capsys, *line, "--again", "--vote")


# --- photos come and go -----------------------------------------------------------------------------


def voted_at(path: Path, scene, photos, features) -> Path:
    """Write a field of some photos that have voted, all at once."""
    field = ds.register(scene, photos, features).to_field(ds.PQ(4))
    voted = vote_for_objects(field, scene, photos, kept=votes_beside(path))
    field.with_objects(voted).save(path)
    return path


def again(path: Path, scene):
    return lambda field: vote_for_objects(field, scene, (), kept=votes_beside(path))


def others_than(one: Path, two: Path) -> set[str]:
    assert files_of(one).keys() == files_of(two).keys()
    return {name for name, content in files_of(one).items() if content != files_of(two)[name]}


def test_a_photo_joins_the_voted_objects_which_are_then_those_of_all_at_once(
    scene, photos, features, tmp_path, monkeypatch
) -> None:
    path = voted_at(tmp_path / "a.field", scene, photos[:-1], features)
    every = voted_at(tmp_path / "b.field", scene, photos, features)
    before = ds.load_field(path).objects

    def stopped(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("drsplat.photos.embedding.voting.find_tree", stopped)
        with pytest.raises(KeyboardInterrupt):
            grow_field(path, scene, photos[-1:], features, tmp_path)
    field = ds.load_field(path)
    now = field.objects
    assert before is not None
    assert now is not None
    assert field.evidence is not None
    assert photos[-1].name in field.evidence.masks.view_names
    assert (before.votes, now.votes) == (VOTED, JOINED)
    np.testing.assert_array_equal(now.parents, before.parents)
    assert (now.num_views == before.num_views + 1).all()
    change = grow_field(path, scene, photos[-1:], features, tmp_path)
    assert change.is_empty
    assert change.field.objects is not None
    assert change.field.objects.votes == VOTED
    assert others_than(path, every) == set()


def test_photos_are_added_to_and_taken_from_voted_objects(scene, photos, features, tmp_path) -> None:
    path = voted_at(tmp_path / "a.field", scene, photos[:3], features)
    change = grow_field(path, scene, photos[3:], features, tmp_path)
    assert [*change.seconds][-4:] == ["code", "joined", "objects", "save"]
    assert others_than(path, voted_at(tmp_path / "b.field", scene, photos, features)) == set()
    gone = [photos[0].name, photos[4].name]
    change_field(path, scene, lambda field: remove_views(field, scene, gone), vote=again(path, scene))
    fewer = voted_at(tmp_path / "c.field", scene, photos[1:4], features)
    assert others_than(path, fewer) == {"field.json"}  # which remembers those two


def test_votes_that_are_lost_are_told(scene, photos, features, tmp_path) -> None:
    path = voted_at(tmp_path / "a.field", scene, photos[:4], features)
    with pytest.warns(DrSplatWarning, match="photos voted for the objects, which are found again without votes"):
        change_field(path, scene, lambda field: remove_views(field, scene, [photos[3].name]))
    path = voted_at(tmp_path / "b.field", scene, photos[:4], features)
    shutil.rmtree(votes_beside(path))
    with pytest.warns(DrSplatWarning, match="4 photos of the field do not vote"):
        grow_field(path, scene, photos[4:], features, tmp_path)
    shutil.rmtree(votes_beside(path))
    with pytest.raises(InputError, match="give its photos, or find its objects again without votes"):
        change_field(path, scene, lambda field: remove_views(field, scene, [photos[0].name]), vote=again(path, scene))


# --- masks of what was voted for ------------------------------------------------------------------


@pytest.fixture(scope="module")
def voted(scene, photos, halves, tmp_path_factory) -> Path:
    """A folder with scene, capture and field: three things, two of them of two parts."""
    folder = tmp_path_factory.mktemp("voted")
    write_room(folder, scene, photos)
    objects = vote_for_objects(halves, scene, photos, kept=folder / "room.field.votes")
    halves.with_objects(objects).save(folder / "room.field")
    return folder


def embed_line(folder: Path, output: Path, *more: str, masks: str = "room.field") -> list[str]:
    given = ["--masks", folder / masks, "--scene", folder / "scene.ply", "--encoder", "drsplat-mini"]
    return [*map(str, ["embed", folder / "capture", *given, "--output", output]), *more]


@pytest.fixture(scope="module")
def embedded(voted) -> Path:
    """Features of the masks of what was voted for."""
    assert cli.main(embed_line(voted, voted / "things")) == 0
    return voted / "things"


def test_voted_things_become_masks_and_register_and_a_click_go_on_from_them(voted, embedded, photos, tmp_path):
    objects = ds.load_field(voted / "room.field").objects
    levels = {level: ds.read_features(embedded, level) for level in LEVELS}
    for view in photos:
        numbers = {level: set(levels[level][view.name].file_rows.tolist()) for level in LEVELS}
        assert numbers["large"] == numbers["default"] == set(objects.things.tolist())
        assert numbers["medium"] == numbers["small"]
        assert len(numbers["medium"]) == 5
        above = {objects.above(node) for node in numbers["medium"] if objects.levels[node] == 0}
        assert above < numbers["large"]
    paths = [tmp_path / "again.field", "--scene", voted / "scene.ply"]
    register = ["register", voted / "scene.ply", voted / "capture", "--features", embedded, "--output"]
    assert cli.main([*map(str, [*register, paths[0]])]) == 0
    assert cli.main([*map(str, ["objects", *paths])]) == 0
    again = ds.open_scene(paths[0], scene=paths[2], views=voted / "capture")
    assert len(again.objects) == 3
    for ball, place in enumerate([(-0.7, 0.0, 0.0), (0.7, 0.0, 0.0)]):
        view = photos[2]
        x, y, z = view.K @ (view.cam_from_world[:3, :3] @ place + view.cam_from_world[:3, 3])
        found = again.ask(ds.Query(click=(view.name, x / z, y / z))).gaussian_ids
        own = np.arange(ball * PER_THING, (ball + 1) * PER_THING)
        assert len(np.intersect1d(found, own)) / len(np.union1d(found, own)) > 0.9


def test_a_few_crops_of_each_thing_stand_for_all_of_its_masks(voted, embedded, photos, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(objects_first, "share_crops", partial(objects_first.share_crops, most=2))
    answer = answer_of(capsys, *embed_line(voted, tmp_path / "few", "--crops", "objects"))
    assert answer["num_crops"] == 6  # two of each of three things
    every, few = (ds.read_features(folder) for folder in (embedded, tmp_path / "few"))
    for view in photos:
        assert_array_equal(every[view.name].mask_ids, few[view.name].mask_ids)
        assert_array_equal(every[view.name].file_rows, few[view.name].file_rows)
    rows = [np.stack([folder[view.name].embeddings for view in photos]) for folder in (every, few)]
    mean = rows[0].mean(0) / np.linalg.norm(rows[0].mean(0), axis=1, keepdims=True)
    assert ((rows[1] * mean).sum(2) > 0.8).all()
    apart = [np.linalg.norm(some - some.mean(0), axis=2).mean(0) for some in rows]
    assert (apart[1] < apart[0]).all()


def test_drawn_masks_stay_until_objects_or_masks_of_photos_change(voted, photos, tmp_path):
    scene = ds.open_scene(voted / "room.field", scene=voted / "scene.ply", views=voted / "capture")
    masks = draw_features(tmp_path / "masks", scene, scene.views)
    files = {view.name: masks.files(view.name)[0] for view in photos}
    first = {name: path.read_bytes() for name, path in files.items()}
    files[photos[0].name].unlink()
    kept = {name: files[name].stat().st_mtime_ns for name in files if name != photos[0].name}
    Image.fromarray(np.tile(np.uint8([0, 255]), (HEIGHT, WIDTH // 2))).save(tmp_path / "half.png")
    some = [replace(view, mask_path=tmp_path / "half.png") if view.name == photos[1].name else view
            for view in scene.views]  # fmt: skip
    again = draw_features(tmp_path / "masks", scene, some)
    changed = photos[1].name
    assert {name for name in kept if files[name].stat().st_mtime_ns != kept[name]} == {changed}
    assert all(path.read_bytes() == first[name] for name, path in files.items() if name != changed)
    assert (again.stored(changed)[0][:, :, ::2] == -1).all()
    assert (again.stored(changed)[0][:, :, 1::2] >= 0).any()
    assert scene.field.objects is not None
    fewer = Scene(scene.field.with_objects(None), scene.gaussians, scene.views)
    with refused("nobody has looked for objects"):
        draw_features(tmp_path / "none", fewer, scene.views)


def test_what_no_photo_shows_in_front_is_told(voted, tmp_path):
    scene = ds.open_scene(voted / "room.field", scene=voted / "scene.ply", views=voted / "capture")
    aside = [replace(view, K=view.K + np.array([[0, 0, 4000.0], [0, 0, 0], [0, 0, 0]])) for view in scene.views]
    with pytest.warns(DrSplatWarning, match="3 objects are in front in no photo and get no mask: object 0"):
        draw_features(tmp_path / "masks", scene, aside)


def test_masks_of_features_are_not_the_same_in_every_photo(voted, embedded, tmp_path, capsys):
    line = embed_line(voted, tmp_path / "few", "--crops", "objects", masks="things")
    assert cli.main([*map(str, line)]) == 1  # after a word of which models were chosen
    assert "crops of objects are of one level" in capsys.readouterr().err


# --- trees ----------------------------------------------------------------------------------------


def test_regions_are_basins_that_share_no_pixel():
    strength = np.zeros((40, 60), np.float32)
    strength[:, 29:31] = 0.8
    labels = basins(strength)
    assert sorted(np.unique(labels)) == [0, 1]
    assert (labels[:, :28] == labels[0, 0]).all()
    assert (labels[:, 32:] == labels[0, -1]).all()


def square_picture() -> np.ndarray:
    picture = np.full((240, 320, 3), 60, np.uint8)
    picture[60:180, 100:220] = (200, 190, 170)
    return np.clip(picture + np.random.default_rng(0).integers(-3, 4, picture.shape), 0, 255).astype(np.uint8)


def test_a_second_tree_merges_where_the_outline_is_weakest():
    picture = square_picture()
    picture[100:140, 20:80] = np.arange(60)[None, :, None] * 3  # an edge that fades
    picture[80:160:8, 120:200] = (180, 60, 40)
    tree, more = (region_tree(picture, both=True, threads=threads) for threads in (1, 2))
    for name, array in vars(tree).items():
        assert_array_equal(array, vars(more)[name])
    count, first = len(tree), region_tree(picture).pairs
    assert_array_equal(tree.pairs[: count - 1], first)
    second = tree.pairs[count - 1 :]
    second = np.where(second < count, second, second - len(first))
    assert len(second) == count - 1
    assert count > 20
    assert second.tolist() != first.tolist()
    borders = {frozenset(pair): np.array(border) for pair, *border in
               zip(tree.touching.tolist(), tree.strengths, tree.lengths, strict=True)}  # fmt: skip
    for union, pair in enumerate(second.tolist(), count):
        means = {ends: strength / length for ends, (strength, length) in borders.items()}
        assert means[frozenset(pair)] <= min(means.values()) + 1e-5  # likelihoods have six digits
        borders.pop(frozenset(pair))
        for ends in [ends for ends in borders if not ends.isdisjoint(pair)]:
            now = ends - {*pair} | {union}
            borders[now] = borders.get(now, 0) + borders.pop(ends)
    assert not borders


def test_a_tree_holds_what_is_outlined():
    picture = square_picture()
    one, two = region_tree(picture, threads=1), region_tree(picture, threads=2)
    for name, array in vars(one).items():
        assert_array_equal(array, vars(two)[name])
    square = np.zeros((240, 320), bool)
    square[60:180, 100:220] = True
    candidates = one.candidates
    masks = candidates.toarray()[:, one.labels] > 0
    fits = (masks & square).sum((1, 2)) / (masks | square).sum((1, 2))
    assert fits.max() > 0.9
    assert one.bounds.outlines[fits.argmax()] > 0.4
    assert one.bounds.framed[fits.argmax()] == 0
