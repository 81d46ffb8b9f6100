"""Training through gsplat, as far as it goes without a GPU: what is said where something is absent, the
loss, the parameters, and the whole loop on CPU tensors with a dense rasterizer in gsplat's place."""

import contextlib
import importlib.util
import inspect
import json
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

import drsplat as ds
from captures_to_train import known_scene, perturbed_points, photographed, ring
from drsplat.errors import InputError, MissingExtraError
from drsplat.formats.captures import SparsePoints
from drsplat.kernels import training as kernels
from drsplat.training import cuda, devices
from drsplat.training.checkpoint import load_checkpoint, save_checkpoint
from drsplat.training.job import Beginning, Job
from drsplat.training.optimizer import Optimizer, Rates
from drsplat.training.run import Run
from drsplat.training.start import first_gaussians
from drsplat.training.training_photos import TrainingPhotos
from test_training_parts import gradients, parameters

pytestmark = pytest.mark.filterwarnings("ignore:photos of 48x36 pixels")  # small, so that a run takes no time
missing = [name for name in ("torch", "gsplat") if importlib.util.find_spec(name) is None]
needs_torch = pytest.mark.skipif("torch" in missing, reason="needs torch")
_absent = pytest.mark.skipif(bool(missing), reason=f"needs {' and '.join(missing)}")


def needs_gsplat(test):
    return pytest.mark.oracle(_absent(test))


BUSY = ds.TrainingSettings(
    iterations=24, refine_from=4, refine_every=5, reset_every=9, reset_recovery=2, sh_degree=2,
    sh_degree_every=6, background="random", test_every=4, gradient_threshold=4e-4,
)  # fmt: skip
CHAIN = replace(BUSY, strategy="mcmc", max_gaussians=130)


# --- what is absent -------------------------------------------------------------------------------


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """One that has everything; tests take parts away."""
    parts = SimpleNamespace(torch=True, gsplat=True, gpu=True, csrc=False, nvcc=True)
    names = {"torch": "torch", "gsplat": "gsplat", "gsplat.csrc": "csrc"}
    torch = SimpleNamespace(
        __version__="9.9", version=SimpleNamespace(cuda="12.8"),
        cuda=SimpleNamespace(is_available=lambda: parts.gpu),
    )  # fmt: skip
    monkeypatch.setattr(cuda, "find_spec", lambda name: object() if getattr(parts, names[name]) else None)
    monkeypatch.setattr(cuda, "import_module", {"torch": torch}.__getitem__)
    monkeypatch.setattr(cuda, "_has_cuda_compiler", lambda: parts.nvcc)
    return parts


def test_auto_is_cuda_where_all_is_there(machine):
    assert cuda.unavailable() is None
    assert devices.chosen_device("auto") == devices.chosen_device("cuda") == "cuda"


def test_compiled_kernels_need_no_compiler(machine):
    machine.nvcc, machine.csrc = False, True
    assert cuda.unavailable() is None


@pytest.mark.parametrize(
    ("absent", "said"),
    [
        (("torch",), "needs torch, not installed"),
        (("gsplat",), "needs gsplat, not installed"),
        (("torch", "gsplat"), "needs torch and gsplat, not installed"),
        (("gpu",), "torch 9.9 sees no CUDA GPU"),
        (("nvcc",), "finds no nvcc"),
    ],
)
def test_what_is_absent_is_said_with_the_pip_line(machine, tmp_path, absent, said):
    for part in absent:
        setattr(machine, part, False)
    assert devices.chosen_device("auto") == "cpu"
    with pytest.raises(MissingExtraError, match=said) as caught:
        ds.train([], None, tmp_path / "model", device="cuda")
    assert 'pip install "drsplat[cuda]"' in str(caught.value)
    assert "'cpu'" in str(caught.value)
    with pytest.raises(MissingExtraError, match=said):
        cuda.train(Job([], output_dir=tmp_path / "model"))
    assert not (tmp_path / "model").exists()


