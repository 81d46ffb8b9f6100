"""`drsplat add` and `drsplat remove`: the files of a field are those of one registration."""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import drsplat as ds
from command_line import Capture, Line, answer_of, error_of, text_of
from drsplat.formats.langsplat import write_features
from drsplat.formats.poses import write_cameras_json
from drsplat.formats.replacing import sweep
from growing_fields import files_of
from toy_capture import write_toy_capture

PHOTOS = [f"photo_{number}" for number in range(4)]


@pytest.fixture
def room(tmp_path: Path) -> Path:
    return write_toy_capture(tmp_path)


def some_features(room: Path, *stems: str) -> Path:
    """A folder with the features of some photos."""
    folder = room / ("features_" + "".join(stem[-1] for stem in stems))
    folder.mkdir(exist_ok=True)
    for stem in stems:
        for ending in ("_s.npy", "_f.npy"):
            shutil.copy(room / "capture/language_features" / f"{stem}{ending}", folder)
    return folder


@pytest.fixture
def register(room: Path, capsys: Capture) -> Callable[..., Path]:
    def registered(name: str, *stems: str, more: tuple[str, ...] = (), capture: str = "capture") -> Path:
        argv = ["register", room / "scene.ply", room / capture, "--features", some_features(room, *stems)]
        answer_of(capsys, *argv, "--encoder-name", "drsplat-words", "--output", room / name, *more)
        return room / name

    return registered


@pytest.fixture
def features(room: Path) -> Path:
    return room / "capture/language_features"


@pytest.fixture
def add(room: Path, capsys: Capture) -> Line:
    """`drsplat add` of a.field, to be followed by the folder of features."""
    return Line(capsys, "add", room / "a.field", room / "capture", "--scene", room / "scene.ply", "--features")


@pytest.fixture
def remove(room: Path, capsys: Capture) -> Line:
    """`drsplat remove` from a.field, to be followed by the names of views."""
    return Line(capsys, "remove", room / "a.field", "--scene", room / "scene.ply", "--views")


def others_than(one: dict[str, bytes], two: dict[str, bytes]) -> set[str]:
    """Files of other content."""
    assert one.keys() == two.keys()
    return {name for name in one if one[name] != two[name]}


@pytest.mark.slow
@pytest.mark.parametrize("more", [(), ("--code", "pq", "--subvectors", "16"), ("--aggregator", "robust")])
def test_the_files_are_those_of_one_registration(more, room, add, remove, register, features):
    field = register("a.field", *PHOTOS[:2], more=more)
    told = add(features)
    assert (told["added"], told["num_views_unchanged"]) == (["photo_2.png", "photo_3.png"], 2)
    assert (told["num_views"], told["num_masks"]) == (4, 8)
    assert told["stage_seconds"].keys() == {"load", "read", "register", "weights", "code", "save"}
    assert 0 < told["num_touched"] <= told["num_gaussians"] == 300
    assert files_of(field) == files_of(register("b.field", *PHOTOS, more=more))
    told = remove("photo_0", "photo_3.png")
    assert told["removed"] == ["photo_0.png", "photo_3.png"]
    others = others_than(files_of(field), files_of(register("c.field", *PHOTOS[1:3], more=more)))
    assert others == {"field.json"}  # which remembers those two
    assert sorted(path.name for path in room.iterdir() if "parts" in path.name or path.name.startswith(".")) == []


def test_a_field_that_views_were_taken_out_of_has_the_files_of_one_without_them(room, remove, register):
    """Also where other views were left out of the two from the start: `field.json` says so, and nothing else."""
    few = room / "few.txt"
    fields = []
    for name, left_out in (("a.field", ["photo_3"]), ("b.field", ["photo_0", "photo_3"])):
        few.write_text("\n".join(left_out) + "\n")
        fields.append(register(name, *PHOTOS, more=("--without", str(few))))
    remove("photo_0")
    assert others_than(files_of(fields[0]), files_of(fields[1])) == {"field.json"}


def test_what_people_read(add, remove, register, features):
    field = register("a.field", *PHOTOS[:3])
    text = add.text(features)
    assert text.startswith(f"added to {field}")
    for part in ("1 view: photo_3.png", "coded again", "views", "4", "register", "save"):
        assert part in text
    text = add.text(features)
    assert text.startswith(f"nothing to add to {field}")
    assert "--replace" in text
    assert "1 view: photo_3.png" in remove.text("*_3")


