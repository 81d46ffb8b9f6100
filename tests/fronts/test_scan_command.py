"""`drsplat scan` on photos of a made-up room: what it makes, how it goes on, and what it says of bad input."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from command_line import Capture, Line, answer_of, error_of
from drsplat import load_field, open_scene, read_views
from drsplat.cli import main
from drsplat.errors import pip_install
from drsplat.evaluation import demo as household
from drsplat.formats.scan_record import read_scan_record
from drsplat.fronts.commands.scan import _embedding
from drsplat.fronts.commands.stages import check_tables, verb_line
from drsplat.fronts.scanning import choosing
from drsplat.fronts.scanning.display import Display
from drsplat.fronts.scanning.inputs import scan_input
from drsplat.photos.models.loading import DEFAULT_ENCODER
from drsplat.photos.models.sam import CPU_SEGMENTER
from drsplat.scene.views import View
from photographed_room import ROOM, room_views, write_room
from written_captures import write_colmap_text

has_colmap = pytest.mark.skipif(find_spec("pycolmap") is None, reason='needs pip install "drsplat[capture]"')
NUM_PHOTOS = 6
STAGES = ["train", "embed", "register", "objects", "view"]
MODELS = ["--segmenter", "graph", "--encoder", "drsplat-mini"]
QUICK = ["--iterations", "40", "--threads", "1", *MODELS]


@pytest.fixture(scope="module")
def capture_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("given") / "capture"
    views = [view.resized(200, 150) for view in room_views(NUM_PHOTOS)]
    write_room(folder / "images", views)
    images = [
        (k, _quaternion(view), tuple(view.cam_from_world[:3, 3]), 1, view.name) for k, view in enumerate(views, 1)
    ]
    intrinsics = views[0].K
    camera = (1, "PINHOLE", 200, 150, tuple(intrinsics[[0, 1, 0, 1], [0, 1, 2, 2]]))
    write_colmap_text(folder / "sparse/0", plain([camera]), plain(images), _points())
    return folder


def _quaternion(view: View) -> tuple[float, ...]:
    return tuple(Rotation.from_matrix(view.cam_from_world[:3, :3]).as_quat()[[3, 0, 1, 2]])


def plain(rows: list[tuple[object, ...]]) -> list[tuple[object, ...]]:
    """Return rows with NumPy's numbers as Python's, which are written without their type."""
    return [tuple(tuple(map(float, part)) if isinstance(part, tuple) else part for part in row) for row in rows]


def _points(count: int = 500) -> list[tuple[int, tuple[float, ...], tuple[int, int, int]]]:
    """Return points on the walls, so that training need not look for any."""
    rng = np.random.default_rng(0)
    places = rng.uniform(*ROOM, (count, 3))
    for row, axis in enumerate(rng.integers(0, 3, count)):
        places[row, axis] = ROOM[rng.integers(0, 2), axis]
    return [(k, tuple(map(float, place)), (120, 120, 120)) for k, place in enumerate(places, 1)]


@pytest.fixture(scope="module")
def scanned(capture_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole") / "room"
    line = ["scan", str(capture_folder), "-o", str(folder), *QUICK, "--ask", "something red; something blue"]
    assert main([*line, "--json"]) == 0
    return folder


@pytest.fixture
def scan(capture_folder: Path, capsys: Capture) -> Line:
    return Line(capsys, "scan", capture_folder, "-o")


@pytest.fixture
def copy(scanned: Path, tmp_path: Path) -> Path:
    """The scanned folder, to be changed."""
    return Path(shutil.copytree(scanned, tmp_path / "room"))


def results(folder: Path) -> dict[str, bytes]:
    """All files of the scene, the features, the field and the page but for what tells times."""
    files = [folder / "index.html"]
    files += [file for part in ("scene.field", "model/point_cloud", "features") for file in (folder / part).rglob("*")]
    return {str(file.relative_to(folder)): file.read_bytes() for file in files if file.is_file()}


def test_a_scan_of_a_capture_says_what_it_made(copy, scan):
    answer = scan(copy, *QUICK, "--ask", "something red", "--ask", "xyzzy")
    assert (answer["num_photos"], answer["num_registered"], answer["left_out"]) == (NUM_PHOTOS, NUM_PHOTOS, [])
    assert answer["psnr_test"] > 10
    assert answer["num_gaussians"] == load_field(answer["field"]).num_gaussians > 100
    assert answer["num_masks"] > 0
    assert answer["num_objects"] >= 0
    assert list(answer["stage_seconds"]) == list(answer["stage_cpu_seconds"]) == STAGES
    assert [one["query"] for one in answer["answers"]] == ["something red", "xyzzy"]
    assert "not taught 'xyzzy'" in answer["answers"][1]["fault"]
    assert answer["view"] == f"drsplat view {copy}"
    assert Path(answer["page"]).read_text().count("something red") > 0
    assert any("has poses" in note for note in answer["notes"])
    assert any("drsplat-mini" in note and "colours" in note for note in answer["notes"])


def test_verbs_take_the_folder_by_its_name(scanned, capsys):
    assert answer_of(capsys, "objects", scanned)["num_objects"] >= 0
    assert answer_of(capsys, "locate", scanned, "something red")["num_registered"] > 0
    assert answer_of(capsys, "view", scanned, "--export", scanned.parent / "p.html", "--ask", "something red")["bytes"]
    assert len(open_scene(scanned).views) == NUM_PHOTOS


def test_the_page_turns_when_it_is_opened_and_needs_nothing_else(scanned):
    text = (scanned / "index.html").read_text()
    assert '"plays": true' in text
    assert "default-src 'none'" in text


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        ("something red; carrrot", "not taught 'carrrot'. Did you mean 'carrot'?"),
        ("xyzzy on the table", "not taught 'xyzzy'"),
        ("mug behind the sofa", "'behind' is not understood: expected 'X on Y'"),
        ("mug, not", "expected words and their exclusions"),
    ],
)
def test_words_that_no_scene_could_answer_are_refused_before_the_training(ask, said, tmp_path, scan):
    assert said in scan.error(tmp_path / "room", *QUICK, "--ask", ask)
    assert not (tmp_path / "room/model").exists()


def test_nouns_that_photos_do_not_fit_are_doubted_once_and_before_the_training(capture_folder, tmp_path, capsys):
    line = ["scan", str(capture_folder), "-o", str(tmp_path / "room"), *QUICK, "--ask", "teddy; something red"]
    assert main(line) == 0
    shown = capsys.readouterr()
    said = "no answer about 'teddy' will be reliable"
    assert shown.err.index(said) < shown.err.index("1/5 train:")
    assert shown.out.count("made-up rooms") == 1
    assert shown.out.index(said) < shown.out.index("\nteddy: ")
    record = read_scan_record(tmp_path / "room")
    assert "made-up rooms" in record["stages"]["view"]["answer"]["answers"][0]["doubt"]


def test_photos_like_the_rooms_of_the_training_may_be_asked_for_things():
    photos = scan_input(Path(household.__file__).parent / "scene")
    choice = choosing.ModelChoice("graph", "drsplat-mini").judged(photos, 0)
    assert not choice.doubts_nouns
    assert "household words" in choice.sentence(choice.nouns_of(["red vase"]))
    clip = choosing.ModelChoice("graph", "a/clip")
    assert clip.judged(photos, 0) == clip
    assert clip.nouns_of(["xyzzy"]) == ["xyzzy"]


def test_a_finished_scan_is_not_made_again(scanned, scan):
    before = {path: path.stat().st_mtime_ns for path in (scanned / "scene.field").iterdir()}
    text = scan.text(scanned, *QUICK, "--ask", "something red; something blue")
    assert f"Open {scanned / 'index.html'} in a browser" in text
    assert before == {path: path.stat().st_mtime_ns for path in (scanned / "scene.field").iterdir()}


def test_other_queries_make_only_the_page_anew(copy, scan):
    before = results(copy)
    answer = scan(copy, *QUICK, "--ask", "something blue")
    assert [one["query"] for one in answer["answers"]] == ["something blue"]
    after = results(copy)
    assert {name for name in after if after[name] != before[name]} == {"index.html"}


@pytest.mark.slow
def test_other_options_are_refused_and_made_with_overwrite(copy, scan):
    again = scan.plus(copy, "--iterations", "50", "--threads", "1", *MODELS)
    error = again.error()
    assert "iterations was 40, now 50" in error
    assert "--overwrite" in error
    features = (copy / "features/embedding.json").stat().st_mtime_ns
    answer = again("--overwrite")
    assert answer["num_gaussians"] > 0
    assert list((copy / "model/point_cloud").iterdir()) == [copy / "model/point_cloud/iteration_50"]
    record = read_scan_record(copy)
    assert record["stages"]["train"]["options"]["iterations"] == [["50"]]
    assert (copy / "features/embedding.json").stat().st_mtime_ns != features


def test_other_photos_are_refused(copy, capture_folder, tmp_path, capsys):
    other = Path(shutil.copytree(capture_folder, tmp_path / "other"))
    photo = next((other / "images").iterdir())
    photo.write_bytes(photo.read_bytes() + b"\0")
    assert "photos have changed" in error_of(capsys, "scan", other, "-o", copy, *QUICK)


@pytest.mark.slow
def test_a_file_of_options_has_a_table_for_each_verb(tmp_path, scan):
    config = tmp_path / "scan.toml"
    lines = '[scan]\niterations = 30\n[train]\nsh-degree = 1\n[embed]\nsegmenter = "graph"\nencoder = "drsplat-mini"\n'
    config.write_text(lines)
    scan(tmp_path / "room", "--config", config)
    record = read_scan_record(tmp_path / "room")
    assert record["stages"]["train"]["options"]["sh-degree"] == [["1"]]
    assert record["stages"]["train"]["options"]["iterations"] == [["30"]]
    assert record["models"]["segmenter"] == "graph"
    assert (tmp_path / "room/model/point_cloud/iteration_30").is_dir()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[train]\nresolutoin = 3", "train has no option 'resolutoin'; did you mean resolution?"),
        ("[trian]\nresolution = 3", "there is no verb trian; did you mean train?"),
        ("[register]\noutput = 'x.field'", "[register] output is settled by drsplat scan"),
        ("[view]\nviews = 'capture'", "[view] views is settled by drsplat scan"),
        ("[train]\niterations = 'many'", "expected a whole number"),
        ("[embed]\npoints = 16", "leave out --points"),
    ],
)
def test_a_file_of_options_with_a_slip_is_refused_before_any_work(text, said, tmp_path, scan):
    (tmp_path / "scan.toml").write_text(text)
    assert said in scan.error(tmp_path / "room", *MODELS, "--config", tmp_path / "scan.toml")
    assert not (tmp_path / "room/model").exists()


def test_a_file_of_options_may_say_how_many_photos_are_embedded(tmp_path):
    (tmp_path / "scan.toml").write_text("[embed]\nviews = 'all'")
    check_tables(str(tmp_path / "scan.toml"), ["embed", "view"])


def started(line: list[str]) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "drsplat", *line]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


@pytest.mark.slow
def test_a_scan_that_is_killed_in_each_stage_ends_with_the_same_bytes(scanned, capture_folder, tmp_path):
    folder = tmp_path / "room"
    line = ["scan", str(capture_folder), "-o", str(folder), *QUICK, "--ask", "something red; something blue"]
    for verb in STAGES:
        process = started(line)
        while process.poll() is None and f'"{verb}"' not in _record_text(folder):
            time.sleep(0.005)
        process.kill()
        process.communicate()
    assert main([*line, "--json"]) == 0
    assert results(folder) == results(scanned)


def _record_text(folder: Path) -> str:
    record = folder / "scan.json"
    return record.read_text() if record.is_file() else ""


def test_a_scan_that_is_interrupted_says_how_to_go_on(capture_folder, tmp_path):
    process = started(["scan", str(capture_folder), "-o", str(tmp_path / "room"), *MODELS])
    while process.poll() is None and not (tmp_path / "room/model/checkpoint.safetensors").is_file():
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert f"what is done is kept in {tmp_path / 'room'}: give the same command again" in said


@pytest.mark.slow
def test_without_a_name_the_output_is_called_after_the_input(capture_folder, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert answer_of(capsys, "scan", capture_folder, *QUICK)["output"] == "capture-scan"
    assert (tmp_path / "capture-scan/index.html").is_file()


@pytest.mark.slow
@has_colmap
def test_photos_without_poses_end_as_a_page(tmp_path, capsys):
    write_room(tmp_path / "photos", room_views(10))
    (tmp_path / "photos/empty.jpg").touch()
    answer = answer_of(capsys, "scan", tmp_path / "photos", "-o", tmp_path / "room", *QUICK)
    assert (answer["num_photos"], answer["num_registered"]) == (11, 10)
    assert [one["name"] for one in answer["left_out"]] == ["empty.jpg"]
    assert any("1 of 11 photos has no pose" in note for note in answer["notes"])
    assert list(answer["stage_seconds"]) == ["capture", *STAGES]
    assert answer["answers"], "words that find something are asked where none are given"
    assert len(read_views(answer["capture"])) == 10
    (tmp_path / "photos/empty.jpg").unlink()
    error = error_of(capsys, "scan", tmp_path / "photos", "-o", tmp_path / "room", *QUICK)
    assert "photos have changed" in error


@pytest.mark.slow
@has_colmap
def test_photos_that_come_after_a_scan_that_found_no_poses_are_taken(tmp_path, capsys):
    views = room_views(10)
    write_room(tmp_path / "photos", views[:1])
    line = ["scan", tmp_path / "photos", "-o", tmp_path / "room", *QUICK]
    error = answer_of(capsys, *line, code=1)["error"]
    assert "capture: expected at least 3 different photos, got 1 of 1" in error
    write_room(tmp_path / "photos", views[1:])
    assert answer_of(capsys, *line)["num_registered"] == 10


def test_photos_without_colmap_say_what_to_install(tmp_path, monkeypatch, capsys):
    from drsplat.photos.capture import program

    write_room(tmp_path / "photos", room_views(3))
    monkeypatch.setattr(program, "find_spec", lambda name: None)
    assert pip_install("capture") in error_of(capsys, "scan", tmp_path / "photos", "-o", tmp_path / "room")


def test_a_folder_with_other_things_in_it_is_left_alone(capture_folder, tmp_path, scan):
    (tmp_path / "room").mkdir()
    (tmp_path / "room/diary.txt").write_text("mine")
    assert "diary.txt, which drsplat scan did not make" in scan.error(tmp_path / "room")
    assert "is what is scanned" in scan.error(capture_folder)
    assert os.listdir(tmp_path / "room") == ["diary.txt"]


def test_inputs_that_are_none_are_named(tmp_path, capsys):
    assert "expected a folder of photos or a video" in error_of(capsys, "scan", tmp_path / "none", "-o", tmp_path / "r")
    (tmp_path / "empty").mkdir()
    assert "there is no photo in it" in error_of(capsys, "scan", tmp_path / "empty", "-o", tmp_path / "r")
    assert not (tmp_path / "r").exists()


def test_a_damaged_record_is_named(copy, capsys, scan):
    for text in (
        "{",
        "[]",
        '{"format": "drsplat scan", "version": 9}',
        json.dumps({"format": "drsplat scan", "version": 1}),
    ):
        (copy / "scan.json").write_text(text)
        assert "scan.json" in scan.error(copy, *QUICK)
        assert "scan.json" in error_of(capsys, "locate", copy, "something red")


def test_models_are_the_built_in_ones_where_no_others_can_be_had(monkeypatch):
    monkeypatch.setattr(choosing, "models_library", lambda: None)
    monkeypatch.setattr(choosing, "chosen_device", lambda device: "cpu")
    monkeypatch.setattr(choosing, "_why_not", lambda name: "" if "CLIP" in name else "its weights are elsewhere")
    choice = choosing.choose_models("auto", "auto")
    assert (choice.segmenter, choice.encoder) == ("graph", "drsplat-mini")
    assert "its weights are elsewhere" in choice.sentence()
    assert choice.is_built_in
    monkeypatch.setattr(choosing, "_why_not", lambda name: "")
    choice = choosing.choose_models("auto", "auto")
    assert (choice.segmenter, choice.encoder) == (CPU_SEGMENTER, DEFAULT_ENCODER)
    assert "any words can be asked" in choice.sentence()
    assert choosing.choose_models("graph", "auto").segmenter == "graph"


def test_on_a_cpu_sam_is_asked_few_points_of_all_photos(monkeypatch, tmp_path):
    monkeypatch.setattr(choosing, "choose_models", lambda *_: choosing.ModelChoice(CPU_SEGMENTER, DEFAULT_ENCODER))
    scan = verb_line("scan", ["photos", "--output", str(tmp_path)], []).options
    line, choice, _ = _embedding(scan, "capture", tmp_path, None)
    embed = line.options
    asked = embed.with_scene
    assert (embed.cutting.points, asked.views, asked.crops) == ("auto", "all", "masks")
    assert embed.point_settings(choice).levels == ("large",)  # the one that register uses


def test_a_hub_that_cannot_be_reached_is_given_up_soon(monkeypatch):
    monkeypatch.setattr(choosing, "HUB_PATIENCE_S", 0.2)
    assert not choosing._answers("http://127.0.0.1:9/none")
    assert not choosing._answers("no address")


def test_the_time_that_is_left_follows_the_pace_of_the_stages_before():
    display = Display({"train": 100.0, "embed": 50.0, "view": 10.0}, quiet=True)
    with display.stage("train"):
        assert display.seconds_left(30.0) == pytest.approx(90.0, abs=1)
    display.costs["train"] = display.costs["train"]._replace(seconds=200.0)
    with display.stage("embed"):
        assert display.seconds_left(40.0) == pytest.approx(60.0, abs=1)
    with display.stage("view"):
        assert display.seconds_left(0.0) > 0