def test_kernels_that_cannot_be_built_are_an_error(machine, monkeypatch):
    def broken(name: str) -> object:
        if name == "gsplat.cuda._backend":
            raise RuntimeError("Ninja is required")
        return SimpleNamespace(__version__="9.9", cuda=SimpleNamespace(is_available=lambda: True))

    monkeypatch.setattr(cuda, "import_module", broken)
    with pytest.raises(MissingExtraError, match="Ninja is required"):
        cuda.installed_engine()


def test_the_compiler_is_looked_for_where_torch_does(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("CUDA_HOME", str(tmp_path))
    assert not cuda._has_cuda_compiler()
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin/nvcc").touch()
    assert cuda._has_cuda_compiler()


# --- the loss and the parameters ------------------------------------------------------------------


@needs_torch
@pytest.mark.parametrize("size", [(37, 52), (5, 9), (64, 64)])
@pytest.mark.parametrize("weight", [0.0, 0.2, 1.0])
def test_the_loss_is_that_of_the_kernels(size, weight):
    import torch

    from drsplat.training.torch_loss import photometric_loss

    rng = np.random.default_rng(0)
    image, target = rng.random((2, *size, 3), np.float32)
    loss = photometric_loss(torch.tensor(image), torch.tensor(target), weight)
    expected = kernels.photometric_loss(image, target, weight)
    assert float(loss.value) == pytest.approx(expected.value, abs=1e-5)
    largest = np.abs(expected.gradient).max()
    assert_allclose(loss.gradient.numpy(), expected.gradient, atol=1e-5 * largest, rtol=1e-5)


def optimizer_of(count: int, sh: int) -> Optimizer:
    optimizer = Optimizer(parameters(count, sh=sh))
    rates = Rates(1e-2, 5e-3, 1e-3, 5e-2, 2e-3, 1e-4)
    for step in (1, 2):
        optimizer.step(gradients(optimizer.parameters, seed=step), rates, step)
    return optimizer


@needs_torch
@pytest.mark.parametrize("sh", [1, 4, 16])
def test_parameters_and_moments_come_back_as_they_were_sent(sh):
    from drsplat.training.torch_parameters import DeviceParameters

    optimizer = optimizer_of(7, sh)
    there = DeviceParameters(optimizer, 2, "cpu")
    assert len(there) == 7
    back = there.download()
    for name, array in optimizer.state().items():
        assert_array_equal(back.state()[name], array)
    assert_array_equal(there.sh.detach().numpy(), optimizer.parameters.sh)


@needs_torch
@pytest.mark.parametrize("sh", [1, 9])
def test_a_step_is_that_of_the_cpu(sh):
    import torch

    from drsplat.training.torch_parameters import NAMES, DeviceParameters

    optimizer = optimizer_of(7, sh)
    there = DeviceParameters(optimizer, 2, "cpu")
    slopes = gradients(optimizer.parameters, seed=9)
    for ours, theirs in NAMES.items():
        there.tensors[theirs].grad = torch.tensor(getattr(slopes, ours))
    there.tensors["sh0"].grad = torch.tensor(slopes.sh[:, :1])
    if sh > 1:
        there.tensors["shN"].grad = torch.tensor(slopes.sh[:, 1:])
    rates = Rates(1e-2, 5e-3, 1e-3, 5e-2, 2e-3, 1e-4)
    optimizer.step(slopes, rates, 3)
    there.step(rates)
    for name, array in there.download().state().items():
        assert_allclose(array, optimizer.state()[name], rtol=2e-6, atol=1e-7, err_msg=name)
    assert there.tensors["means"].grad is None


@needs_torch
def test_an_opacity_reset_is_that_of_the_cpu():
    from drsplat.training.density import reset_opacity
    from drsplat.training.torch_parameters import DeviceParameters

    optimizer = optimizer_of(20, 1)
    there = DeviceParameters(optimizer, 2, "cpu")
    there.reset_opacity(0.3)
    reset_opacity(optimizer, 0.3)
    for name, array in there.download().state().items():
        assert_allclose(array, optimizer.state()[name], rtol=1e-6, err_msg=name)


# --- the loop, on CPU tensors ---------------------------------------------------------------------


def dense_rasterization(
    *, means, quats, scales, opacities, colors, viewmats, Ks, width, height, near_plane, eps2d,
    sh_degree, packed, backgrounds, rasterize_mode,
):  # fmt: skip
    """gsplat's, as far as we call it, by `dense_torch`."""
    import torch

    import dense_torch

    assert 0.05 < near_plane < 0.2  # a scene of three units
    assert (eps2d, packed) == (0.3, False)
    assert viewmats.shape == (1, 4, 4)
    assert Ks.shape == (1, 3, 3)
    assert backgrounds.shape == (1, 3)
    pose, K = (matrix[0].numpy().astype(np.float64) for matrix in (viewmats, Ks))
    view = ds.View("", K, pose, width, height)
    scene = dense_torch.Scene(means, torch.log(scales), quats, torch.logit(opacities), colors)
    drawn = dense_torch.render(scene, view, sh_degree, backgrounds[0], rasterize_mode == "antialiased")
    with torch.no_grad():
        points = means @ viewmats[0, :3, :3].T + viewmats[0, :3, 3]
        centers = dense_torch.focal_of(view, points) * points[:, :2] / points[:, 2:] + Ks[0, :2, 2]
        flat = dense_torch.flat_covariances(scene, points, view)
        inside = dense_torch.in_tiles(centers, flat, view).flatten(1).any(1)
    radii = (inside & (points[:, 2] > near_plane)).int()[None, :, None].expand(1, -1, 2)
    seen = {
        "means2d": Centers(drawn.offsets), "radii": radii, "width": width, "height": height,
        "n_cameras": 1, "gaussian_ids": None,
    }  # fmt: skip
    return drawn.image[None], None, seen


class Centers:
    """Stands for a tensor (1, n, 2) of which only the gradient is asked."""

    def __init__(self, offsets) -> None:
        self.offsets = offsets

    def retain_grad(self) -> None:
        self.retained = True

    @property
    def grad(self):
        assert self.retained
        return self.offsets.grad[None]


class Idle:
    """A strategy that leaves the Gaussians as they are."""

    def __init__(self, **arguments: object) -> None:
        self.arguments = arguments

    def check_sanity(self, params, optimizers) -> None:
        assert params.keys() == optimizers.keys()

    def initialize_state(self, scene_scale: float = 1.0) -> dict[str, object]:
        return {"grad2d": None, "count": None}

    def step_pre_backward(self, params, optimizers, state, step, info) -> None:
        info["means2d"].retain_grad()

    def step_post_backward(self, params, optimizers, state, step, info, **more) -> None:
        assert more.keys() <= {"packed", "lr"}


def engine_of(default: object = Idle, mcmc: object = Idle, rasterization=dense_rasterization):
    from drsplat.training.gsplat_run import Engine
    from drsplat.training.gsplat_strategy import Strategies

    return Engine(rasterization, Strategies(default, mcmc), "cpu")


@pytest.fixture(scope="module")
def gsplat() -> ModuleType:
    with warnings.catch_warnings():  # of its optional CUDA build
        warnings.simplefilter("ignore")
        import gsplat
    return gsplat


@pytest.fixture(scope="module")
def gsplat_engine(gsplat) -> Iterator[object]:
    """gsplat's own strategies; the two functions of theirs that have only a CUDA kernel, in torch."""
    import torch
    from gsplat.cuda._torch_impl import _quat_scale_to_covar_preci
    from gsplat.strategy import ops

    from drsplat.training.mcmc import shared_place

    def relocation(opacities, scales, ratios, binoms):
        each, shrink = shared_place(opacities.detach().double().numpy(), ratios.numpy())
        shrunk = scales * torch.tensor(shrink, dtype=torch.float32)[:, None]
        return torch.tensor(each, dtype=torch.float32), shrunk

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ops, "compute_relocation", relocation)
        patch.setattr(ops, "quat_scale_to_covar_preci", _quat_scale_to_covar_preci)
        yield engine_of(gsplat.DefaultStrategy, gsplat.MCMCStrategy)


