"""The command line: what it prints where, its exit codes, and that it can be killed."""

import json
import shlex
import shutil
import signal
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from command_line import Capture, Line, answer_of, error_of, text_of
from drsplat import EncoderIdentity, WordEncoder, cli, load_field, read_gaussians, read_views, write_gaussians
from drsplat.base.progress import track
from drsplat.cli import main
from drsplat.evaluation.demo.story import PROBES
from drsplat.field.codes import save_codebook
from drsplat.formats.npy import write_npy
from drsplat.formats.poses import write_cameras_json
from drsplat.fronts.commands.demo import EXAMPLES
from furnished.story import Story
from growing_fields import files_of
from page_files import read_page


@pytest.fixture(scope="module")
def room(story: Story, demo_folder: Path) -> Path:
    """The small demo's files."""
    return demo_folder


@pytest.fixture
def inspect(capsys: Capture) -> Line:
    return Line(capsys, "inspect")


@pytest.fixture
def locate(room: Path, capsys: Capture) -> Line:
    return Line(capsys, "locate", room / "room.field")


def registering(room: Path, output: Path, codebook: Path | None = None) -> list[object]:
    """Arguments; with a codebook none is trained, which takes most of the time."""
    features = room / "language_features"
    given = ["--codebook", codebook] if codebook else []
    return ["register", room / "scene.ply", room, "--features", features, "--output", output, *given]


