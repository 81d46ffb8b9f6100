"""Photos that are sent to a scene: kept whole or not at all, and the field is that of one registration."""

import io
import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image
from scipy.spatial.transform import Rotation

from drsplat import MiniEncoder, View, load_field, load_segmenter, read_features, read_gaussians, read_views
from drsplat.errors import InputError
from drsplat.field.growing import remove_views
from drsplat.field.registration import register
from drsplat.formats.compact_features import write_compact
from drsplat.formats.embedding_record import COMPACT
from drsplat.formats.live_views import FullError, LiveView, LiveViews, TakenNameError, posed, read_live_views
from drsplat.formats.moving_scenes import read_scene
from drsplat.formats.replacing import ClaimedError, NoRoom, claimed_output, sweep
from drsplat.formats.tensors import sealed
from drsplat.photos.arriving.adding import GrowingScene, Outcome, add_waiting, refuse_view
from drsplat.photos.arriving.models import ModelNames, ModelShelf, PhotoModels
from drsplat.photos.arriving.taking import SentView, Target, take_view
from drsplat.photos.models.loading import load_encoder
from drsplat.query import open_scene
from drsplat.scene.masks.masks import Masks
from full_disk import files_of_at_most
from growing_fields import Killed, files_of, killed_at
from growing_rooms import FEATURES, posted, registered
from refusing import malformed, refused

NAMES = ModelNames()
LENS = {"fx": 100.0}
STILL = {"cam_from_world": np.eye(4).tolist()}


@pytest.fixture
def room(half_room, tmp_path) -> Path:
    return Path(shutil.copytree(half_room, tmp_path / "room"))


@pytest.fixture
def views(full_room) -> list[View]:
    """Of the whole room; the first two are those of half of it."""
    return read_views(full_room)


def sent(view: View, **changes: Any) -> SentView:
    body = posted(view)
    return replace(SentView(view.name, view.image_path.read_bytes(), body["pose"], body["lens"]), **changes)


def target(room: Path) -> Target:
    scene = open_scene(room)
    return Target(room, scene.field, tuple(view.name for view in scene.views))


def take(room: Path, *views: SentView, **limits: int) -> list[LiveView]:
    return [take_view(target(room), view, NAMES, **limits)[0] for view in views]


def add(room: Path, load: Any = None, names: list[str] | None = None) -> Outcome:
    scene = GrowingScene(room / "room.field", room, read_gaussians(room / "scene.ply"))
    return add_waiting(scene, load or ModelShelf(NAMES, load_encoder).models, names)


def states(room: Path) -> list[str]:
    return [view.state for view in LiveViews(room).every()]


def as_png(image: Image.Image) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, "PNG")
    return buffer.getvalue()


def test_views_that_come_one_by_one_or_together_are_one_registration(room, half_room, full_room, views):
    one, other = views[2:]
    assert [view.state for view in take(room, sent(one))] == ["waiting"]
    assert [view.name for view in add(room).added] == [one.name]
    take(room, sent(other))
    assert [view.name for view in add(room).added] == [other.name]
    assert files_of(room / "room.field") == files_of(full_room / "room.field")
    again = Path(shutil.copytree(half_room, room.parent / "again"))
    take(again, sent(other), sent(one))
    outcome = add(again)
    assert outcome.change.added == (one.name, other.name)
    assert files_of(again / "room.field") == files_of(full_room / "room.field")
    assert load_field(room / "room.field").equals(registered(room, read_views(room), objects=True))


def test_added_views_belong_to_the_capture_and_waiting_ones_do_not(room, views):
    take(room, sent(views[2]))
    assert [view.name for view in read_views(room)] == [view.name for view in views[:2]]
    add(room)
    after = read_views(room)
    assert [view.name for view in after] == [view.name for view in views[:3]]
    assert (after[2].cam_from_world == views[2].cam_from_world).all()
    assert (after[2].K == views[2].K).all()
    assert open_scene(room).view(views[2].name).image_path == room / "live_views/images" / views[2].name
    (room / "cameras.json").unlink()
    assert [view.name for view in read_views(room)] == [views[2].name]


def test_a_camera_file_that_has_the_photos_as_well_counts(room, full_room, views):
    """As after COLMAP has posed all photos anew."""
    take(room, sent(views[2]))
    add(room)
    shutil.copy(full_room / "cameras.json", room)
    shutil.copytree(full_room / "images", room / "images", dirs_exist_ok=True)
    assert {view.image_path for view in read_views(room)} == {room / "images" / f"photo_{n}.png" for n in range(4)}