@pytest.fixture(scope="module")
def scene() -> ds.Gaussians:
    return known_scene(90)


@pytest.fixture(scope="module")
def views(scene, tmp_path_factory) -> list[ds.View]:
    small = [view.resized(48, 36) for view in ring(12)]
    return photographed(tmp_path_factory.mktemp("photos"), scene, small)


@pytest.fixture(scope="module")
def points(scene) -> SparsePoints:
    return perturbed_points(scene)


def fresh_run(kind, views, points, s: ds.TrainingSettings, **more):
    optimizer = Optimizer(first_gaussians(points, s))
    rng = np.random.default_rng(s.seed)
    return kind(Beginning(views, s, optimizer, rng), **more)


def device_run(views, points, s: ds.TrainingSettings, engine):
    from drsplat.training.gsplat_run import DeviceRun

    return fresh_run(DeviceRun, views, points, s, engine=engine)


@needs_torch
def test_on_a_device_left_out_pixels_see_no_gaussian_either(views, points, tmp_path):
    """The counts of density control are those of the CPU, but for Gaussians at the edge of what is seen."""
    Image.fromarray(np.repeat(np.uint8([[255] * 10 + [0] * 38]), 36, axis=0)).save(tmp_path / "mask.png")
    masked = [replace(view, mask_path=tmp_path / "mask.png") for view in views]
    quiet = replace(BUSY, refine_from=100)
    counts = []
    for some in (views, masked):
        there, here = device_run(some, points, quiet, engine_of()), fresh_run(Run, some, points, quiet)
        for _ in range(6):
            there.step()
            here.step()
        there.state()
        counts.append(there.density.times_seen.sum())
        assert counts[-1] == pytest.approx(here.density.times_seen.sum(), rel=0.05)
    assert counts[1] < 0.9 * counts[0]


