"""`drsplat select | locate | segment` on the demo's room, where every Gaussian is known."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from command_line import answer_of, error_of, text_of
from drsplat import Scene, WordEncoder, load_field, read_gaussians
from drsplat.drawing.pictures import class_colors, legend
from drsplat.formats.vocabulary import VocabularyEncoder, write_vocabulary
from drsplat.photos.models.word_list import NOUNS
from drsplat.query.thresholds import share_threshold
from furnished.story import Story, intersection_over_union


@pytest.fixture(scope="module")
def room(story: Story, demo_folder: Path) -> Path:
    return demo_folder


def truth_of(story: Story, *names: str) -> np.ndarray:
    return np.flatnonzero(story.room.members(*names))


def pixels_of(path: Path) -> np.ndarray:
    with Image.open(path) as picture:
        return np.asarray(picture, int)


def test_select_counts_and_saves_columns(room, story, tmp_path, capsys):
    out = tmp_path / "sofa.ply"
    argv = ["select", room / "room.field", "green sofa", "--scene", room / "scene.ply"]
    report = answer_of(capsys, *argv, "--save", out)
    assert (report["threshold"], report["threshold_rule"]) == (WordEncoder.threshold, "encoder")
    assert report["share"] == pytest.approx(report["num_selected"] / len(story.field))
    saved = read_gaussians(out)
    field = load_field(room / "room.field")
    scores = field.scores(WordEncoder().encode_texts(["green sofa"])[0])
    ids = field.gaussian_ids[scores > WordEncoder.threshold]
    assert_array_equal(np.flatnonzero(saved.extra["selected"]), ids)
    assert set(np.unique(saved.extra["selected"])) == {0, 1}
    assert_array_equal(saved.extra["relevancy"], field.dense(scores))
    assert intersection_over_union(ids, truth_of(story, "green sofa")) > 0.9
    printed = text_of(capsys, *argv, "--save", out, "--overwrite")
    assert f"{len(ids):,} of" in printed
    assert "threshold 0.6, that of the encoder" in printed


def test_select_saves_row_numbers_without_a_scene(room, tmp_path, capsys):
    out = tmp_path / "ids.npy"
    report = answer_of(capsys, "select", room / "room.field", "mug", "--save", out)
    ids = np.load(out, allow_pickle=False)
    assert (ids.dtype, len(ids)) == (np.int64, report["num_selected"])
    assert "--overwrite" in error_of(capsys, "select", room / "room.field", "mug", "--save", out)
    assert ".ply or .npy" in error_of(capsys, "select", room / "room.field", "mug", "--save", tmp_path / "ids.txt")
    assert "pass --scene SCENE" in error_of(capsys, "select", room / "room.field", "mug", "--save", tmp_path / "a.ply")


def test_a_share_is_that_of_the_registered(room, story, capsys):
    report = answer_of(capsys, "select", room / "room.field", "mug", "--top-share", "0.02")
    scores = story.field.scores(WordEncoder().encode_texts(["mug"])[0])
    assert report["threshold"] == share_threshold(scores, 0.02)
    assert report["num_selected"] == pytest.approx(0.02 * len(story.field), abs=1)
    assert report["threshold_rule"] == "top share"
    for bad in ("0", "1.5", "half"):
        assert "share" in error_of(capsys, "select", "x", "y", "--top-share", bad, code=2)
    both = ["--top-share", "0.1", "--threshold", "0.5"]
    assert "not allowed with" in error_of(capsys, "select", "x", "y", *both, code=2)


@pytest.mark.parametrize("threshold", [[], ["--threshold", "auto"]])
@pytest.mark.parametrize("text", ["mug", "elephant"])
def test_a_vocabulary_is_contrasted_with_its_other_texts(text, threshold, room, story, tmp_path, capsys):
    """The same embeddings from a file, which says nothing of a threshold."""
    words = WordEncoder()
    vocabulary, out = tmp_path / "words.safetensors", tmp_path / "ids.npy"
    texts = texts_with(text)
    known = VocabularyEncoder(words.identity, texts, words.encode_texts(texts))
    write_vocabulary(vocabulary, known)
    report = answer_of(
        capsys, "select", room / "room.field", text, "--vocabulary", vocabulary, *threshold,
        "--save", out,
    )  # fmt: skip
    assert (report["threshold_rule"], report["measure"]) == ("list", "relevancy")
    found = np.load(out, allow_pickle=False)
    meant = truth_of(story, *(["red mug", "blue mug"] if text == "mug" else []))
    assert intersection_over_union(found, meant) > 0.85
    answer = Scene(story.field, encoder=known).ask(text)
    assert_array_equal(answer.gaussian_ids, found)


def texts_with(text: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys((text, *NOUNS[:60], "wooden table", "white wall", "green sofa")))


def test_clicks_say_what_they_need(room, capsys):
    field, scene = room / "room.field", ["--scene", room / "scene.ply"]
    message = error_of(capsys, "locate", field, "--click", "photo_001:5,5", *scene)
    assert "--views" in message
    for bad in ("photo_001", "photo_001:5", "photo_001:-5,3", ":1,2"):
        message = error_of(capsys, "locate", field, "--click", bad, *scene, "--views", room)
        assert "photo_003:210,140" in message
    outside = [*scene, "--views", room, "--click", "photo_001:320,3"]
    assert "320x240" in error_of(capsys, "locate", field, *outside)
    both = [*scene, "--views", room, "--click", "photo_001:5,5"]
    assert "exactly one of" in error_of(capsys, "locate", field, "mug", *both)


CLASSES = {
    "sofa": "green sofa",
    "cat": "grey cat",
    "wooden table": "wooden table",
    "elephant": None,
    "teddy": "brown teddy",
}


def test_segment_labels_and_colours(room, story, tmp_path, capsys):
    out, picture = tmp_path / "classes.ply", tmp_path / "classes.png"
    scene = ["--scene", room / "scene.ply", "--views", room]
    argv = ["segment", room / "room.field", "--classes", ", ".join(CLASSES), *scene]
    report = answer_of(capsys, *argv, "--save", out, "--picture", picture)
    assert [one["name"] for one in report["classes"]] == list(CLASSES)
    saved = read_gaussians(out)
    labels = saved.extra["class_id"]
    assert report["num_labelled"] == (labels >= 0).sum()
    for number, (one, name) in enumerate(zip(report["classes"], CLASSES.values(), strict=True)):
        found = np.flatnonzero(labels == number)
        assert one["num_gaussians"] == len(found)
        truth = truth_of(story, name) if name else np.empty(0, int)
        assert intersection_over_union(found, truth) > 0.9
    rgb = 0.5 + 0.28209479 * saved.sh[:, 0]
    colors = class_colors(len(CLASSES)) / 255
    assert_allclose(rgb[labels == 1], np.broadcast_to(colors[1], (report["classes"][1]["num_gaussians"], 3)), atol=1e-3)
    assert np.ptp(rgb[labels < 0], axis=1).max() < 1e-3
    assert saved.fingerprint == story.gaussians.fingerprint
    pixels = pixels_of(picture)
    assert pixels.shape[1] == 320
    assert pixels.shape[0] > 240  # the legend
    assert (np.ptp(pixels[:240], axis=-1) > 80).mean() > 0.01
    printed = text_of(capsys, *argv)
    assert "none of these" in printed
    assert "elephant" in printed


def test_segment_with_other_thresholds(room, story, tmp_path, capsys):
    listed = tmp_path / "classes.txt"
    listed.write_text("sofa\n\nelephant\nmug, not red\n", encoding="utf-8")
    argv = ["segment", room / "room.field", "--classes-file", listed]
    every = answer_of(capsys, *argv, "--threshold", "-1")
    assert every["num_labelled"] == pytest.approx(len(story.field), abs=len(story.field) // 20)
    auto = answer_of(capsys, *argv, "--threshold", "auto")
    sofa, elephant, mug = auto["classes"]
    assert (elephant["num_gaussians"], mug["name"]) == (0, "mug, not red")
    assert mug["num_gaussians"] == pytest.approx(len(truth_of(story, "blue mug")), rel=0.15)
    assert sofa["threshold"] == mug["threshold"] == WordEncoder.threshold
    relevant = answer_of(capsys, *argv, "--relevancy", "--threshold", "0.9")
    assert relevant["measure"] == "relevancy"
    assert relevant["num_labelled"] < every["num_labelled"]


def test_segment_refuses_what_is_no_list_of_classes(room, tmp_path, capsys):
    field = room / "room.field"
    (tmp_path / "bad.txt").write_bytes(b"mug\n\xff\xfe")
    (tmp_path / "empty.txt").write_text("\n\n")
    for options, message in (
        ([], "--classes-file"),
        (["--classes", "a", "--classes-file", "b"], "--classes-file"),
        (["--classes", " , "], "one or more different classes"),
        (["--classes", "mug,bowl,mug"], "one or more different classes"),
        (["--classes-file", tmp_path / "none.txt"], "no such file"),
        (["--classes-file", tmp_path / "bad.txt"], "UTF-8"),
        (["--classes-file", tmp_path / "empty.txt"], "got none"),
    ):
        assert message in error_of(capsys, "segment", field, *options)


def test_colours_of_classes_differ():
    colors = class_colors(40).astype(int)
    apart = np.abs(colors[:, None] - colors[None]).sum(-1) + 1000 * np.eye(40, dtype=int)
    assert apart.min() > 15
    assert_array_equal(class_colors(5), class_colors(40)[:5])


def test_a_legend_of_many_names_has_more_rows():
    few, many = (legend(320, [f"class {i}" for i in range(count)], class_colors(count)) for count in (3, 40))
    assert few.shape[1] == many.shape[1] == 320
    assert many.shape[0] > 3 * few.shape[0]
    assert legend(320, [], class_colors(0)).shape[1] == 320