@pytest.mark.slow
def test_a_view_that_was_removed_comes_back_when_it_is_named(add, remove, register, features):
    field = register("a.field", *PHOTOS[:3])
    before = files_of(field)
    remove("photo_1")
    told = add(features)
    assert (told["added"], told["left_out"]) == (["photo_3.png"], ["photo_1.png"])
    remove("photo_3")
    text = add.text(features)
    assert "photo_1.png, photo_3.png" in text
    assert "--views NAME... brings them back" in text
    told = add(features, "--views", "photo_1")
    assert (told["added"], told["left_out"], told["num_views"]) == (["photo_1.png"], [], 3)
    assert others_than(files_of(field), before) == {"field.json"}  # which remembers photo_3
    assert "named photo_9" in add.error(features, "--views", "photo_9")
    assert "drop --views" in add.error(features, "--views", "photo_3", "--watch")


def test_a_folder_with_a_field_and_its_scene_needs_no_more(room, capsys, register):
    register("a.field", *PHOTOS[:3])
    (room / "points.ply").unlink()
    told = answer_of(capsys, "add", room, room / "capture", "--features", room / "capture/language_features")
    assert told["added"] == ["photo_3.png"]
    assert "pass --scene SCENE" in error_of(capsys, "remove", room / "a.field", "--views", "photo_3")


def test_features_that_have_become_others_are_taken_over_when_told_to(add, register, features):
    field = register("a.field", *PHOTOS)
    before = files_of(field)
    stored = ds.read_features(features).stored("photo_1")
    write_features(features, "photo_1", np.roll(stored[0], 5, axis=2), stored[1], overwrite=True)
    assert add(features)["replaced"] == []
    assert files_of(field) == before
    told = add(features, "--replace")
    assert (told["added"], told["replaced"], told["num_views_unchanged"]) == ([], ["photo_1.png"], 3)
    assert files_of(field) == files_of(register("b.field", *PHOTOS))
    assert add(features, "--replace")["replaced"] == []


def test_objects_are_found_again_and_names_stay(room, capsys, add, register, features):
    for name, photos in (("a.field", PHOTOS[:3]), ("b.field", PHOTOS)):
        field = register(name, *photos)
        assert answer_of(capsys, "objects", field, "--scene", room / "scene.ply")["num_objects"] == 2
    answer_of(capsys, "objects", room / "a.field", "--label", "my mug", "--id", "0")
    told = add(features)
    assert (told["num_objects"], told["labels_of_none"]) == (2, [])
    assert "objects" in told["stage_seconds"]
    assert files_of(room / "a.field") == files_of(room / "b.field")
    listed = answer_of(capsys, "objects", room / "a.field")["objects"]
    assert "my mug" in [one["label"] for one in listed]


@pytest.mark.parametrize(
    ("views", "said"),
    [
        (["photo_9"], "nothing here is named photo_9: views are named like 'photo_0.png'"),
        (["*"], "these are all 3 views"),
    ],
)
def test_views_that_cannot_go(views, said, remove, register):
    field = register("a.field", *PHOTOS[:3])
    before = files_of(field)
    assert said in remove.error(*views)
    assert files_of(field) == before


def test_bad_input_changes_nothing(room, capsys, add, register, features):
    field = register("a.field", *PHOTOS[:3])
    before = files_of(field)
    other = ds.read_gaussians(room / "scene.ply").subset(np.arange(200))
    ds.write_gaussians(room / "other.ply", other)
    argv = ["add", field, room / "capture", "--features", features, "--scene", room / "other.ply"]
    assert "belongs to a scene of 300 Gaussians" in error_of(capsys, *argv)
    assert "there is no such file or folder" in error_of(capsys, "add", room / "none.field", *add.begin[2:], features)
    made = room / "mini"
    answer_of(capsys, "embed", room / "capture", "--segmenter", "graph", "--encoder", "drsplat-mini", "-o", made)
    assert "was embedded by 'drsplat-mini" in add.error(made)
    assert "no view has features" in add.error(_renamed(room))
    assert "drop --replace" in add.error(features, "--watch", "--replace")
    assert "--idle is for --watch" in add.error(features, "--idle", "3")
    assert files_of(field) == before


def _renamed(room: Path) -> Path:
    folder = some_features(room, "photo_0")
    for file in folder.iterdir():
        file.rename(file.with_name(file.name.replace("photo", "picture")))
    return folder