@needs_torch
@pytest.mark.parametrize("masked", [False, True], ids=["unmasked", "masked"])
@pytest.mark.parametrize("distortion", [None, (0.3, 0.0, 0.0, 0.0)], ids=["whole", "with-edges"])
def test_without_refinement_the_run_is_that_of_the_cpu(views, points, distortion, masked, tmp_path, monkeypatch):
    """Same photos, coarse ones too, backgrounds, rates, edges and masks: the same losses, step for step."""
    quiet = replace(BUSY, refine_until=0, full_size_from=12, opacity_penalty=0.01)
    monkeypatch.setattr("drsplat.training.run.LEAST_SIDE", 12)  # the photos are small
    views = [replace(view, distortion=distortion) for view in views]
    if masked:
        Image.fromarray(np.repeat(np.uint8([[255] * 30 + [0] * 18]), 36, axis=0)).save(tmp_path / "mask.png")
        views = [replace(view, mask_path=tmp_path / "mask.png") for view in views]
    there, here = (device_run(views, points, quiet, engine_of()), fresh_run(Run, views, points, quiet))
    if distortion is not None:
        assert len(here.photos[0].outside) > 10
    for _ in range(15):
        assert there.step().loss == pytest.approx(here.step().loss, rel=2e-4)
    theirs = there.optimizer.parameters._asdict()
    for name, ours in here.optimizer.parameters._asdict().items():
        if name != "quats":  # of round Gaussians: the slope is rounding alone, and Adam's step its sign
            assert (np.abs(ours - theirs[name]) > 1e-3).mean() < 0.02, name


