"""LangSplat's feature files and vocabularies."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal

from drsplat.errors import MismatchError
from drsplat.formats.langsplat import LEVELS, FeatureFolder, read_features, write_features
from drsplat.formats.npy import map_npy, write_npy
from drsplat.formats.vocabulary import VocabularyEncoder, read_vocabulary, write_vocabulary
from drsplat.scene.encoders import EncoderIdentity
from refusing import malformed, refused

RNG = np.random.default_rng(0)
ROWS = RNG.normal(size=(11, 8)).astype(np.float32)
ROWS /= np.linalg.norm(ROWS, axis=1, keepdims=True)
MAPS = np.stack(
    [[[-1, 0, 0], [2, 2, -1]], [[3, 3, 3], [4, 5, 3]], [[6, -1, 6], [-1, 8, 8]], [[9, 9, 10], [9, -1, 10]]]
).astype(np.int32)


@pytest.fixture
def folder(tmp_path):
    write_features(tmp_path, "a", MAPS, ROWS)
    write_features(tmp_path, "cam0/b", MAPS[:, ::-1].copy(), ROWS)
    return tmp_path


def raw(folder, maps=MAPS, rows=ROWS) -> FeatureFolder:
    """Written by NumPy alone; not read_features, whose checked return type would read a photo."""
    np.save(folder / "a_s.npy", maps)
    np.save(folder / "a_f.npy", rows)
    return FeatureFolder(folder, LEVELS.index("large"))


# Levels and ids


@pytest.mark.parametrize("level", range(4))
def test_each_level_by_name_and_number(folder, level):
    for name in (level, LEVELS[level]):
        features = read_features(folder, name)["a"]
        used = np.unique(MAPS[level][MAPS[level] >= 0])
        assert_array_equal(features.file_rows, used)
        assert_allclose(features.embeddings, ROWS[used], atol=1e-7)
        background = features.mask_ids < 0
        assert_array_equal(background, MAPS[level] < 0)
        original = features.file_rows[features.mask_ids[~background]]
        assert_array_equal(original, MAPS[level][~background])


def test_large_is_the_default(folder):
    assert_array_equal(read_features(folder)["a"].file_rows, [9, 10])


@pytest.mark.parametrize("level", ["Large", "xl", -1, 4])
def test_other_levels_do_not_exist(folder, level):
    with refused("default, small, medium, large"):
        read_features(folder, level)


@pytest.mark.parametrize("dtype", [np.float32, np.float16, np.float64, np.int64, np.int16, np.int8])
@pytest.mark.parametrize("precision", [np.float16, np.float32, np.float64])
def test_types_of_files(tmp_path, dtype, precision):
    features = raw(tmp_path, MAPS.astype(dtype), ROWS.astype(precision))["a"]
    assert (features.mask_ids.dtype, features.embeddings.dtype) == (np.int32, np.float32)
    assert_array_equal(features.mask_ids, [[0, 0, 1], [0, -1, 1]])
    assert_allclose(features.embeddings, ROWS[9:], atol=1e-3)
    assert_allclose(np.linalg.norm(features.embeddings, axis=1), 1, atol=1e-6)


def test_byte_order_and_memory_order(tmp_path):
    maps, rows = np.asfortranarray(MAPS.astype(">i4")), np.asfortranarray(ROWS.astype(">f4"))
    features = raw(tmp_path, maps, rows)["a"]
    assert_array_equal(features.mask_ids, [[0, 0, 1], [0, -1, 1]])
    assert_allclose(features.embeddings, ROWS[9:], atol=1e-7)


def test_one_map_without_levels_serves_any_level(tmp_path):
    write_features(tmp_path, "a", MAPS[1], ROWS)
    for level in LEVELS:
        assert_array_equal(read_features(tmp_path, level)["a"].file_rows, [3, 4, 5])


def test_rows_are_brought_to_unit_length(tmp_path):
    features = raw(tmp_path, rows=ROWS * RNG.uniform(0.1, 9, (11, 1)).astype(np.float32))["a"]
    assert_allclose(features.embeddings, ROWS[9:], atol=1e-6)


def test_a_photo_without_masks(tmp_path):
    features = raw(tmp_path, np.full((4, 2, 3), -1), np.zeros((0, 8), np.float32))["a"]
    assert features.embeddings.shape == (0, 8)
    assert (features.mask_ids == -1).all()


@settings(derandomize=True)
@given(arrays(np.int32, (4, 3, 5), elements=st.integers(-1, 10)), st.integers(0, 3))
def test_round_trip(tmp_path_factory, maps, level):
    folder = tmp_path_factory.mktemp("features")
    write_features(folder, "a", maps, ROWS)
    features = read_features(folder, level)["a"]
    restored = np.append(features.file_rows, -1)[features.mask_ids]
    assert_array_equal(restored, maps[level])
    assert_allclose(features.embeddings, ROWS[features.file_rows], atol=1e-7)
    assert set(np.unique(features.mask_ids)) - {-1} == set(range(len(features.embeddings)))


# What is wrong


@pytest.mark.parametrize(
    ("value", "dtype"), [(11, np.int32), (-2, np.int32), (9.5, np.float32), (np.nan, np.float32), (np.inf, np.float32)]
)
def test_ids_that_are_none(tmp_path, value, dtype):
    maps = MAPS.astype(dtype)
    maps[3, 1, 2] = value
    with malformed(r"a_s\.npy: level large, pixel \(2, 1\)"):
        raw(tmp_path, maps)["a"]
    assert len(read_features(tmp_path, "small")["a"].file_rows) == 3


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf])
def test_used_rows_without_direction(tmp_path, value):
    rows = ROWS.copy()
    rows[9] = value
    with malformed(r"a_f\.npy: row 9 "):
        raw(tmp_path, rows=rows)["a"]
    assert len(read_features(tmp_path, "small")["a"].embeddings) == 3


@pytest.mark.parametrize("shape", [(3, 2, 3), (4, 2), (1, 4, 2, 3), (4, 0, 3)])
def test_shapes_of_maps(tmp_path, shape):
    folder = raw(tmp_path, np.full(shape, 20))
    with malformed(r"a_s\.npy"):
        folder["a"]


@pytest.mark.parametrize("rows", [np.zeros((4, 0), np.float32), np.zeros(8, np.float32), MAPS[0]])
def test_shapes_of_embeddings(tmp_path, rows):
    with malformed(r"a_f\.npy: expected floats"):
        raw(tmp_path, rows=rows)


def test_photos_of_different_encoders(folder):
    write_features(folder, "c", MAPS, np.ones((11, 9), np.float32))
    with malformed("9 dimensions, the folder's first has 8"):
        read_features(folder)["c"]


def test_missing_files(folder, tmp_path_factory):
    (folder / "a_f.npy").unlink()
    with malformed(r"1 of 2 photos have _s\.npy but no _f\.npy: a$"):
        read_features(folder)
    with refused("expected features of photos"):
        read_features(tmp_path_factory.mktemp("empty"))
    with refused(r"no such file or folder\. Expected features of photos"):
        read_features(folder / "absent")


# The mapping


def test_keys_and_names_of_views(folder):
    features = read_features(folder)
    assert (list(features), len(features)) == (["a", "cam0/b"], 2)
    found = {name: features.key(name) for name in ("a", "a.jpg", "x/a.png", "cam0/b.jpg", "b.jpg", "")}
    assert found == {"a": "a", "a.jpg": "a", "x/a.png": "a", "cam0/b.jpg": "cam0/b", "b.jpg": None, "": None}
    assert "a.jpg" in features
    assert "b" not in features
    assert 3 not in features
    assert features.get("b") is None
    with pytest.raises(KeyError, match="no features of 'b'"):
        features["b"]


def test_reading_is_lazy(folder):
    (folder / "cam0/b_s.npy").write_bytes(b"damaged")
    features = read_features(folder)
    assert len(features["a"].embeddings) == 2
    with malformed(r"b_s\.npy"):
        features["cam0/b"]


def test_the_encoder_is_kept_and_checked(folder):
    encoder = EncoderIdentity("toy", 8)
    assert read_features(folder, encoder=encoder).encoder is encoder
    with pytest.raises(MismatchError, match=r"8 dimensions.*512"):
        read_features(folder, encoder=EncoderIdentity("ViT-B-16", 512))


# Writing


def test_writing_what_cannot_be_read_back(tmp_path):
    for maps in (MAPS[:3], MAPS[None], np.full((2, 3), 11, np.int32), np.full((2, 3), -2, np.int32)):
        with refused("mask_ids"):
            write_features(tmp_path, "a", maps, ROWS)
    for stem in ("../a", "/a", ""):
        with refused("stem"):
            write_features(tmp_path, stem, MAPS, ROWS)
    assert list(tmp_path.iterdir()) == []


def test_writing_again_needs_permission(folder):
    with refused("exists"):
        write_features(folder, "a", MAPS, ROWS)
    write_features(folder, "a", MAPS[0], ROWS, overwrite=True)
    assert_array_equal(read_features(folder)["a"].file_rows, [0, 2])


def test_files_are_what_langsplat_writes(folder):
    maps, rows = np.load(folder / "a_s.npy"), np.load(folder / "a_f.npy")
    assert (maps.dtype, rows.dtype) == (np.int32, np.float32)
    assert_array_equal(maps, MAPS)
    assert_array_equal(rows, ROWS)


@pytest.mark.parametrize("array", [np.arange(5), np.zeros((0, 3), np.float16), np.eye(3, order="F")])
def test_npy_is_numpys(tmp_path, array):
    write_npy(tmp_path / "a.npy", array)
    mapped = map_npy(tmp_path / "a.npy")
    assert mapped.dtype == array.dtype
    assert_array_equal(mapped, np.load(tmp_path / "a.npy"))
    assert_array_equal(mapped, array)


# Vocabularies

WORDS = {"sofa": [3.0, 0.0, 4.0], "red cup": [0.0, 2.0, 0.0], "Table": [1.0, 1.0, 1.0]}


@pytest.fixture
def vocabulary(tmp_path) -> VocabularyEncoder:
    (tmp_path / "words.json").write_text(json.dumps(WORDS))
    return read_vocabulary(tmp_path / "words.json")


def test_words_are_unit_vectors_in_the_order_asked(vocabulary):
    got = vocabulary.encode_texts(["red cup", "sofa", "red cup"])
    assert got.dtype == np.float32
    assert_allclose(got, [[0, 1, 0], [0.6, 0, 0.8], [0, 1, 0]], atol=1e-7)
    assert vocabulary.encode_texts([]).shape == (0, 3)


def test_the_name_of_a_vocabulary(vocabulary, tmp_path):
    assert vocabulary.identity == EncoderIdentity("words", 3)
    named = read_vocabulary(tmp_path / "words.json", name="ViT-B-16")
    assert named.identity == EncoderIdentity("ViT-B-16", 3)


def test_unknown_words_have_advice(vocabulary):
    with refused(r"'soffa'.*3 texts.*'words'. Did you mean 'sofa'"):
        vocabulary.encode_texts(["sofa", "soffa"])
    with refused("Did you mean 'Table'"):
        vocabulary.encode_texts(["tabel"])
    with refused("starts with '"):
        vocabulary.encode_texts(["zzzzzz"])
    with refused("a list of texts"):
        vocabulary.encode_texts("sofa")


def test_vocabulary_round_trip(vocabulary, tmp_path):
    identity = EncoderIdentity("ViT-B-16/laion", 3, "abc123")
    encoder = VocabularyEncoder(identity, vocabulary.texts, vocabulary.embeddings)
    write_vocabulary(tmp_path / "words.safetensors", encoder)
    again = read_vocabulary(tmp_path / "words.safetensors")
    assert (again.identity, again.texts) == (identity, vocabulary.texts)
    assert_allclose(again.embeddings, vocabulary.embeddings, atol=1e-7)
    with refused("exists"):
        write_vocabulary(tmp_path / "words.safetensors", encoder)


@pytest.mark.parametrize(
    "document",
    [
        [],
        {},
        {"a": 1},
        {"a": []},
        {"a": [1.0, 2.0], "b": [1.0]},
        {"a": [1.0, "2"]},
        {"a": [1.0, None]},
        {"a": [0.0, 0.0]},
        {"a": [1e400, 0.0]},
        {"a": [True, False]},
    ],
)
def test_vocabularies_that_are_none(tmp_path, document):
    (tmp_path / "words.json").write_text(json.dumps(document))
    with malformed(r"words\.json"):
        read_vocabulary(tmp_path / "words.json")


def test_safetensors_that_are_no_vocabulary(tmp_path):
    from safetensors.numpy import save_file

    path = tmp_path / "words.safetensors"
    for tensors, metadata in (
        ({"other": ROWS}, {"texts": "[]"}),
        ({"embeddings": ROWS}, None),
        ({"embeddings": ROWS}, {"texts": '["a"]'}),
        ({"embeddings": ROWS[:2]}, {"texts": '["a", "a"]'}),
        ({"embeddings": ROWS[:1]}, {"texts": "[1]"}),
        ({"embeddings": MAPS[0]}, {"texts": '["a", "b"]'}),
    ):
        save_file(tensors, path, metadata)
        with malformed(r"words\.safetensors"):
            read_vocabulary(path)
    with refused("no such file"):
        read_vocabulary(tmp_path / "absent.json")
