"""The colours that are asked for alone: vectors fitted to photos, and how people's names of colours are counted."""

import hashlib
from importlib.resources import files

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from safetensors.numpy import load
from scipy.sparse import csr_array, eye_array
from world.mini.color_names import term_shares, terms_of
from world.mini.photo_colors import fitted, gain_of, in_other_light, wanted

from drsplat import Scene
from drsplat.field import build_field
from drsplat.field.codes import Mixture
from drsplat.field.evidence.evidence import Evidence, MaskIds
from drsplat.photos.models.mini import MiniEncoder
from drsplat.photos.models.mini.lexicon import COLORS, WORDS, colors_in
from fields import SCENE

MINI = MiniEncoder()
SIDE, EACH = 80, 400
SEEN = [
    ("green", (25, 60, 45)), ("red", (140, 25, 45)), ("orange", (235, 120, 30)), ("blue", (80, 140, 150)),
    ("grey", (130, 128, 132)), ("brown", (120, 85, 60)), ("white", (245, 245, 242)), ("black", (28, 28, 30)),
    ("pink", (230, 150, 190)), ("purple", (110, 60, 140)), ("yellow", (230, 200, 50)),
]  # fmt: skip


def disc(color: tuple[int, int, int], shade: float = 1.0) -> np.ndarray:
    """Return the crop of a round thing whose lower part is darker."""
    y, x = np.mgrid[:SIDE, :SIDE] / SIDE
    light = np.where(y > 0.55, shade, 1.0)[..., None]
    noise = default_rng(0).normal(0, 4, (SIDE, SIDE, 3))
    pixels = np.clip(np.array(color) * light + noise, 0, 255)
    return np.where(((x - 0.5) ** 2 + (y - 0.5) ** 2 < 0.2)[..., None], pixels, 0).astype(np.uint8)


@pytest.mark.parametrize(("color", "rgb"), SEEN)
def test_a_crop_is_nearest_to_its_colour(color, rgb):
    texts = MINI.encode_texts([f"something {name}" for name in COLORS])
    assert COLORS[int((texts @ MINI.encode_images([disc(rgb)])[0]).argmax())] == color


@pytest.mark.parametrize("color", ["green", "red", "orange", "pink", "purple", "yellow"])
def test_shadow_takes_no_colour_away(color):
    crop = disc(dict(SEEN)[color], 0.5)
    assert COLORS[int((MINI.rivals("red") @ MINI.encode_images([crop])[0]).argmax())] == color


@pytest.mark.parametrize("text", ["red mug", "a dark green sofa", "orange", "wooden"])
def test_other_texts_are_the_sum_of_taught_words(text):
    table = load((files("drsplat.photos.models.mini") / "mini.safetensors").read_bytes())["words"].astype(np.float32)
    total = table[[WORDS.index(word) for word in text.split() if word != "a"]].sum(0)
    assert_array_equal(MINI.encode_texts([text])[0], total / np.linalg.norm(total))


def test_fields_stay_valid_when_the_colours_of_photos_change():
    weights = (files("drsplat.photos.models.mini") / "mini.safetensors").read_bytes()
    assert MINI.identity.weights == hashlib.blake2b(weights, digest_size=8).hexdigest()


@pytest.mark.parametrize(("text", "colors"), [
    ("something red", ["red"]), ("dark green things", ["green"]), ("dark", ["black"]), ("violet", ["purple"]),
    ("something red and white", ["red", "white"]), ("the orange one", ["orange"]), ("an orange", []),
])  # fmt: skip
def test_which_colours_a_text_names(text, colors):
    assert colors_in(text) == colors


def scene_of(pictures: np.ndarray) -> Scene:
    """Return a scene of which each Gaussian is seen in one mask of its own."""
    count = len(pictures)
    masks = MaskIds(("a.jpg",), np.zeros(count, np.int32), np.arange(count, dtype=np.int32))
    evidence = Evidence(csr_array(eye_array(count, dtype=np.float32, format="csr")), masks, pictures)
    return Scene(build_field(evidence, SCENE, MINI.identity, Mixture(1)), encoder=MINI)