@needs_torch
def test_the_whole_of_train(views, points, tmp_path):
    from drsplat.training.gsplat_loop import train

    s = replace(BUSY, iterations=40, background="black", reset_every=1000, start_opacity=0.5, scales_rate=0.02)
    told: list[ds.Status] = []
    folder = tmp_path / "model"
    training = train(Job(views, s, folder, points, save_at=(20,), report=told.append), engine_of())
    assert [status.iteration for status in told] == list(range(1, 41))
    assert np.mean([t.loss for t in told[-9:]]) < 0.6 * np.mean([t.loss for t in told[:9]])
    assert told[-1].psnr > told[9].psnr
    assert np.isnan(told[8].psnr)
    assert training.evaluation is not None
    assert len(training.evaluation.views) == 3
    start = first_gaussians(points, s)
    untrained = ds.training.evaluation.evaluate(start, views[::4], TrainingPhotos(views[::4], 1 << 20), s)
    assert training.evaluation.psnr > untrained.psnr + 3
    results = json.loads((folder / "results.json").read_text())
    assert results["psnr_test"] == training.evaluation.psnr
    assert (results["iterations"], results["num_gaussians"]) == (40, 90)
    assert (folder / "checkpoint.safetensors").exists()  # a longer run goes on from it
    written = ds.read_gaussians(folder / "point_cloud/iteration_40/point_cloud.ply")
    assert_allclose(written.means, training.gaussians.means)
    assert (folder / "point_cloud/iteration_20/point_cloud.ply").is_file()
    assert len(list((folder / "test").iterdir())) == 3
    assert (folder / "cameras.json").is_file()


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"split_shrink": 2.0}, "split_shrink: gsplat has 1.6"),
        ({"max_screen_px": 20.0}, "max_screen_px"),
        ({"strategy": "mcmc", "max_gaussians": 100, "growth": 0.1}, "growth: gsplat has 0.05"),
    ],
)
@needs_torch
def test_what_gsplat_has_fixed_is_refused(views, points, changed, said):
    from drsplat.training.gsplat_loop import train

    with pytest.raises(InputError, match=said):
        train(Job(views, replace(BUSY, **changed), points=points), engine_of())


@needs_torch
def test_a_full_gpu_is_explained(views, points):
    import torch

    from drsplat.training.gsplat_loop import train

    def full(**arguments):
        raise torch.OutOfMemoryError("tried to allocate 3 GiB")

    with pytest.raises(ds.DrSplatError, match=r"full at 90 Gaussians.*max_gaussians.*3 GiB"):
        train(Job(views, BUSY, points=points), engine_of(rasterization=full))


@needs_torch
def test_a_loss_that_is_no_number_stops_the_run(views, points):
    run = device_run(views, points, BUSY, engine_of())
    run.scene.tensors["sh0"].data[:] = float("nan")
    with pytest.raises(ds.DrSplatError, match="iteration 1: the optimisation has left the finite numbers"):
        run.step()


@needs_torch
def test_tf32_is_off_in_a_run_and_back_after_it(views, points):
    import torch

    from drsplat.training.gsplat_loop import train

    seen = set()

    def watched(**arguments):
        seen.add(torch.backends.cudnn.allow_tf32)
        return dense_rasterization(**arguments)

    before = torch.backends.cudnn.allow_tf32
    train(Job(views, replace(BUSY, iterations=2), points=points), engine_of(rasterization=watched))
    assert seen == {False}
    assert torch.backends.cudnn.allow_tf32 == before


# --- gsplat itself --------------------------------------------------------------------------------


@needs_gsplat
def test_gsplat_takes_every_argument_we_pass(gsplat):
    from drsplat.training.gsplat_strategy import default_arguments, mcmc_arguments

    ours = inspect.signature(dense_rasterization).parameters
    assert ours.keys() <= inspect.signature(gsplat.rasterization).parameters.keys()
    defaults = inspect.signature(gsplat.DefaultStrategy).parameters
    assert default_arguments(BUSY).keys() <= defaults.keys()
    assert mcmc_arguments(CHAIN).keys() <= inspect.signature(gsplat.MCMCStrategy).parameters.keys()
    for kind, more in ((gsplat.DefaultStrategy, "packed"), (gsplat.MCMCStrategy, "lr")):
        taken = list(inspect.signature(kind.step_post_backward).parameters)
        assert taken == ["self", "params", "optimizers", "state", "step", "info", more]


@needs_gsplat
def test_our_defaults_are_those_of_gsplat(gsplat):
    from drsplat.training.gsplat_strategy import default_arguments, mcmc_arguments

    theirs = gsplat.DefaultStrategy()
    for name, value in default_arguments(ds.TrainingSettings()).items():
        assert getattr(theirs, name) == pytest.approx(value, rel=1e-6), name
    s = ds.TrainingSettings(strategy="mcmc", max_gaussians=1_000_000)
    for name, value in mcmc_arguments(s).items():
        assert getattr(gsplat.MCMCStrategy(), name) == value, name


