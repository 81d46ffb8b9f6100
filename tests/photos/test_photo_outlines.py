"""Outlines of photos by the network that ships: against its twin, on pictures with known borders, and how it learns."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from drsplat.errors import InputError
from drsplat.kernels.photo_regions import BORDER_STEPS
from drsplat.photos.models.graph.segmenter import layers_of, shipped_network
from drsplat.photos.models.outlines import outlines, shipped_outlines
from twins import photo_network

HASH = "d2fd21ece8db1a8c"  # of the shipped file: outlines of other weights are other outlines


def square(height: int = 240, width: int = 320) -> np.ndarray:
    """A bright square on dark ground, with a little noise."""
    picture = np.full((height, width, 3), 60, np.uint8)
    picture[60:180, 100:220] = (200, 190, 170)
    return np.clip(picture + np.random.default_rng(0).integers(-3, 4, picture.shape), 0, 255).astype(np.uint8)


def photo(height: int, width: int) -> np.ndarray:
    rng = np.random.default_rng(1)
    cells = rng.integers(0, 256, (-(-height // 20), -(-width // 20), 3)).repeat(20, 0).repeat(20, 1)
    return cells[:height, :width].astype(np.uint8)


def test_the_weights_are_those_that_were_learned():
    layers, name = shipped_outlines()
    assert name == HASH
    assert sum(layer.size for layer in layers) < 1_000_000
    assert not layers[-2][:, 4:].any()  # of traits, which are not used


@pytest.mark.parametrize("size", [(1, 1), (1, 70), (33, 40), (96, 161)])
def test_outlines_are_those_of_the_twin(size):
    """In float64, at both sizes; strengths in the middle between two steps may go to either."""
    image = photo(*size)
    half = Image.fromarray(image).resize(((size[1] + 1) // 2, (size[0] + 1) // 2), Image.Resampling.BOX)
    layers = shipped_outlines()[0]
    seen = [photo_network.look(np.asarray(part), layers).borders.astype(np.float32) for part in (image, half)]
    enlarged = np.asarray(Image.fromarray(seen[1]).resize(size[::-1], Image.Resampling.BILINEAR))
    found = outlines(image)
    assert found.dtype == np.float32
    assert_allclose(found, (seen[0] + enlarged) / 2 / BORDER_STEPS, atol=1.01 / BORDER_STEPS)


def test_any_number_of_threads_gives_the_same_bits():
    image = photo(700, 900)
    assert_array_equal(outlines(image, threads=1), outlines(image, threads=2))


def test_outlines_of_a_large_photo_are_those_of_the_smaller_one_enlarged():
    large = np.asarray(Image.fromarray(square()).resize((1280, 960), Image.Resampling.BICUBIC))
    strength = outlines(large)
    assert strength.shape == (960, 1280)
    assert strength.min() >= 0
    assert strength.max() <= 1
    assert strength[480, 388:412].max() > 0.6
    assert strength[320:640, 480:800].max() < 0.2


def test_a_photo_without_pixels_is_refused():
    with pytest.raises(InputError, match="0x5 pixels"):
        outlines(np.zeros((5, 0, 3), np.uint8))


def test_learning_begins_with_what_graph_sees():
    """A network of PyTorch with stored weights gives what the native one does."""
    torch = pytest.importorskip("torch", reason="pip install torch")
    from world.outlines.learning import begun_from

    weights = shipped_network()[0]
    image = photo(64, 96)
    with torch.inference_mode():
        logits = begun_from(weights)(torch.tensor(image).permute(2, 0, 1)[None].float() / 127.5 - 1)[0]
    expected = photo_network.look(image, layers_of(weights)).borders
    assert_allclose(logits[0].sigmoid().numpy() * BORDER_STEPS, expected, atol=0.51)
    assert not logits[1:].any()


@pytest.mark.slow
def test_it_learns_from_maps_and_writes_what_the_native_network_reads(tmp_path):
    pytest.importorskip("torch", reason="pip install torch")
    from safetensors.numpy import load_file
    from world.outlines.learning import learn, read_taught

    for number in range(5):
        image = square() if number % 2 else photo(240, 320)
        Image.fromarray(image).save(tmp_path / f"{number}.png")
        edges = np.zeros(image.shape[:2], np.uint8)
        edges[::20] = edges[:, ::20] = 255
        np.save(tmp_path / f"{number}.npy", edges)
    taught, held_out = read_taught(tmp_path)
    assert [one.picture for one in held_out] == ["4"]
    assert len(taught) == 4
    learn(taught, held_out, [], 2, tmp_path / "network.safetensors")
    written = load_file(tmp_path / "network.safetensors")
    assert {name: array.shape for name, array in written.items()} == {
        name: array.shape for name, array in shipped_network()[0].items()
    }