@pytest.fixture(scope="module")
def codebook(story: Story, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """That of the demo's field."""
    path = tmp_path_factory.mktemp("codebook") / "words.safetensors"
    save_codebook(story.field.codebook, path)
    return path


def pixels_of(path: Path | str) -> np.ndarray:
    with Image.open(path) as picture:
        return np.asarray(picture, int)


def test_help_is_a_word_too(capsys):
    for line in ([], ["locate"]):
        assert text_of(capsys, "help", *line) == text_of(capsys, *line, "--help")


def test_what_is_no_query_is_refused_in_words(story, room, tmp_path):
    """In a process without the tests' checks of types."""
    story.field.save(tmp_path / "room.field")
    asked = f"import drsplat; drsplat.open_scene('room.field', scene={str(room / 'scene.ply')!r}).locate(5)"
    done = subprocess.run([sys.executable, "-c", asked], cwd=tmp_path, capture_output=True, text=True)
    assert "InputError: expected words or a Query, got int" in done.stderr


def test_bad_usage_is_json_too(capsys):
    answer = answer_of(capsys, "register", "scene.ply", code=2)
    assert answer["kind"] == "usage"
    assert "CAPTURE" in answer["error"]


def test_an_error_is_1_a_line_and_json(tmp_path, inspect):
    assert "there is no such" in inspect.error(tmp_path / "nothing")
    answer = inspect(tmp_path / "nothing", code=1)
    assert answer["kind"] == "InputError"
    (tmp_path / "bad.ply").write_bytes(b"ply\nrubbish")
    assert inspect(tmp_path / "bad.ply", code=1)["kind"] == "FormatError"


def test_debug_shows_the_traceback(tmp_path):
    with pytest.raises(ValueError, match="there is no such"):
        main(["inspect", str(tmp_path / "nothing"), "--debug"])


def test_interrupt_is_130(monkeypatch, capsys):
    def interrupted(_: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "_run", interrupted)
    assert main(["demo"]) == 130
    assert capsys.readouterr().err == "drsplat: interrupted\n"


@pytest.mark.parametrize("debug", [[], ["--debug"]])
def test_warnings_of_libraries_are_for_programmers(debug, tmp_path, monkeypatch, capsys):
    """But NumPy's of numbers that went wrong are said, once, in our words."""

    def run(_: object) -> dict[str, object]:
        warnings.warn("use something else", FutureWarning, stacklevel=1)
        return {"infinite": [float(np.float32(value) * np.float32(1e38)) for value in (1e38, 2e38)]}

    monkeypatch.setattr("drsplat.fronts.commands.inspect.run", run)
    monkeypatch.setattr("drsplat.fronts.commands.inspect.show", lambda _: None)
    with warnings.catch_warnings(record=True) as shown:
        warnings.simplefilter("always")
        assert main(["inspect", str(tmp_path), *debug]) == 0
    expected = {FutureWarning, RuntimeWarning} if debug else set()
    assert {warning.category for warning in shown} == expected
    said = capsys.readouterr().err
    assert said.count("drsplat: warning: some numbers became too large") == (0 if debug else 1)


def test_closed_pipe_is_quiet(room):
    """Like `drsplat inspect --json ... | head -c 0`: the reader has gone before anything is written."""
    command = [sys.executable, "-m", "drsplat", "inspect", str(room), "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    process.stdout.close()
    assert process.stderr.read() == ""
    process.stderr.close()
    assert process.wait() == cli.PIPE_CLOSED


def test_a_warning_is_one_line_on_stderr(room, tmp_path, capsys, inspect):
    shutil.copytree(room / "sparse", tmp_path / "sparse")
    (tmp_path / "images").mkdir()
    before = warnings.showwarning
    answer = inspect(tmp_path)
    assert answer["num_photos"] == 0
    inspect.text(tmp_path)
    main(["inspect", str(tmp_path)])
    err = capsys.readouterr().err
    assert err.startswith("drsplat: warning: ")
    assert err.count("\n") == 1
    assert warnings.showwarning is before


def test_inspect_tells_what_things_are(room, story, inspect):
    scene = inspect(room / "scene.ply")
    assert (scene["kind"], scene["num_gaussians"]) == ("scene", len(story.gaussians))
    assert scene["fingerprint"] == story.gaussians.fingerprint
    assert_allclose(scene["lowest"], story.gaussians.means.min(0))
    assert scene["opacity"]["p50"] == pytest.approx(np.median(story.gaussians.opacities), rel=1e-5)
    folder = inspect(room)  # a field, its scene and its photos
    assert (folder["kind"], folder["num_views"], folder["num_photos"]) == ("scene folder", 12, 12)
    assert (folder["field"], folder["scene"]) == (str(room / "room.field"), str(room / "scene.ply"))
    assert (folder["num_registered"], folder["num_gaussians"]) == (len(story.field), len(story.gaussians))
    assert_allclose(folder["views"][0]["K"], story.views[0].K)
    features = inspect(room / "language_features")
    assert (features["kind"], features["dim"]) == ("features", 512)
    assert features["masks_per_level"]["large"] == story.num_masks
    field = inspect(room / "room.field")
    assert (field["kind"], field["num_registered"]) == ("field", len(story.field))
    assert field["encoder"] == WordEncoder.identity.name
    assert sum(field["file_bytes"].values()) > 100 * len(story.field)
    for path in ("scene.ply", "", "language_features", "room.field"):
        assert str(room / path) in inspect.text(room / path).replace("\n", "")


def test_inspect_knows_a_vocabulary_from_cameras(room, tmp_path, inspect):
    words = tmp_path / "words.json"
    words.write_text(json.dumps({"frames": [1, 0, 0], "red mug": [0.0, 1.0, 0.0]}))
    vocabulary = inspect(words)
    assert (vocabulary["kind"], vocabulary["dim"]) == ("vocabulary", 3)
    assert vocabulary["texts"] == ["frames", "red mug"]
    cameras = tmp_path / "some_cameras.json"
    write_cameras_json(cameras, read_views(room))
    assert inspect(cameras)["kind"] == "capture"
    frameless = tmp_path / "transforms.json"
    frameless.write_text("{}")
    assert "frames: expected a list" in inspect.error(frameless)


def test_register_refuses_what_is_no_field_before_it_works(room, tmp_path, capsys):
    (tmp_path / "notes").mkdir()
    argv = registering(room, tmp_path / "notes")
    assert "not ours to replace" in error_of(capsys, *argv, "--overwrite")
    assert not (tmp_path / "notes.parts").exists()


@pytest.mark.slow
def test_register_counts_the_coarse_id_of_residual_codes(room, story, tmp_path, capsys):
    plain, path = story.field.codebook, tmp_path / "residual.safetensors"
    save_codebook(replace(plain, coarse=np.zeros((1, plain.dim), np.float32)), path)
    report = answer_of(capsys, *registering(room, tmp_path / "a.field", path))
    assert report["bytes_per_gaussian"] == report["num_subvectors"] + 2
    assert f"{report['bytes_per_gaussian']} bytes per Gaussian" in text_of(
        capsys, *registering(room, tmp_path / "b.field", path)
    )


def test_register_reports_and_refuses_to_overwrite(room, tmp_path, capsys):
    output = tmp_path / "a.field"
    options = ["--encoder-name", "drsplat-words", "--code", "pq"]
    report = answer_of(capsys, *registering(room, output), *options)
    field = load_field(output)
    assert report["num_gaussians"] == field.num_gaussians
    assert report["num_registered"] == len(field)
    assert report["num_views"] == 12
    assert report["num_masks"] == field.evidence.weights.shape[1]
    assert report["num_weights"] == field.evidence.weights.nnz
    assert report["field_bytes"] == sum(len(content) for content in files_of(output).values())
    assert report["seconds"] == pytest.approx(sum(report["stage_seconds"].values()))
    assert report["peak_memory_bytes"] > 50e6
    assert not (tmp_path / "a.field.parts").exists()
    # the demo's own field, made through the library, is the same to the bit
    assert files_of(output) == files_of(room / "room.field")

    before = files_of(output)
    assert "--overwrite" in error_of(capsys, *registering(room, output), "--topk", "1")
    assert files_of(output) == before
    again = answer_of(capsys, *registering(room, output), "--topk", "1", "--overwrite")
    assert again["num_weights"] < report["num_weights"]
    assert again["encoder"] == "unknown"


@pytest.mark.slow
def test_register_takes_the_smaller_code(room, story, tmp_path, capsys, inspect):
    output, named = tmp_path / "a.field", ("--encoder-name", "drsplat-words")
    report = answer_of(capsys, *registering(room, output), *named)
    assert (report["code"], report["atoms_per_row"], report["bytes_per_gaussian"]) == ("mixture", 4, 14)
    field = load_field(output)
    query = WordEncoder().encode_texts(["red mug"])[0]
    errors = field.scores(query) - story.field.scores(query)
    assert np.sqrt((errors**2).mean()) < 0.01
    listed = inspect(output)
    assert (listed["code"], listed["num_atoms"]) == ("mixture", report["num_atoms"])
    finer = answer_of(capsys, *registering(room, output), *named, "--atoms", "8", "--overwrite")
    assert finer["bytes_per_gaussian"] == 26
    for wrong in (["--subvectors", "32"], ["--code", "pq"]):
        argv = [*registering(room, output), "--atoms", "4", *wrong, "--overwrite"]
        assert "drop one of them" in error_of(capsys, *argv)


@pytest.mark.slow
def test_register_takes_the_names_that_others_use(room, tmp_path, capsys):
    options = ["--feature-level", "3", "--topk", "all", "--subvectors", "32", "--max-side", "160"]
    report = answer_of(capsys, *registering(room, tmp_path / "b.field"), *options, "--threads", "1")
    assert (report["topk"], report["num_subvectors"]) == (None, 32)
    assert "a whole number from 1" in error_of(capsys, *registering(room, tmp_path / "c.field"), "-k", "0", code=2)
    assert "level" in error_of(capsys, *registering(room, tmp_path / "c.field"), "--level", "tiny")


KILLED_AFTER = """
import os, signal
from drsplat.field.evidence.aggregation import record
from drsplat.cli import main
whole, done = record.view_weights, []
def weights(*args, **options):
    if len(done) == {count}:
        os.kill(os.getpid(), signal.SIGKILL)
    done.append(1)
    return whole(*args, **options)
record.view_weights = weights
main({argv})
"""


def test_a_killed_registration_goes_on_to_the_same_field(room, codebook, tmp_path, capsys):
    output = tmp_path / "killed.field"
    argv = [*map(str, registering(room, output, codebook))]
    killed = subprocess.run([sys.executable, "-c", KILLED_AFTER.format(count=5, argv=argv)], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert not output.exists()
    parts = tmp_path / "killed.field.parts"
    assert len(list(parts.glob("*.safetensors"))) == 5
    report = answer_of(capsys, *argv)
    assert (report["num_views"], report["num_views_reused"]) == (12, 5)
    answer_of(capsys, *registering(room, tmp_path / "whole.field", codebook))
    assert files_of(output) == files_of(tmp_path / "whole.field")
    assert not parts.exists()


@pytest.mark.slow
@pytest.mark.parametrize("kept", [12, 3], ids=["none is removed", "some are"])
def test_a_registration_killed_while_its_parts_are_removed_is_complete(kept, room, codebook, tmp_path, capsys):
    output, parts = tmp_path / "killed.field", tmp_path / "killed.field.parts"
    argv = registering(room, output, codebook)
    assert not answer_of(capsys, *argv, "--parts", parts)["was_complete"]
    for part in sorted(parts.iterdir())[kept:]:
        part.unlink()
    before = files_of(output)
    assert "exists already" in error_of(capsys, *argv, "--topk", "2")
    assert parts.exists()
    assert "it was complete already" in text_of(capsys, *argv)
    assert files_of(output) == before
    assert not parts.exists()
    assert "exists already" in error_of(capsys, *argv)


@pytest.mark.slow
def test_parts_of_other_settings_are_not_used(room, codebook, tmp_path, capsys):
    parts = ["--parts", tmp_path / "parts", "--overwrite"]
    argv = [*registering(room, tmp_path / "a.field", codebook), *parts]
    assert answer_of(capsys, *argv, "--topk", "2")["num_views_reused"] == 0
    assert answer_of(capsys, *argv)["num_views_reused"] == 0
    answer_of(capsys, *registering(room, tmp_path / "whole.field", codebook))
    assert files_of(tmp_path / "a.field") == files_of(tmp_path / "whole.field")
    assert answer_of(capsys, *argv)["num_views_reused"] == 12


def test_query_in_words(room, story, locate):
    scene = ["--scene", room / "scene.ply"]
    answer = locate("blue cup", *scene)
    assert (answer["num_matches"], answer["measure"]) == (1, "cosine")
    assert answer["threshold"] == WordEncoder.threshold
    truth = story.gaussians.means[story.room.members("blue mug")]
    thing = answer["matches"][0]
    assert_allclose(thing["center"], (truth.min(0) + truth.max(0)) / 2, atol=0.03)
    assert thing["support"][0]["view"].startswith("photo_")
    assert 0 < thing["support"][0]["share"] <= 1
    assert answer["score_range"][0] < answer["score_p99"] <= answer["score_range"][1] <= 1
    out = locate.text("blue cup", *scene)
    assert "1 match of 'blue cup'" in out
    assert "threshold 0.6" in out


def test_query_that_finds_nothing_says_so(room, locate):
    scene = ("--scene", room / "scene.ply")
    answer = locate("elephant", *scene)
    assert (answer["num_matches"], answer["matches"], answer["num_selected"]) == (0, [], 0)
    assert answer["instead"]
    text = locate.text("elephant", *scene)
    assert text.startswith("No match for 'elephant'. The best place has a cosine of ")
    assert f"below the threshold of 0.60. Words that match here: {', '.join(answer['instead'])}." in text
    for word in answer["instead"]:
        assert locate(word, *scene)["instead"] == []


def test_query_by_relevancy(room, tmp_path, locate):
    field = load_field(room / "room.field")
    encoder = WordEncoder()
    negatives = encoder.encode_texts(["object", "things", "stuff", "texture"])
    expected = field.relevancy(encoder.encode_texts(["ball"])[0], negatives)
    answer = locate("ball", "--relevancy")
    assert (answer["measure"], answer["threshold"]) == ("relevancy", 0.5)
    assert_allclose(answer["score_range"], [expected.min(), expected.max()], rtol=1e-6)
    assert answer["num_selected"] == (expected > 0.5).sum()
    write_npy(tmp_path / "n.npy", negatives)
    same = locate("ball", "--negatives", tmp_path / "n.npy")
    assert same["score_range"] == answer["score_range"]
    other = locate("ball", "--negatives", "orange, floor")
    assert other["score_range"][1] < answer["score_range"][1]


def test_query_needs_the_right_encoder(room, story, tmp_path, capsys, locate):
    output, codebook = tmp_path / "clip.field", tmp_path / "clip.safetensors"
    encoder = EncoderIdentity("ViT-B-16/any", 512)
    save_codebook(replace(story.field.codebook, encoder=encoder), codebook)
    assert answer_of(capsys, *registering(room, output, codebook))["encoder"] == encoder.name
    wrong = [*registering(room, tmp_path / "x.field", codebook), "--encoder-name", "drsplat-words"]
    assert "codebook" in error_of(capsys, *wrong)
    message = error_of(capsys, "locate", output, "red mug")
    assert "ViT-B-16/any" in message
    assert "--vocabulary FILE" in message
    texts = ["red mug", "object", "things", "stuff", "texture"]
    vectors = WordEncoder().encode_texts(texts)
    vocabulary = tmp_path / "texts.json"
    vocabulary.write_text(json.dumps(dict(zip(texts, vectors.tolist(), strict=True))))
    argv = ["locate", output, "red mug", "--vocabulary", vocabulary]
    answer = answer_of(capsys, *argv)
    assert (answer["threshold_rule"], answer["measure"]) == ("list", "relevancy")
    alone = locate("red mug")
    assert answer["num_selected"] >= alone["num_selected"] > 0
    assert answer_of(capsys, *argv, "--relevancy")["num_selected"] > 0
    assert main(["locate", str(output), "blue mug", "--vocabulary", str(vocabulary)]) == 1
    warned, refused = capsys.readouterr().err.strip().splitlines()
    assert "5 texts" in warned
    assert "blue mug" in refused
    short = tmp_path / "short.json"
    short.write_text('{"red mug": [1.0, 0.0]}')
    message = error_of(capsys, "locate", output, "red mug", "--vocabulary", short)
    assert "its vectors have 2 numbers, those of this field 512" in message


def test_query_refuses_before_it_works(room, tmp_path, capsys, locate):
    scene = room / "scene.ply"
    assert "--vector" in locate.error()
    assert "--scene" in locate.error("mug", "--save", tmp_path / "x.ply")
    assert "--views" in locate.error("mug", "--scene", scene, "--picture", tmp_path / "x.png")
    assert "--overwrite" in locate.error("mug", "--scene", scene, "--save", scene)
    nowhere = tmp_path / "nowhere" / "x.ply"
    message = error_of(capsys, "locate", tmp_path / "no.field", "mug", "--scene", scene, "--save", nowhere)
    assert "there is no folder" in message  # said before the field is looked for
    write_npy(tmp_path / "short.npy", np.ones(3, np.float32))
    assert "512" in locate.error("--vector", tmp_path / "short.npy")
    for number in (1e300, np.inf, np.uint64(0x7FF0000000000001).view(np.float64)):
        np.save(tmp_path / "odd.npy", np.append(np.ones(511), number))
        message = locate.error("--vector", tmp_path / "odd.npy")
        assert "must be finite and not zero" in message  # without NumPy's own warnings
    other = tmp_path / "other.ply"
    write_gaussians(other, read_gaussians(scene).subset(np.arange(100)))
    answer = locate("mug", "--scene", other, code=1)
    assert answer["kind"] == "MismatchError"


def test_query_writes_columns_and_a_picture(room, story, tmp_path, locate):
    out, picture = tmp_path / "mugs.ply", tmp_path / "mugs.png"
    answer = locate("mug", "--scene", room / "scene.ply", "--save", out,
        "--picture", picture, "--views", room,
    )  # fmt: skip
    saved = read_gaussians(out)
    assert saved.fingerprint == story.gaussians.fingerprint
    field = load_field(room / "room.field")
    scores = field.dense(field.scores(WordEncoder().encode_texts(["mug"])[0]))
    assert_array_equal(saved.extra["relevancy"], scores)
    sizes = [(saved.extra["match_id"] == number).sum() for number in range(2)]
    assert sizes == [thing["num_gaussians"] for thing in answer["matches"]]
    assert set(np.unique(saved.extra["match_id"])) == {-1, 0, 1}
    assert answer["view"] in {view.name for view in story.views}
    pixels = pixels_of(picture)
    assert pixels.shape[1] == 320
    assert (np.ptp(pixels, axis=-1) > 60).sum() > 50  # something is in colour


def test_render_one_and_all(room, story, tmp_path, capsys):
    base = ["render", room / "scene.ply", "--views", room, "--output-dir", tmp_path / "out"]
    one = answer_of(capsys, *base, "--view", "photo_003", "--depth", "--alpha", "--background", "grey")
    assert [Path(file).name for file in one["files"]] == ["photo_003.png", "photo_003.alpha.png", "photo_003.depth.npy"]
    assert pixels_of(one["files"][0]).shape[:2] == (240, 320)
    depth = np.load(one["files"][2], allow_pickle=False)
    assert depth.shape == (240, 320)
    assert 0.2 < np.median(depth) < 8
    assert "--overwrite" in error_of(capsys, *base, "--view", "photo_003")
    every = answer_of(capsys, *base, "--all", "--overwrite", "--max-side", "80")
    assert (every["num_views"], len(every["files"])) == (12, 12)
    assert pixels_of(every["files"][0]).shape[:2] == (60, 80)
    assert "photo_000.jpg" in error_of(capsys, *base, "--view", "nowhere")


def test_render_keeps_in_colour_what_a_query_finds(room, tmp_path, capsys):
    argv = ["render", room / "scene.ply", "--views", room, "--view", "photo_004", "--output-dir", tmp_path]
    report = answer_of(capsys, *argv, "--field", room / "room.field", "--query", "green sofa")
    pixels = pixels_of(report["files"][0])
    coloured = np.ptp(pixels, axis=-1) > 30
    assert 0.01 < coloured.mean() < 0.4
    assert report["num_selected"] > 100
    absent = text_of(capsys, *argv, "--field", room / "room.field", "--query", "elephant", "--overwrite")
    assert "No match to highlight" in absent


def test_demo_verb_tells_its_story(household_story, tmp_path, capsys, monkeypatch):
    """The story, its pictures and its page are tested elsewhere; here, what is printed of them."""
    count = len(PROBES)
    pictures = [tmp_path / "overview.png", *(tmp_path / f"{k}.png" for k in range(count))]
    monkeypatch.setattr("drsplat.evaluation.demo.story.tell", lambda *_args, **_options: household_story)
    monkeypatch.setattr("drsplat.evaluation.demo.story.write_album", lambda *_args, **_options: pictures)
    monkeypatch.setattr("drsplat.fronts.viewing.exporting.export_page", lambda *_args, **_options: None)
    answer = answer_of(capsys, "demo", "--output-dir", tmp_path)
    assert [query["text"] for query in answer["queries"]] == [q.text for q in PROBES]
    wanted = {"text", "num_matches", "is_right", "iou", "num_selected", "center", "seconds"}
    assert all(wanted <= query.keys() for query in answer["queries"])
    last = answer["queries"][-1]
    assert (last["num_matches"], last["iou"], last["center"]) == (0, None, None)
    assert answer["num_right"] == sum(a.is_right for a in household_story.verdicts)
    assert (answer["overview"], answer["page"]) == (str(pictures[0]), str(tmp_path / "index.html"))
    printed = text_of(capsys, "demo", "--output-dir", tmp_path, "--overwrite")
    assert "made-up room" in " ".join(printed.split())
    assert printed.count("MISS") == count - answer["num_right"]


def test_the_demo_makes_a_page_that_answers_and_names_commands_that_run_without_extras(
    household_story, household_folder, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr("drsplat.evaluation.demo.story.tell", lambda *_args, **_options: household_story)
    monkeypatch.setattr("drsplat.evaluation.demo.story.write_album", lambda *_args, **_options: [tmp_path] * 17)
    for extra in ("fastapi", "uvicorn", "prometheus_client", "usd", "mcp", "msgspec"):
        monkeypatch.setitem(sys.modules, extra, None)
    printed = text_of(capsys, "demo", "--output-dir", tmp_path)
    header, _ = read_page(tmp_path / "index.html")
    assert [answer["text"] for answer in header["answers"]] == [probe.text for probe in PROBES]
    assert header["search"]["lists"]["all"]["texts"]
    lines = [line for line in (*printed.splitlines(), *EXAMPLES.splitlines()) if line.startswith("  drsplat ")]
    told = [line.split(" (afterwards")[0] for line in lines if not line.startswith("  drsplat demo")]
    monkeypatch.chdir(tmp_path)
    assert len(told) == 5
    for number, line in enumerate(dict.fromkeys(told)):
        command = [household_folder if part in (str(tmp_path), "drsplat-demo") else part for part in shlex.split(line)]
        for place in tmp_path.iterdir():
            place.unlink()
        assert text_of(capsys, *command[1:]), (number, line)


def test_progress_shows_after_a_while(capsys, monkeypatch):
    from drsplat.base import progress

    monkeypatch.setattr(progress, "PATIENCE_S", -1.0)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("TERM", "xterm")
    assert list(track([1, 2, 3], "counting")) == [1, 2, 3]
    out, err = capsys.readouterr()
    assert out == ""
    assert "counting" in err
    assert list(track([1, 2, 3], "counting", quiet=True)) == [1, 2, 3]
    assert capsys.readouterr().err == ""