@needs_gsplat
def test_density_control_grows_prunes_and_resets(gsplat_engine, views, points):
    run = device_run(views, points, BUSY, gsplat_engine)
    counts, most_opaque = [], []
    for _ in range(BUSY.iterations):
        run.step()
        counts.append(len(run.scene))
        most_opaque.append(float(run.scene.tensors["opacities"].detach().max()))
    changed = [i + 1 for i in range(1, len(counts)) if counts[i] != counts[i - 1]]
    assert set(changed) <= {5, 10, 15, 20}
    assert counts[-1] > 110
    ceiling = np.log(0.01 / 0.99)
    # after 9 and 18, seen when the next step has been taken
    falls = [i + 1 for i in range(1, len(counts)) if most_opaque[i] < most_opaque[i - 1] - 0.2]
    reset = [i for i in falls if most_opaque[i - 1] <= ceiling + 0.1]
    assert reset == [10, 19]


@needs_gsplat
def test_the_first_refinement_is_that_of_the_cpu(gsplat_engine, views, points):
    """The same Gaussians are cloned and split; the children's places are drawn elsewhere."""
    s = replace(BUSY, gradient_threshold=6e-4, dense_scale=0.03, reset_every=1000)
    there, here = device_run(views, points, s, gsplat_engine), fresh_run(Run, views, points, s)
    for _ in range(5):
        there.step()
        here.step()
    assert 95 < len(here.optimizer) < 175
    assert len(there.scene) == len(here.optimizer)


@needs_gsplat
def test_each_view_is_observed_once(gsplat, views, points):
    most_seen = []

    class Watched(gsplat.DefaultStrategy):
        def _grow_gs(self, params, optimizers, state, step):
            most_seen.append(float(state["count"].max()))
            return 0, 0

    run = device_run(views, points, BUSY, engine_of(Watched))
    for _ in range(10):
        run.step()
    assert most_seen == [5, 5]


@needs_gsplat
def test_the_budget_is_never_exceeded(gsplat_engine, views, points):
    run = device_run(views, points, replace(BUSY, max_gaussians=101), gsplat_engine)
    counts = [run.step() and len(run.scene) for _ in range(BUSY.iterations)]
    assert max(counts) == 101


@needs_gsplat
def test_the_chain_fills_its_budget(gsplat_engine, views, points):
    run = device_run(views, points, CHAIN, gsplat_engine)
    losses = [run.step().loss for _ in range(CHAIN.iterations)]
    counts = len(run.scene)
    assert 100 < counts <= 130
    assert np.mean(losses[-6:]) < np.mean(losses[:6])


@needs_gsplat
@pytest.mark.parametrize("settings", [BUSY, CHAIN], ids=["default", "mcmc"])
def test_a_run_goes_on_from_its_checkpoint(gsplat_engine, views, points, tmp_path, settings):
    """On CPU tensors to the bit."""
    import torch

    with _one_thread(torch):
        whole = device_run(views, points, settings, gsplat_engine)
        for _ in range(12):
            whole.step()
        save_checkpoint(tmp_path / "checkpoint.safetensors", whole, "capture")
        later = device_run(views, points, settings, gsplat_engine)
        load_checkpoint(tmp_path / "checkpoint.safetensors", later, "capture")
        for _ in range(10):
            whole.step()
            later.step()
    for name, array in whole.optimizer.state().items():
        assert_array_equal(later.optimizer.state()[name], array, err_msg=name)


@contextlib.contextmanager
def _one_thread(torch: ModuleType) -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@needs_gsplat
def test_a_run_may_move_between_devices(gsplat_engine, views, points, tmp_path: Path):
    there = device_run(views, points, BUSY, gsplat_engine)
    for _ in range(7):
        there.step()
    save_checkpoint(tmp_path / "checkpoint.safetensors", there, "capture")
    here = fresh_run(Run, views, points, BUSY)
    load_checkpoint(tmp_path / "checkpoint.safetensors", here, "capture")
    assert here.iteration == 7
    assert here.step().loss == pytest.approx(there.step().loss, rel=1e-4)
