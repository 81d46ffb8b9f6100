"""Features that other systems have on disk, as `drsplat evaluate --features` reads them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drsplat.formats.peer_features import read_peer_features
from drsplat.formats.tensors import write_tensors
from mutations import bounded_allocations, quota, seeded, survivors
from refusing import malformed, refused

RNG = np.random.default_rng(0)
ROWS = RNG.normal(size=(50, 16)).astype(np.float32)
LEAVES = RNG.integers(-1, 6, 50)
OF_LEAVES = RNG.normal(size=(6, 16)).astype(np.float16)


def leaves_file(path: Path) -> Path:
    """As OpenGaussian saves its clusters: names that end in .npy themselves."""
    np.savez(path, **{"leaf_feat.npy": OF_LEAVES, "leaf_ind.npy": LEAVES, "occu_count.npy": np.arange(6)})
    return path


def test_arrays_are_read_as_they_are(tmp_path):
    np.save(tmp_path / "a.npy", ROWS)
    write_tensors(tmp_path / "a.safetensors", {"features": ROWS})
    for name in ("a.npy", "a.safetensors"):
        assert_array_equal(read_peer_features(tmp_path / name)[:], ROWS)


def test_of_several_arrays_the_one_that_is_named_so(tmp_path):
    write_tensors(tmp_path / "a.safetensors", {"means": ROWS[:, :3], "language_features": ROWS})
    assert_array_equal(read_peer_features(tmp_path / "a.safetensors")[:], ROWS)
    write_tensors(tmp_path / "b.safetensors", {"one": ROWS, "two": ROWS})
    with refused(r"expected one array .* found one \(50, 16\), two \(50, 16\)"):
        read_peer_features(tmp_path / "b.safetensors")


def test_leaves_give_their_features_to_their_gaussians(tmp_path):
    found = read_peer_features(leaves_file(tmp_path / "cluster_lang.npz"))
    assert (len(found), found.shape, found.dtype) == (50, (50, 16), np.float16)
    expected = np.where(LEAVES[:, None] >= 0, OF_LEAVES[LEAVES], 0)
    assert_array_equal(found[:], expected)
    assert_array_equal(found[7:20], expected[7:20])


def test_a_leaf_that_is_not_there_is_refused(tmp_path):
    np.savez(tmp_path / "a.npz", leaf_feat=OF_LEAVES, leaf_ind=np.array([0, 6]))
    with malformed("leaf 6, and there are 6"):
        read_peer_features(tmp_path / "a.npz")
    np.savez(tmp_path / "b.npz", features=ROWS)
    with refused("expected the arrays leaf_feat and leaf_ind, found \\['features'\\]"):
        read_peer_features(tmp_path / "b.npz")


@pytest.mark.parametrize("array", [ROWS[0], ROWS.astype(np.float64), ROWS.astype(np.int32)], ids=["1-d", "f64", "i32"])
def test_other_arrays_are_refused(array, tmp_path):
    np.save(tmp_path / "a.npy", array)
    with refused(r"expected float16 or float32 \(N, D\)"):
        read_peer_features(tmp_path / "a.npy")


def test_codes_without_their_decoder_are_refused(tmp_path):
    np.save(tmp_path / "a.npy", ROWS[:, :3])
    with refused(r"codes of LangSplat's autoencoder: pass its checkpoint, decoder=FILE"):
        read_peer_features(tmp_path / "a.npy")


class TestOfPyTorch:
    """What torch.save wrote, in the shapes of LangSplat's checkpoints."""

    torch = pytest.importorskip("torch")

    def saved(self, what: Any, path: Path) -> Path:
        self.torch.save(what, path)
        return path

    def langsplat(self, folder: Path) -> tuple[Path, Path, Any]:
        """A checkpoint (parameters, iteration), an autoencoder's, and that autoencoder's decoder."""
        torch = self.torch
        torch.manual_seed(0)
        decoder = torch.nn.ModuleList(
            [torch.nn.Linear(3, 8), torch.nn.ReLU(), torch.nn.Linear(8, 12), torch.nn.ReLU(), torch.nn.Linear(12, 20)]
        )
        codes = torch.nn.functional.normalize(torch.randn(50, 3))
        other = [
            torch.zeros(50, 1, 3),
            torch.zeros(50, 15, 3),
            torch.zeros(50, 3),
            torch.zeros(50, 4),
            torch.zeros(50, 1),
        ]
        parameters = (3, torch.zeros(50, 3), *other, codes, torch.zeros(50))
        scene = self.saved((parameters, 30_000), folder / "chkpnt30000.pth")
        state = {f"decoder.{name}": value for name, value in decoder.state_dict().items()} | {
            "encoder.0.bias": codes[0]
        }
        with torch.no_grad():
            expected = codes
            for layer in decoder:
                expected = layer(expected)
            expected = torch.nn.functional.normalize(expected)
        return scene, self.saved(state, folder / "best_ckpt.pth"), expected.numpy()

    def test_a_tensor(self, tmp_path):
        path = self.saved({"features": self.torch.from_numpy(ROWS)}, tmp_path / "a.pt")
        assert_array_equal(read_peer_features(path)[:], ROWS)

    def test_langsplat_is_decoded(self, tmp_path):
        scene, autoencoder, expected = self.langsplat(tmp_path)
        found = read_peer_features(scene, autoencoder)
        assert found.shape == (50, 20)
        assert_allclose(found[10:30], expected[10:30], atol=1e-6)
        with refused("codes of LangSplat's autoencoder"):
            read_peer_features(scene)

    def test_a_decoder_of_others_is_refused(self, tmp_path):
        scene, _, _ = self.langsplat(tmp_path)
        other = self.saved({"decoder.0.weight": self.torch.zeros(4, 5)}, tmp_path / "other.pth")
        with malformed("expected a layer of 3 inputs with its bias"):
            read_peer_features(scene, other)
        with refused(r"expected layers decoder\.0\.weight and so on"):
            read_peer_features(scene, self.saved({"a": self.torch.zeros(2)}, tmp_path / "none.pth"))

    def test_what_would_run_code_is_refused(self, tmp_path):
        path = self.saved({"features": print}, tmp_path / "a.pth")
        with malformed("without running what is in it"):
            read_peer_features(path)

    def test_damaged_checkpoints(self, tmp_path):
        scene, autoencoder, _ = self.langsplat(tmp_path)
        survivors(scene, lambda path: read_peer_features(path, autoencoder)[:], seeded(5), quota(40))


def test_damaged_leaves(tmp_path):
    with bounded_allocations(1 << 30):
        leaves = leaves_file(tmp_path / "leaves.npz")
        survivors(leaves, lambda path: read_peer_features(path)[:], seeded(3), quota(150))


@pytest.mark.parametrize("name", ["a.npy", "a.npz", "a.safetensors", "a.pth"])
def test_missing_files_say_so(name, tmp_path):
    if name.endswith(".pth"):
        pytest.importorskip("torch")
    with refused("there is no such file"):
        read_peer_features(tmp_path / name)