@pytest.mark.slow
def test_a_colour_has_to_stand_clearly_above_the_others():
    """What is red and a little pink is red; where its peak is 0.45 to 0.6 spreads above pink's, neither is said."""
    red, pink, blue = MINI.encode_texts([f"something {color}" for color in ("red", "pink", "blue")])
    selected = {}
    for share in np.linspace(0, 1, 41):
        pictures = np.repeat([red + share * pink, blue], EACH, 0).astype(np.float32)
        pictures /= np.linalg.norm(pictures, axis=1, keepdims=True)
        answer = scene_of(pictures).ask("something red")
        margin = np.log(answer.values[0] / (1 - answer.values[0]))
        selected[float(margin)] = len(answer.gaussian_ids)
    assert {count for margin, count in selected.items() if margin > 0.6} == {EACH}
    assert {count for margin, count in selected.items() if 0.45 < margin < 0.6} == {0}


def test_what_a_colour_has_to_reach_follows_the_colours():
    """Nouns fit better here than 1 / 0.42 times a colour, which says nothing about colours."""
    noun, color = MINI.encode_texts(["bottle"])[0], MINI.encode_texts(["something red"])[0]
    off = color - (color @ noun) * noun
    picture = 0.98 * noun + np.sqrt(1 - 0.98**2) * off / np.linalg.norm(off)
    pictures = np.repeat(picture[None].astype(np.float32), EACH, 0)
    assert (MINI.rivals("red") @ picture).argmax() == COLORS.index("red")
    assert color @ picture < MINI.least_share * 0.98
    scene = scene_of(pictures)
    assert len(scene.ask("something red").gaussian_ids) == EACH
    assert not len(scene.ask("something blue").gaussian_ids)


@pytest.mark.parametrize(("name", "terms"), [
    ("crimson", {"red": 1}), ("reddish brown", {"red": 1 / 3, "brown": 2 / 3}), ("teal", {"blue": 0.5, "green": 0.5}),
    ("bluey grey", {"blue": 1 / 3, "grey": 2 / 3}), ("very dark green", {"black": 1}), ("snot", None),
    ("light grey", {"grey": 0.5, "white": 0.5}),
])  # fmt: skip
def test_which_terms_a_name_means(name, terms):
    assert terms_of(name) == (None if terms is None else pytest.approx(terms))


@pytest.mark.parametrize(("color", "rgb"), SEEN)
def test_pixels_are_called_as_people_call_them(color, rgb):
    pytest.importorskip("matplotlib", reason="the survey's names come with matplotlib")
    shares = term_shares(np.uint8([rgb]))[0]
    assert COLORS[int(shares.argmax())] == color
    assert_allclose(shares.sum(), 1, atol=1e-6)


def test_light_changes_no_label():
    """A highlight and a shadow change the pixels; a mask half of which is white is still called red."""
    pytest.importorskip("matplotlib", reason="the survey's names come with matplotlib")
    pixels, mask = np.full((20, 20, 3), (180, 20, 30), np.uint8), np.ones((20, 20), bool)
    pixels[:10] = 255
    assert COLORS[int(wanted((pixels, mask)).argmax())] == "red"
    lit, same = in_other_light((pixels, mask), default_rng(1))
    assert same is mask
    assert not np.array_equal(lit, pixels)


def test_fitted_vectors_tell_colours_apart():
    rng = default_rng(0)
    middles = np.eye(len(COLORS), 16) + 0.5
    rows = np.repeat(np.arange(len(COLORS)), [5] * 10 + [400])  # the last colour is far more frequent
    pictures = middles[rows] + rng.normal(0, 0.1, (len(rows), 16))
    pictures = (pictures / np.linalg.norm(pictures, axis=1, keepdims=True)).astype(np.float32)
    vectors = fitted(pictures, np.eye(len(COLORS))[rows])
    assert_allclose(np.linalg.norm(vectors, axis=1), 1, rtol=1e-6)
    assert_array_equal((pictures @ vectors.T).argmax(1), rows)


def test_white_is_what_is_brightest_in_a_photo():
    dim = np.full((10, 10, 3), 40, np.uint8)
    dim[:2] = 204
    assert gain_of(dim) == pytest.approx((255 / 204) ** 2.2)
    assert gain_of(np.full((4, 4, 3), 255, np.uint8)) == 1
    assert gain_of(np.zeros((4, 4, 3), np.uint8)) == 2  # a dark photo is no photo of white things


def test_rooms_are_named_by_the_colours_that_were_taught():
    table = load((files("drsplat.photos.models.mini") / "mini.safetensors").read_bytes())["words"].astype(np.float32)
    rows = table[[WORDS.index("orange (colour)" if color == "orange" else color) for color in COLORS]]
    assert_array_equal(MINI.taught_colors, rows / np.linalg.norm(rows, axis=1, keepdims=True))