def test_features_that_are_sent_are_taken_as_they_are(room, full_room, views):
    view = views[2]
    features = sent_features(full_room, room, view)
    take(room, sent(view, features=features))

    def load(*_):
        raise AssertionError("no model is needed")

    add(room, load)
    field = load_field(room / "room.field")
    both = registered(full_room, views[:3], objects=True)
    assert field.equals(both)


def sent_features(full_room: Path, room: Path, view: View, rows: Any = None) -> bytes:
    """The bytes of a photo's features; rows: other embeddings."""
    ids, own = read_features(full_room / FEATURES, encoder=MiniEncoder().identity).stored(view.name)
    path = room.parent / f"sent{COMPACT}"
    write_compact(path, ids, own if rows is None else rows, overwrite=True)
    return path.read_bytes()


def test_a_view_that_cannot_be_added_is_refused_and_the_others_are_added(room, full_room, views):
    one, other = views[2:]
    cut = sent(other).photo[:-400]
    take(room, sent(one), sent(other, photo=cut))
    outcome = add(room)
    assert [view.name for view in outcome.added] == [one.name]
    (bad,) = outcome.refused
    assert bad.name == other.name
    assert "cannot be read" in bad.reason
    live = LiveViews(room)
    assert [(view.name, view.state) for view in live.every()] == [(one.name, "added"), (other.name, "refused")]
    assert not live.photo(bad).exists()
    take(room, sent(other))
    add(room)
    assert files_of(room / "room.field") == files_of(full_room / "room.field")
    assert [view.state for view in live.every()] == ["added", "added"]


class Blind:
    """A segmenter that finds nothing in photos that are bright."""

    identity = load_segmenter("graph").identity

    def segment(self, image: np.ndarray) -> dict[str, Masks]:
        if image.mean() > 200:
            empty = Masks(*image.shape[:2], np.zeros((0, 4), np.int32), (), np.zeros(0, np.float32))
            return {"large": empty}
        return load_segmenter("graph").segment(image)


def test_a_photo_without_a_mask_is_refused(room, views):
    one, other = views[2:]
    white = as_png(Image.new("RGB", (one.width, one.height), "white"))
    take(room, sent(one, photo=white), sent(other))
    with pytest.warns(match="no mask was found"):
        outcome = add(room, lambda *_: PhotoModels(Blind(), MiniEncoder(), 1080), names=[one.name])
    assert [view.reason for view in outcome.refused] == [f"no mask was found in '{one.name}'"]
    outcome = add(room)
    assert [view.name for view in outcome.added] == [other.name]


def test_one_view_that_cannot_be_embedded_or_registered_does_not_hold_up_the_others(room, views):
    one, other = views[2:]

    class Failing(MiniEncoder):
        def encode_images(self, images):
            rows = super().encode_images(images)
            return rows * np.nan if self.fails(images) else rows

        def on_one_thread(self):
            return self

        def fails(self, images):
            return bool(np.concatenate([image.reshape(-1, 3) for image in images])[:, 1].max() > 250)

    green = as_png(Image.fromarray(np.tile(np.uint8([[[0, 255, 0]], [[255, 0, 0]]]), (36, 96, 1))))
    take(room, sent(one, photo=green), sent(other))
    outcome = add(room, lambda *_: PhotoModels(load_segmenter("graph"), Failing(), 1080))
    assert [view.name for view in outcome.added] == [other.name]
    assert [view.name for view in outcome.refused] == [one.name]


def test_a_view_that_was_removed_from_the_field_stays_out(room, views):
    scene, field = read_gaussians(room / "scene.ply"), load_field(room / "room.field")
    remove_views(field, scene, ["photo_1.png"]).field.save(room / "room.field", overwrite=True)
    cameras = json.loads((room / "cameras.json").read_text())
    (room / "cameras.json").write_text(json.dumps(cameras[:1]))
    take(room, sent(views[1]))
    (bad,) = add(room).refused
    assert "stays out" in bad.reason


