"""What only a CUDA GPU can show: our kernels as NVRTC compiles them, and models there against the CPU.

Skipped with a reason on a machine without one.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from test_cuda_training import BUSY, CHAIN, fresh_run
from test_kernels import assert_same_triples, masked

import drsplat as ds
from captures_to_train import known_scene, perturbed_points, photographed, ring
from drsplat.formats.captures import SparsePoints
from drsplat.kernels import SplatArrays, render_channels, splat_arrays, topk_contributions, view_weights
from drsplat.kernels.cuda.devices import using_device
from drsplat.kernels.cuda.engine import CudaEngine, cuda_engine, unavailable
from drsplat.kernels.cuda.tiling import running_sums, sorted_pairs
from drsplat.training.device_run import DeviceRun
from drsplat.training.keeper import load_checkpoint, save_checkpoint
from drsplat.training.run import Run
from scenes import random_mask_map
from tiny_encoders import write_model
from twins import registering as reference

no_kernels = unavailable()
pytestmark = [
    pytest.mark.gpu,
    pytest.mark.filterwarnings("ignore"),  # of torch and CuPy, which differ from release to release
]
needs_kernels = pytest.mark.skipif(no_kernels is not None, reason=str(no_kernels))


@pytest.fixture(scope="module")
def scene() -> ds.Gaussians:
    return known_scene(300)


@pytest.fixture(scope="module")
def views(scene, tmp_path_factory) -> list[ds.View]:
    return photographed(tmp_path_factory.mktemp("photos"), scene, ring(32))


@pytest.fixture(scope="module")
def points(scene) -> SparsePoints:
    return perturbed_points(scene)


@pytest.fixture(scope="module")
def engine() -> CudaEngine:
    return cuda_engine()


# --- drawing --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def both(scene) -> tuple[SplatArrays, SplatArrays]:
    """Return a scene on the GPU and on the CPU."""
    with using_device("cuda"):
        there = splat_arrays(scene)
    return there, splat_arrays(scene)


@needs_kernels
@pytest.mark.parametrize("count", [0, 1, 4097, 3_000_000])
def test_sorts_and_sums_are_those_of_numpy(engine, count):
    keys = default_rng(count).integers(0, 1 << 22, count, np.uint32)
    pairs = sorted_pairs(engine, engine.xp.asarray(keys), None, 22)
    order = np.argsort(keys, kind="stable")
    assert_array_equal(pairs.values.get(), order)
    assert_array_equal(pairs.keys.get(), keys[order])
    assert_array_equal(running_sums(engine, engine.xp.asarray(keys)).get(), np.cumsum(keys, dtype=np.int64))


@needs_kernels
@pytest.mark.parametrize("k", [1, 3, 40, 100, None])
def test_weights_are_those_of_the_twin(both, views, k):
    (there, here), view = both, views[3]
    twin = reference.contributors(here, view)
    mask_ids, expected = masked(twin, random_mask_map(view.height, view.width, 12, 0.1), k)
    found = view_weights(there, view, mask_ids, k)
    assert_same_triples(found, expected)
    for one, other in zip(found, view_weights(there, view, mask_ids, k), strict=True):
        assert_array_equal(one, other)
    if k is not None:
        ids, weights = reference.pixel_table(reference.largest(twin, k), k)
        sure, seen = ~reference.on_boundary(twin, k), topk_contributions(there, view, k)
        assert (seen.ids[sure] != ids[sure]).mean() < 1e-3
        assert_allclose(seen.weights[sure], weights[sure], rtol=3e-4, atol=1e-7)


@needs_kernels
@pytest.mark.parametrize("channels", [3, 11])
def test_images_are_those_of_the_twin(both, views, channels):
    (there, here), view = both, views[5]
    values = default_rng(0).random((len(here.opacities), channels), np.float32)
    background = np.linspace(0, 1, channels, dtype=np.float32)
    seen = reference.contributors(here, view)
    found = render_channels(there, view, values, background)
    sure = ~seen.unsure
    assert_allclose(found.channels[sure], reference.weighted_sums(seen, values, background).channels[sure], atol=2e-5)


# --- training -------------------------------------------------------------------------------------


def device_run(engine, views, points, s: ds.TrainingSettings) -> DeviceRun:
    return fresh_run(DeviceRun, views, points, s, engine=engine)


@needs_kernels
@pytest.mark.parametrize("distortion", [None, (0.3, 0.0, 0.0, 0.0)], ids=["whole", "with-edges"])
def test_the_losses_are_those_of_the_cpu(engine, views, points, distortion):
    """Step for step; the order of sums differs, and exponentials are a GPU's."""
    quiet = replace(BUSY, refine_until=0, iterations=24)
    views = [replace(view, distortion=distortion) for view in views]
    there, here = device_run(engine, views, points, quiet), fresh_run(Run, views, points, quiet)
    for _ in range(20):
        assert there.step().loss == pytest.approx(here.step().loss, rel=1e-3)


@needs_kernels
@pytest.mark.parametrize("s", [BUSY, replace(CHAIN, max_gaussians=330)], ids=["default", "mcmc"])
def test_the_first_refinement_is_that_of_the_cpu(engine, views, points, s):
    there, here = device_run(engine, views, points, s), fresh_run(Run, views, points, s)
    for _ in range(s.refine_every):
        there.step()
        here.step()
    assert len(here) > 310
    assert len(there) == pytest.approx(len(here), rel=0.02)


