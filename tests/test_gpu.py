"""What only a CUDA GPU can show: gsplat's kernels under our loop, and models there against the CPU.

Skipped with a reason on a machine without one.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import drsplat as ds
from captures_to_train import known_scene, perturbed_points, photographed, ring
from drsplat.formats.captures import SparsePoints
from drsplat.training import cuda
from drsplat.training.checkpoint import load_checkpoint, save_checkpoint
from drsplat.training.run import Run
from test_training_cuda import BUSY, CHAIN, device_run, fresh_run
from tiny_encoders import write_model

no_training = cuda.unavailable()
pytestmark = [
    pytest.mark.gpu,
    pytest.mark.filterwarnings("ignore"),  # of torch and gsplat, which differ from release to release
]
trains = pytest.mark.skipif(no_training is not None, reason=str(no_training))


@pytest.fixture(scope="module")
def torch() -> Iterator[object]:
    torch = pytest.importorskip("torch", reason="needs torch")
    if not torch.cuda.is_available():
        pytest.skip("needs a CUDA GPU")
    return torch


@pytest.fixture(scope="module")
def scene() -> ds.Gaussians:
    return known_scene(300)


@pytest.fixture(scope="module")
def views(scene, tmp_path_factory) -> list[ds.View]:
    return photographed(tmp_path_factory.mktemp("photos"), scene, ring(32))


@pytest.fixture(scope="module")
def points(scene) -> SparsePoints:
    return perturbed_points(scene)


# --- training -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def engine():
    return cuda.installed_engine()


@trains
@pytest.mark.parametrize("distortion", [None, (0.3, 0.0, 0.0, 0.0)], ids=["whole", "with-edges"])
def test_the_losses_are_those_of_the_cpu(engine, views, points, distortion):
    """Step for step; gsplat's fast exponentials, its limit of opacity and the order of its sums differ."""
    quiet = replace(BUSY, refine_until=0)
    views = [replace(view, distortion=distortion) for view in views]
    there, here = device_run(views, points, quiet, engine), fresh_run(Run, views, points, quiet)
    for _ in range(20):
        assert there.step().loss == pytest.approx(here.step().loss, rel=5e-3)


@trains
def test_the_first_refinement_is_that_of_the_cpu(engine, views, points):
    s = replace(BUSY, reset_every=1000)
    there, here = device_run(views, points, s, engine), fresh_run(Run, views, points, s)
    for _ in range(s.refine_every):
        there.step()
        here.step()
    assert len(here.optimizer) > 310
    assert len(there.scene) == pytest.approx(len(here.optimizer), rel=0.02)


@trains
def test_the_budget_is_never_exceeded(engine, views, points):
    run = device_run(views, points, replace(BUSY, max_gaussians=311), engine)
    assert max(run.step() and len(run.scene) for _ in range(BUSY.iterations)) == 311


@trains
def test_the_chain_fills_its_budget(engine, views, points):
    run = device_run(views, points, replace(CHAIN, max_gaussians=330), engine)
    losses = [run.step().loss for _ in range(CHAIN.iterations)]
    assert len(run.scene) == 330
    assert np.mean(losses[-6:]) < np.mean(losses[:6])


@trains
@pytest.mark.parametrize("settings", [BUSY, replace(CHAIN, max_gaussians=330)], ids=["default", "mcmc"])
def test_a_run_goes_on_from_its_checkpoint(engine, views, points, tmp_path, settings):
    """Not to the bit: a GPU adds in no fixed order."""
    whole = device_run(views, points, settings, engine)
    for _ in range(12):
        whole.step()
    save_checkpoint(tmp_path / "checkpoint.safetensors", whole, "capture")
    later = device_run(views, points, settings, engine)
    load_checkpoint(tmp_path / "checkpoint.safetensors", later, "capture")
    assert later.iteration == 12
    assert len(later.scene) == len(whole.scene)
    for _ in range(10):
        assert later.step().loss == pytest.approx(whole.step().loss, rel=2e-2)


@trains
def test_held_out_photos_are_as_good_as_on_the_cpu(views, points):
    s = ds.TrainingSettings(iterations=1000)
    there, here = (ds.train(views, s, points=points, device=device) for device in ("cuda", "cpu"))
    assert there.evaluation.psnr == pytest.approx(here.evaluation.psnr, abs=0.7)
    assert there.evaluation.psnr > 28


@trains
def test_a_full_gpu_is_explained(torch, views, points):
    try:
        _fill(torch)
        with pytest.raises(ds.DrSplatError, match=r"memory is full at [\d,]+ Gaussians, in iteration \d+.*max_gauss"):
            ds.train([view.resized(4000, 3000) for view in views], BUSY, points=points, device="cuda")
    finally:
        _release(torch)


def _fill(torch) -> None:
    """Leave 64 MiB to this process."""
    torch.cuda.empty_cache()
    total = torch.cuda.get_device_properties(0).total_memory
    torch.cuda.set_per_process_memory_fraction((torch.cuda.memory_reserved() + (64 << 20)) / total)


def _release(torch) -> None:
    torch.cuda.set_per_process_memory_fraction(1.0)
    torch.cuda.empty_cache()


# --- models ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pictures() -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [rng.integers(0, 256, (20 + i, 30, 3), np.uint8) for i in range(9)]


@pytest.mark.parametrize("kind", ["clip", "siglip", "siglip2", "dinov2"])
@pytest.mark.parametrize(("dtype", "least"), [("float32", 0.99999), ("float16", 0.999)])
def test_embeddings_are_those_of_the_cpu(torch, pictures, tmp_path, kind, dtype, least):
    from drsplat.models.loading import load_encoder

    folder = str(write_model(tmp_path / kind, kind))
    here, there = load_encoder(folder, "cpu", "float32"), load_encoder(folder, "cuda", dtype)
    assert (here.encode_images(pictures) * there.encode_images(pictures)).sum(1).min() > least
    if kind != "dinov2":
        texts = ["a red mug", "the table"]
        assert_allclose(there.encode_texts(texts), here.encode_texts(texts), atol=1e-4)


def test_a_batch_that_does_not_fit_is_made_smaller(torch, pictures, tmp_path):
    from drsplat.models.loading import load_encoder

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

    from drsplat.models import sam
    from test_sam import IMAGE, LOOSE, saved

    folder: Path = saved(tmp_path / kind, transformers, kind)
    here, there = (sam.load_segmenter(str(folder), device, LOOSE).segment(IMAGE) for device in ("cpu", "cuda"))
    assert len(here["default"]) >= 20
    for level, masks in here.items():
        assert len(there[level]) == pytest.approx(len(masks), rel=0.05), level
        ours = {tuple(box) for box in masks.boxes.tolist()}
        shared = [box for box in there[level].boxes.tolist() if tuple(box) in ours]
        assert len(shared) >= 0.9 * len(masks), level