def test_a_field_of_an_older_version_says_what_to_do(room, capsys, add, register, features):
    field = register("a.field", *PHOTOS[:3])
    old = ds.load_field(field)
    replace(old, growth=None).save(room / "old.field")
    said = error_of(capsys, "add", room / "old.field", *add.begin[2:], features)
    assert "does not say how it was made" in said
    assert "`drsplat register`" in said


KILLED = """
import os, signal
from drsplat.formats import field_folder
from drsplat.field.evidence.aggregation import record
from drsplat.cli import main
def killed(*args, **options):
    os.kill(os.getpid(), signal.SIGKILL)
if {moment!r} == "second view":
    whole, done = record.view_weights, []
    def second(*args, **options):
        done.append(1)
        return killed() if len(done) == 2 else whole(*args, **options)
    record.view_weights = second
else:
    field_folder._exchange = killed
main({argv})
"""


@pytest.mark.slow
@pytest.mark.parametrize("moment", ["second view", "save"])
def test_a_killed_run_loses_nothing_and_goes_on(moment, room, capsys, add, register, features):
    field = register("a.field", *PHOTOS[:2])
    before = files_of(field)
    argv = [*map(str, (*add.begin, features))]
    killed = subprocess.run([sys.executable, "-c", KILLED.format(moment=moment, argv=argv)], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert files_of(field) == before
    parts = sorted((room / "a.field.parts").iterdir())
    assert len(parts) == (1 if moment == "second view" else 2)
    assert len(answer_of(capsys, *argv)["added"]) == 2
    assert files_of(field) == files_of(register("b.field", *PHOTOS))
    assert not (room / "a.field.parts").exists()


KILLED_AFTERWARDS = """
import os, signal
from drsplat.formats import field_folder
from drsplat.cli import main
exchange = field_folder._exchange
def killed(*folders):
    exchange(*folders)
    os.kill(os.getpid(), signal.SIGKILL)
field_folder._exchange = killed
main({argv})
"""


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["add", "remove"])
def test_a_command_that_was_killed_when_it_had_ended_is_given_again(
    verb, room, capsys, add, remove, register, features
):
    field = register("a.field", *PHOTOS[:3])
    entries = sorted(room.iterdir())
    argv = (*remove.begin, "photo_0", "photo_1")
    if verb == "add":
        argv = (*add.begin, features, "--views", "photo_3")
    code = KILLED_AFTERWARDS.format(argv=[*map(str, argv)])
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -signal.SIGKILL
    after = files_of(field)
    assert len([path for path in room.iterdir() if path.name.endswith(".tmp")]) == 1  # the field as it was before
    sweep.cache_clear()  # as in a process of its own
    answer = answer_of(capsys, *argv)
    assert (answer["added"], answer["removed"]) == ([], [])
    assert answer["left_out"] == ([] if verb == "add" else ["photo_0.png", "photo_1.png"])
    assert files_of(field) == after
    assert sorted(room.iterdir()) == entries  # no folder of the killed process, no lock, no parts
    text = text_of(capsys, *argv)
    assert text.startswith("nothing to")
    if verb == "remove":
        assert "were removed before" in text
        assert remove("photo_*[01]")["removed"] == []


FULL = """
import resource, sys
from drsplat.cli import main
sys.dont_write_bytecode = True
resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))
sys.exit(main({argv}))
"""


@pytest.mark.slow
@pytest.mark.parametrize("limit", [300, 12_000])
def test_a_full_disk_is_told_and_changes_nothing(limit, room, capsys, add, register, features):
    """At the first part, and at the field."""
    field = register("a.field", *PHOTOS[:2])
    before = files_of(field)
    argv = [*map(str, (*add.begin, features))]
    ran = subprocess.run(
        [sys.executable, "-c", FULL.format(limit=limit, argv=argv)], capture_output=True, text=True, check=False
    )
    assert ran.returncode == 1
    assert "there is no room left to write it" in ran.stderr
    assert files_of(field) == before
    assert len(answer_of(capsys, *argv)["added"]) == 2