@needs_kernels
def test_the_budget_is_never_exceeded(engine, views, points):
    run = device_run(engine, views, points, replace(BUSY, max_gaussians=311))
    assert max(run.step() and len(run) for _ in range(BUSY.iterations)) == 311


@needs_kernels
@pytest.mark.parametrize("s", [BUSY, replace(CHAIN, max_gaussians=330)], ids=["default", "mcmc"])
def test_a_run_goes_on_from_its_checkpoint_to_the_same_bits(engine, views, points, tmp_path, s):
    whole = device_run(engine, views, points, s)
    for _ in range(7):
        whole.step()
    save_checkpoint(tmp_path / "checkpoint.safetensors", whole, "{}")
    later = device_run(engine, views, points, s)
    load_checkpoint(tmp_path / "checkpoint.safetensors", later, "{}")
    assert later.iteration == 7
    for _ in range(8):
        assert later.step().loss == whole.step().loss
    for name, array in whole.state()[0].items():
        assert_array_equal(later.state()[0][name], array, err_msg=name)


@needs_kernels
def test_held_out_photos_are_as_good_as_on_the_cpu(views, points):
    s = ds.TrainingSettings(iterations=1000)
    there, here = (ds.train(views, s, points=points, device=device) for device in ("cuda", "cpu"))
    assert there.evaluation.psnr == pytest.approx(here.evaluation.psnr, abs=0.7)
    assert there.evaluation.psnr > 28


@needs_kernels
def test_a_full_gpu_is_explained(engine, views, points):
    pool = engine.xp.get_default_memory_pool()
    pool.free_all_blocks()
    pool.set_limit(size=pool.used_bytes() + (64 << 20))
    try:
        with pytest.raises(ds.DrSplatError, match=r"memory is full at [\d,]+ Gaussians, in iteration \d+.*max_gauss"):
            ds.train([view.resized(4000, 3000) for view in views], BUSY, points=points, device="cuda")
    finally:
        pool.set_limit(size=0)


# --- models ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def torch() -> Iterator[object]:
    torch = pytest.importorskip("torch", reason="needs torch")
    if not torch.cuda.is_available():
        pytest.skip("needs a CUDA GPU")
    return torch


def _fill(torch) -> None:
    """Leave 64 MiB to this process."""
    torch.cuda.empty_cache()
    total = torch.cuda.get_device_properties(0).total_memory
    torch.cuda.set_per_process_memory_fraction((torch.cuda.memory_reserved() + (64 << 20)) / total)


def _release(torch) -> None:
    torch.cuda.set_per_process_memory_fraction(1.0)
    torch.cuda.empty_cache()


@pytest.fixture(scope="module")
def pictures() -> list[np.ndarray]:
    rng = default_rng(0)
    return [rng.integers(0, 256, (20 + i, 30, 3), np.uint8) for i in range(9)]


@pytest.mark.parametrize("kind", ["clip", "siglip", "siglip2", "dinov2"])
@pytest.mark.parametrize(("dtype", "least"), [("float32", 0.99999), ("float16", 0.999)])
def test_embeddings_are_those_of_the_cpu(torch, pictures, tmp_path, kind, dtype, least):
    from drsplat.photos.models.loading import load_encoder

    folder = str(write_model(tmp_path / kind, kind))
    here, there = load_encoder(folder, "cpu", "float32"), load_encoder(folder, "cuda", dtype)
    assert (here.encode_images(pictures) * there.encode_images(pictures)).sum(1).min() > least
    if kind != "dinov2":
        texts = ["a red mug", "the table"]
        assert_allclose(there.encode_texts(texts), here.encode_texts(texts), atol=1e-4)


def test_a_batch_that_does_not_fit_is_made_smaller(torch, pictures, tmp_path):
    from drsplat.photos.models.loading import load_encoder

    folder = str(write_model(tmp_path / "clip", "clip"))
    there = load_encoder(folder, "cuda", "float32")
    many, batch = pictures * 1500, there.batch
    expected = load_encoder(folder, "cuda", "float32").encode_images(pictures)
    try:
        _fill(torch)
        rows = there.encode_images(many)
    finally:
        _release(torch)
    assert there.batch < batch
    assert (rows * np.tile(expected, (1500, 1))).sum(1).min() > 0.99999  # TF32 in the first layer


@pytest.mark.parametrize("kind", ["sam", "sam2"])
def test_masks_are_those_of_the_cpu(torch, tmp_path, kind):
    import transformers
    from test_sam import IMAGE, LOOSE, saved

    from drsplat.photos.models import sam

    folder = saved(tmp_path / kind, transformers, kind)
    here, there = (sam.load_segmenter(str(folder), device, LOOSE).segment(IMAGE) for device in ("cpu", "cuda"))
    assert len(here["default"]) >= 20
    for level, masks in here.items():
        assert len(there[level]) == pytest.approx(len(masks), rel=0.05), level
        ours = {tuple(box) for box in masks.boxes.tolist()}
        shared = [box for box in there[level].boxes.tolist() if tuple(box) in ours]
        assert len(shared) >= 0.9 * len(masks), level