def test_a_name_is_one_view(room, views):
    view = views[2]
    (first,) = take(room, sent(view))
    assert take(room, sent(view)) == [first]
    for other in (
        sent(view, photo=as_png(Image.new("RGB", (96, 72)))), sent(view, lens={"fx": 90.0}), sent(view, time=1.0),
        sent(view, name="photo_2.jpg"),
    ):  # fmt: skip
        with refused(r"'photo_2\.png' was sent before.*another name", TakenNameError):
            take(room, other)
    with refused(r"'photo_1\.png' is a photo of this scene already", TakenNameError):
        take(room, sent(view, name="photo_1.jpg"))
    add(room)
    (known,) = take(room, sent(view))
    assert (known.state, known.content) == ("added", first.content)
    take(room, sent(view, name="front/photo_2.png"))
    assert [one.name for one in add(room).added] == ["front/photo_2.png"]
    assert [one.name for one in read_views(room)] == ["front/photo_2.png", *(f"photo_{n}.png" for n in range(3))]


def test_only_so_many_wait(room, views):
    one, other = views[2:]
    take(room, sent(one), most_waiting=1)
    with refused("1 views of this scene wait", FullError):
        take(room, sent(other), most_waiting=1)
    take(room, sent(one), most_waiting=1)  # known
    add(room)
    take(room, sent(other), most_waiting=1)


