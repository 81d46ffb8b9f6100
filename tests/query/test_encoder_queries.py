"""`drsplat query --encoder`: fields whose masks a tiny CLIP embedded, asked in words and by image."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image

from drsplat import Answer, Query, Scene
from drsplat.cli import main
from drsplat.errors import MismatchError
from drsplat.field import LanguageField, build_field
from drsplat.fronts.commands.query_options import read_picture
from drsplat.photos.models.loading import load_encoder
from drsplat.photos.models.word_list import list_vectors
from drsplat.query.contrast import contrast
from drsplat.query.encoding import encoder_for
from drsplat.scene.encoders import EncoderIdentity
from fields import SCENE, random_evidence
from refusing import malformed, refused
from tiny_encoders import write_model

torch = pytest.importorskip("torch", reason="needs torch")
pytest.importorskip("transformers", reason="needs transformers")
torch.set_num_threads(1)

THING = np.random.default_rng(3).integers(1, 256, (12, 20, 3), np.uint8)


@pytest.fixture(scope="module")
def clip(tmp_path_factory) -> Path:
    return write_model(tmp_path_factory.mktemp("models") / "tiny-clip", "clip")


@pytest.fixture(scope="module")
def dinov2(tmp_path_factory) -> Path:
    return write_model(tmp_path_factory.mktemp("models") / "tiny-dinov2", "dinov2")


def field_of(identity: EncoderIdentity) -> LanguageField:
    evidence = random_evidence(np.random.default_rng(0), dim=identity.dim)
    return build_field(evidence, SCENE, identity)


def asked(field: LanguageField, query: Query, encoder: Path | str | None = None) -> Answer:
    return Scene(field, encoder=lambda: encoder_for(field, encoder=encoder and str(encoder))).ask(query)


@pytest.fixture(scope="module")
def field(clip) -> LanguageField:
    return field_of(load_encoder(str(clip), "cpu").identity)


@pytest.mark.slow
def test_words_through_the_encoder_of_the_field(clip, field):
    encoder = load_encoder(str(clip), "cpu")
    expected = encoder.encode_texts(["a red mug"])[0]
    answer = asked(field, Query("a red mug"), clip)
    assert (answer.measure, answer.rule) == ("relevancy", "list")
    assert_allclose(answer.vector, expected, atol=1e-6)
    listed = contrast(field, list_vectors(encoder)).relevancy(expected, answer.scores)
    assert listed is not None
    assert_allclose(answer.values, listed, atol=1e-3)


def test_lerfs_relevancy_is_measured_when_asked_for(clip, field):
    encoder = load_encoder(str(clip), "cpu")
    answer = asked(field, Query("a red mug", relevancy=True), clip)
    assert (answer.measure, answer.threshold, answer.rule) == ("relevancy", 0.5, "default")
    query, *negatives = encoder.encode_texts(["a red mug", "object", "things", "stuff", "texture"])
    assert_allclose(answer.values, field.relevancy(query, np.stack(negatives)), atol=1e-4)


def test_an_image_is_padded_to_a_square_as_masks_are(clip, field, tmp_path):
    Image.fromarray(THING).save(tmp_path / "thing.png")
    square = np.zeros((20, 20, 3), np.uint8)
    square[4:16] = THING
    encoder = load_encoder(str(clip), "cpu")
    answer = asked(field, Query(image=read_picture(str(tmp_path / "thing.png"))), clip)
    assert_allclose(answer.vector, encoder.encode_images([square])[0], atol=1e-6)


@pytest.mark.slow
def test_on_the_command_line(clip, field, tmp_path, capsys):
    field.save(tmp_path / "a.field")
    Image.fromarray(THING).save(tmp_path / "thing.png")
    given, shown = ["locate", str(tmp_path / "a.field")], ["--image", str(tmp_path / "thing.png")]
    options = ["--encoder", str(clip), "--device", "cpu", "--json"]
    assert main([*given, "red mug", *options]) == 0
    assert json.loads(capsys.readouterr().out)["query"] == "red mug"
    assert main([*given, *shown, *options]) == 0
    assert json.loads(capsys.readouterr().out)["query"].endswith("thing.png")
    assert main([*given, "red mug", *shown, *options]) == 1
    assert "exactly one of" in json.loads(capsys.readouterr().out)["error"]
    assert main([*given, "red mug", "--vocabulary", "x.json", *options]) == 1
    assert "drop one" in json.loads(capsys.readouterr().out)["error"]


def test_another_encoder_is_refused_and_both_are_named(clip, field):
    for other in (
        replace(field.encoder, weights="0" * 32),
        EncoderIdentity("ViT-B-16/laion2b_s34b_b88k", 8),
        replace(field.encoder, preprocessing="224 px"),
    ):
        with pytest.raises(MismatchError, match="tiny-clip") as caught:
            asked(field_of(other), Query("mug"), clip)
        assert other.name in str(caught.value)
    with pytest.raises(MismatchError, match="drsplat-words"):
        asked(field, Query("mug"), "drsplat-words")


@pytest.mark.slow
def test_a_field_that_does_not_know_its_encoder_takes_one_that_fits(clip):
    for dim in (8, 16):
        field = field_of(EncoderIdentity("unknown", dim))
        if dim == 8:
            assert asked(field, Query("mug"), clip).measure == "relevancy"
            continue
        with pytest.raises(MismatchError, match="tiny-clip"):
            asked(field, Query("mug"), clip)


def test_without_an_encoder_the_message_says_how(field):
    with refused(r"tiny-clip.*encoder=NAME.*\{text: \[numbers\]\}"):
        asked(field, Query("mug"))


def test_self_referencing_queries(dinov2, tmp_path):
    field = field_of(load_encoder(str(dinov2), "cpu").identity)
    Image.fromarray(THING).save(tmp_path / "thing.png")
    picture = read_picture(str(tmp_path / "thing.png"))
    assert len(asked(field, Query(image=picture), dinov2).values) == len(field)
    with refused("self-referencing"):
        asked(field, Query("mug"), dinov2)
    with refused("self-referencing"):
        asked(field, Query(image=picture, relevancy=True), dinov2)


def test_the_words_encoder_sees_no_images(tmp_path):
    from drsplat.photos.models.words import WordEncoder

    Image.fromarray(THING).save(tmp_path / "thing.png")
    with refused("drsplat-words sees no images"):
        asked(field_of(WordEncoder.identity), Query(image=read_picture(str(tmp_path / "thing.png"))))


def test_pictures(tmp_path):
    alpha = np.full((12, 20, 1), 255, np.uint8)
    alpha[:, :5] = 0
    Image.fromarray(np.concatenate([THING, alpha], 2)).save(tmp_path / "cut.png")
    expected = THING.copy()
    expected[:, :5] = 0
    np.testing.assert_array_equal(read_picture(str(tmp_path / "cut.png")), expected)
    exif = Image.Exif()
    exif[0x0112] = 6  # lies on its side
    Image.fromarray(THING).save(tmp_path / "turned.png", exif=exif)
    np.testing.assert_array_equal(read_picture(str(tmp_path / "turned.png")), np.rot90(THING, -1))
    with refused("no such picture"):
        read_picture(str(tmp_path / "absent.png"))
    (tmp_path / "bad.png").write_bytes((tmp_path / "cut.png").read_bytes()[:60])
    with malformed("cannot be read as a picture"):
        read_picture(str(tmp_path / "bad.png"))