@pytest.mark.slow
def test_a_capture_that_grows_is_followed(room, capsys, monkeypatch, register):
    """Poses come first, then features view by view, file by file."""
    from drsplat.field.growing import watching

    monkeypatch.setattr(watching, "EVERY_S", 0.05)
    views = ds.read_views(room / "capture")
    capture, features = room / "live", room / "live/features"
    shutil.copytree(room / "capture/images", capture / "images")
    features.mkdir()
    write_cameras_json(capture / "cameras.json", views[:1])
    field = register("a.field", *PHOTOS[:1], capture="live")

    def write() -> None:
        for number, stem in enumerate(PHOTOS[1:], 2):
            time.sleep(0.2)
            write_cameras_json(capture / "cameras.json", views[:number], overwrite=True)
            for ending in ("_s.npy", "_f.npy"):
                time.sleep(0.1)
                shutil.copy(room / "capture/language_features" / f"{stem}{ending}", room / "copied")
                (room / "copied").rename(features / f"{stem}{ending}")

    writer = threading.Thread(target=write)
    writer.start()
    argv = ["add", field, capture, "--features", features, "--scene", room / "scene.ply", "--watch", "--idle", "4"]
    told = answer_of(capsys, *argv)
    writer.join()
    assert told["added"] == [f"{stem}.png" for stem in PHOTOS[1:]]
    assert files_of(field) == files_of(register("b.field", *PHOTOS, capture="live"))


def test_a_view_comes_when_its_features_are_whole_and_no_longer_written(room):
    from drsplat.field.growing.watching import Watch

    views, features = ds.read_views(room / "capture"), ds.read_features(some_features(room, "photo_1"))
    watch = Watch(lambda: (views, features))
    file = features.directory / "photo_1_s.npy"
    content = file.read_bytes()
    for size, comes in ((0, 0), (0, 0), (500, 0), (500, 0), (len(content), 0), (len(content), 1)):
        file.write_bytes(content[:size])
        os.utime(file, ns=(size, size))
        batch = watch.arrived()
        assert (len(batch.views) if batch else 0) == comes
    watch.known.add("photo_1.png")
    assert watch.arrived() is None


def test_watching_ends_on_ctrl_c(monkeypatch, add, register, features):
    from drsplat.field.growing import watching

    field = register("a.field", *PHOTOS[:2])
    monkeypatch.setattr(watching, "EVERY_S", 0.01)
    looks: list[int] = []
    whole = watching.Watch.arrived

    def arrived(self: watching.Watch) -> watching.Batch | None:
        looks.append(1)
        if len(looks) == 5:
            raise KeyboardInterrupt
        return whole(self)

    monkeypatch.setattr(watching.Watch, "arrived", arrived)
    told = add(features, "--watch")
    assert told["added"] == ["photo_2.png", "photo_3.png"]
    assert json.loads((field / "field.json").read_text())["growth"]["level"] == "large"


def swapped(room: Path, capsys: Capture, *more: object, code: int = 0) -> tuple[object, ...]:
    """The command that registers the features of another encoder with the weights of a.field."""
    features = room / "other_encoder"
    known = ds.read_features(room / "capture/language_features")
    for number, name in enumerate(known):
        ids, rows = known.stored(name)
        turned = np.roll(rows, number + 1, axis=1)[:, :64]
        write_features(features, name, ids, turned / np.linalg.norm(turned, axis=1, keepdims=True), form="compact")
    return (
        "register",
        room / "scene.ply",
        room / "capture",
        "--features",
        features,
        "--encoder-name",
        "another",
        *more,
    )


def test_another_encoder_takes_the_weights_of_a_field(room, capsys, monkeypatch, register):
    from drsplat.field.evidence.aggregation import record

    field = register("a.field", *PHOTOS, more=("--topk", "7", "--near", "0.3"))
    argv = swapped(room, capsys)
    answer_of(capsys, *argv, "--output", room / "whole.field", "--topk", "7", "--near", "0.3")
    monkeypatch.setattr(record, "view_weights", None)  # no photo is rasterised
    told = answer_of(capsys, *argv, "--output", room / "swapped.field", "--weights-of", field)
    assert (told["num_views_reused"], told["topk"], told["dim"]) == (4, 7, 64)
    assert files_of(room / "swapped.field") == files_of(room / "whole.field")


def test_weights_of_other_masks_are_refused(room, capsys, register):
    field = register("a.field", *PHOTOS)
    argv = (*swapped(room, capsys), "--output", room / "b.field", "--weights-of", field)
    assert "drop --topk and --near" in error_of(capsys, *argv, "--topk", "3", "--near", "0.1")
    features = room / "other_encoder"
    ids, rows = ds.read_features(features).stored("photo_1")
    write_features(features, "photo_1", np.roll(ids, 3, axis=1), rows, overwrite=True, form="compact")
    assert "1 of 4 views have other masks or poses than the field" in error_of(capsys, *argv)
    (features / "photo_1.features.safetensors").unlink()
    assert "1 of it have none here" in error_of(capsys, *argv)
    assert not (room / "b.field").exists()