WRONG = [
    ({"name": "../x.jpg"}, "expected a file name"),
    ({"name": "/x.jpg"}, "expected a file name"),
    ({"name": ".x.jpg"}, "expected the name of a photo"),
    ({"name": "x.exe"}, "expected the name of a photo"),
    ({"name": "x\0.jpg"}, "expected a file name"),
    ({"photo": b"GIF89a" + b"\0" * 50}, "picture: expected a JPEG or PNG"),
    ({"photo": b""}, "picture: expected a JPEG or PNG"),
    ({"photo": as_png(Image.new("RGB", (2000, 1000)))}, "at most 1,000,000"),
    ({"pose": {}}, "expected cam_from_world"),
    ({"pose": {**STILL, "quaternion": [1, 0, 0, 0], "translation": [0, 0, 0]}}, "expected cam_from_world"),
    ({"pose": {"quaternion": [1, 0, 0, 0]}}, "expected cam_from_world"),
    ({"pose": {"quaternion": [0, 0, 0, 0], "translation": [0, 0, 0]}}, "expected a rotation quaternion"),
    ({"pose": {"cam_from_world": [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]]}}, "not a rigid motion"),
    ({"pose": {"cam_from_world": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 1, 1]]}}, "the last row 0 0 0 1"),
    ({"pose": {"transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0]]}}, "expected a rotation"),
    ({"lens": {}}, "expected fx"),
    ({"lens": {"fx": -1.0}}, "focal lengths"),
    ({"lens": {"fx": 100.0, "k3": 0.1}}, "expected fx"),
    ({"lens": {"fx": 100.0, "width": 96}}, "expected fx"),
    ({"lens": {"fx": 100.0, "width": 500, "height": 100}}, "another aspect ratio"),
    ({"features": b"no features"}, "features"),
]


@pytest.mark.parametrize(("changes", "said"), WRONG, ids=range(len(WRONG)))
def test_what_cannot_be_a_view_is_refused_at_once(changes, said, room, views):
    with pytest.raises(InputError, match=said) as error:
        take(room, sent(views[2], **changes), most_pixels=1_000_000)
    assert "/tmp" not in str(error.value)
    assert not (room / "live_views").exists()


def test_features_of_another_photo_or_encoder_are_refused(room, full_room, views):
    view = views[2]
    ids, rows = read_features(full_room / FEATURES, encoder=MiniEncoder().identity).stored(view.name)
    path = room.parent / f"sent{COMPACT}"
    for masks, embeddings, said in (
        (ids, rows[:, :8], "dimensions"),
        (ids, rows * 0, "no direction"),
        (ids, rows[:1], "mask"),
        (ids[..., :40], rows, "masks of 40x72 for a photo of 96x72"),
        (ids * 0 - 1, rows, "there is no mask in them"),
    ):
        write_compact(path, masks, np.ascontiguousarray(embeddings), overwrite=True)
        with refused(said):
            take(room, sent(view, features=path.read_bytes()))


def test_forms_of_a_pose_are_one(room, views):
    view = views[2]
    matrix = view.cam_from_world
    x, y, z, w = Rotation.from_matrix(matrix[:3, :3]).as_quat()
    opengl = np.linalg.inv(matrix) @ np.diag([1.0, -1, -1, 1])
    forms = (
        {"cam_from_world": matrix.tolist()},
        {"quaternion": [2 * w, 2 * x, 2 * y, 2 * z], "translation": matrix[:3, 3].tolist()},
        {"transform_matrix": opengl.tolist()},
        {"transform_matrix": opengl[:3].tolist()},
    )
    for form in forms:
        found = posed(entry(form, {"fx": 100.0}), (96, 72))
        assert_allclose(found.cam_from_world, matrix, atol=1e-12)
        assert_array_equal(found.K, [[100, 0, 48], [0, 100, 36], [0, 0, 1]])
    twice = {"fx": 200.0, "fy": 100.0, "cx": 90.0, "cy": 80.0, "width": 192, "height": 144, "k1": 0.1, "p2": 0.01}
    found = posed(entry(forms[0], twice), (96, 72))
    assert_array_equal(found.K, [[100, 0, 45], [0, 50, 40], [0, 0, 1]])
    assert found.distortion == (0.1, 0.0, 0.0, 0.01)


def entry(pose: dict[str, Any], lens: dict[str, Any]) -> LiveView:
    return LiveView("a.jpg", pose, lens, None, False, "", 1.0)


def test_a_scene_that_moves_needs_times(room, views):
    moving = replace(target(room), moves=True)
    view = sent(views[2])
    with refused("this scene moves: expected when"):
        take_view(moving, view, NAMES)
    take_view(moving, replace(view, time=2.0), NAMES)
    assert LiveViews(room).posed(LiveViews(room).every()[0]).time == 2.0


def test_a_view_of_a_scene_that_moves_is_registered_at_its_time(room, full_room, views):
    scene = read_scene(full_room.parent / "frames")
    views = [replace(view, time=float(number)) for number, view in enumerate(views)]
    features = read_features(full_room / FEATURES, encoder=MiniEncoder().identity)
    register(scene, views[:2], features).to_field().save(room / "room.field", overwrite=True)
    at = Target(room, load_field(room / "room.field"), (), moves=True)
    take_view(at, sent(views[2], time=2.0), NAMES)
    take_view(at, sent(views[3], time=7.0), NAMES)  # after its end
    outcome = add_waiting(GrowingScene(room / "room.field", room, scene), ModelShelf(NAMES, load_encoder).models)
    assert [view.name for view in outcome.added] == ["photo_2.png"]
    assert ["7" in view.reason for view in outcome.refused] == [True]
    assert load_field(room / "room.field").equals(register(scene, views[:3], features).to_field())


def test_photos_that_nobody_can_embed_here_are_refused_when_they_come(room, full_room, views):
    view = views[2]
    record = room / FEATURES / "embedding.json"
    shutil.copytree(room / FEATURES, room / "kept")
    record.unlink()
    with refused(r"nothing says which models.*send the masks"):
        take(room, sent(view))
    shutil.rmtree(room / FEATURES)
    with refused(r"no segmenter.*send the masks"):
        take(room, sent(view))
    take(room, sent(view, features=sent_features(full_room, room, view)))
    (known,) = add(room).added
    assert known.name == view.name


def test_a_field_that_cannot_grow_takes_no_photo(room, views):
    at = target(room)
    old = replace(at, field=replace(at.field, growth=None))
    with refused("does not say how it was made"):
        take_view(old, sent(views[2]), NAMES)


def test_models_that_made_other_masks_are_refused_and_views_go_on_waiting(room, views):
    from drsplat.errors import MismatchError

    record = room / FEATURES / "embedding.json"
    document = json.loads(record.read_text())
    document["settings"]["max_height"] = 500
    document["settings"]["algorithm"] = "0"
    record.write_text(json.dumps(sealed(document), indent=1))
    take(room, sent(views[2]))
    with refused(r"otherwise \(algorithm\)", MismatchError):
        add(room)
    assert states(room) == ["waiting"]


def test_another_writer_makes_views_wait(room, views):
    take(room, sent(views[2]))
    with claimed_output(room / "room.field"), refused("is being written by", ClaimedError):
        add(room)
    assert states(room) == ["waiting"]
    assert len(add(room).added) == 1


def killed_anywhere(monkeypatch: pytest.MonkeyPatch, work: Any, renew: Any, steps: Any) -> Iterator[int]:
    """Do work that is killed at one change of the disk after the other, until it is done without; yields the step."""
    for step in steps:
        renew()
        sweep.cache_clear()
        try:
            with killed_at(step, monkeypatch.context):
                work()
        except Killed:
            sweep.cache_clear()
            yield step
            continue
        return
    raise AssertionError("it never ended")


@pytest.mark.slow
def test_a_kill_while_a_view_is_taken_leaves_it_whole_or_not_at_all(half_room, full_room, tmp_path, monkeypatch, views):
    view = views[2]
    room, body, features = tmp_path / "room", sent(view), sent_features(full_room, tmp_path / "x", view)
    body = replace(body, features=features)

    def renew():
        shutil.rmtree(room, ignore_errors=True)
        shutil.copytree(half_room, room)

    at = target(half_room)
    steps = killed_anywhere(
        monkeypatch, lambda: take_view(replace(at, capture=room), body, NAMES), renew, range(100)
    )  # fmt: skip
    count = 0
    for _ in steps:
        count += 1
        for known in LiveViews(room).every():
            assert LiveViews(room).photo(known).read_bytes() == body.photo
            assert (LiveViews(room).features / f"photo_2{COMPACT}").read_bytes() == features
        take(room, body)
        assert [one.state for one in LiveViews(room).every()] == ["waiting"]
    assert count > 10


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # of a journal that was left open
def test_a_kill_while_views_are_added_loses_none(half_room, full_room, tmp_path, monkeypatch, views):
    room, waiting = tmp_path / "room", Path(shutil.copytree(half_room, tmp_path / "waiting"))
    take(waiting, *map(sent, views[2:]))

    def renew():
        shutil.rmtree(room, ignore_errors=True)
        shutil.copytree(waiting, room)

    count = 0
    for step in killed_anywhere(monkeypatch, lambda: add(room), renew, range(0, 500, 3)):
        count += 1
        names = [view.name for view in LiveViews(room).every("waiting", "added")]
        assert set(names) == {"photo_2.png", "photo_3.png"}, step
        load_field(room / "room.field").verify()
        add(room)
        assert files_of(room / "room.field") == files_of(full_room / "room.field"), step
        assert states(room) == ["added", "added"]
        assert not (room / "room.field.parts").exists()
    assert count > 15


@pytest.mark.parametrize("num_bytes", [10, 600])
def test_a_full_disk_is_told_and_nothing_is_kept(num_bytes, room, views):
    """There is room for neither, or for the photo and not for what is said of it."""
    view = sent(views[2], photo=as_png(Image.new("1", (96, 72))))
    at = target(room)
    assert len(view.photo) < 600
    with files_of_at_most(num_bytes), refused("there is no room left", NoRoom):
        take_view(at, view, NAMES)
    assert [path for path in (room / "live_views").rglob("*") if path.is_file()] == []
    take(room, view)


@pytest.mark.slow
@pytest.mark.parametrize("num_bytes", [1000, 30_000])
def test_a_full_disk_while_views_are_added_loses_none(num_bytes, room, full_room, views):
    before = files_of(room / "room.field")
    take(room, *map(sent, views[2:]))
    with files_of_at_most(num_bytes), refused("there is no room left", NoRoom):
        add(room)
    assert files_of(room / "room.field") == before
    assert states(room) == ["waiting", "waiting"]
    add(room)
    assert files_of(room / "room.field") == files_of(full_room / "room.field")


def test_a_view_is_refused_from_outside_only_while_it_waits(room, views):
    one, other = views[2:]
    take(room, sent(one), sent(other))
    refuse_view(room, one.name, "it ends the process")
    refuse_view(room, "nobody.png", "there is none")
    add(room)
    refuse_view(room, other.name, "too late")
    assert [(view.state, view.reason) for view in LiveViews(room).every()] == [
        ("refused", "it ends the process"), ("added", ""),
    ]  # fmt: skip


def test_damaged_entries_are_told(room, views):
    take(room, sent(views[2]))
    add(room)
    path = room / "live_views/added/photo_2.json"
    text = path.read_bytes()
    for damaged in (
        text[:-20],
        text.replace(b"photo_2", b"photo_9"),
        b"[]",
        b"{}",
        b"\xff",
        text.replace(b"w 1", b"x"),
    ):
        path.write_bytes(damaged)
        with malformed(r"photo_2\.json"):
            read_live_views(room)
    document = json.loads(text)
    for wrong in ({"arrived": "noon"}, {"name": "../photo_2.png"}):  # sealed, but by another program
        path.write_text(json.dumps(sealed(document | wrong)))
        with malformed(r"(expected|got).*\. Remove it, and send its photo again"):
            read_live_views(room)
