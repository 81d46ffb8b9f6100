"""Training by the CUDA kernels, which run on the CPU here: each against its float64 twin, whole runs against the CPU's.

The device that is chosen, and what is said where there is none.
"""

import json
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image
from test_gradients import (
    CASES,
    assert_gradients_agree,
    background_of,
    decisions_of,
    extreme_columns,
    image_gradient_of,
    random_scene,
    scene_of,
    slopes_of,
    twin_image,
    view_of,
)

import drsplat as ds
from captures_to_train import known_scene, perturbed_points, photographed, ring
from cuda_on_cpu import CpuEngine, compiled
from drsplat.errors import DrSplatError, InputError, MismatchError, MissingExtraError
from drsplat.formats.captures import SparsePoints
from drsplat.kernels import splat_arrays
from drsplat.kernels import training as kernels
from drsplat.kernels.cuda import devices
from drsplat.kernels.cuda import engine as engines
from drsplat.kernels.cuda import training as there
from drsplat.kernels.training import Rates
from drsplat.training import device_run
from drsplat.training.device_run import DeviceOptimizer, DeviceRun
from drsplat.training.keeper import load_checkpoint, save_checkpoint
from drsplat.training.optimizer import Optimizer
from drsplat.training.run import Beginning, Job, Run
from drsplat.training.start import first_gaussians
from twins import loss as reference_loss
from twins.registering import sh_basis

pytestmark = pytest.mark.filterwarnings("ignore:photos of 32x24 pixels")  # small, so that a run takes no time
NEAR = 0.2
RATES = Rates(1e-2, 5e-3, 1e-3, 5e-2, 2e-3, 1e-4)
BUSY = ds.TrainingSettings(
    iterations=16, refine_from=4, refine_every=5, reset_every=9, reset_recovery=2, sh_degree=2,
    sh_degree_every=4, background="random", test_every=4, gradient_threshold=4e-4,
)  # fmt: skip
CHAIN = replace(BUSY, strategy="mcmc", max_gaussians=80)
every_case = pytest.mark.parametrize("case", CASES)


def device_pass(engine, case: str) -> there.DevicePass:
    view = there.sent_view(engine, view_of(case), NEAR)
    given = scene_of(case), view, CASES[case].sh_degree, background_of(case)
    return there.forward(engine, *given, CASES[case].antialiased)


def with_harmonics(found: there.DeviceGradients, scene: kernels.SceneParameters, view: ds.View) -> kernels.Gradients:
    """Return gradients whose harmonics are written out: those of the colours times the basis."""
    directions = scene.means.astype(np.float64) - view.center
    basis = sh_basis(directions / np.linalg.norm(directions, axis=1, keepdims=True))[:, : scene.sh.shape[1]]
    basis[:, found.active :] = 0
    sh = (basis[:, :, None] * found.along[:, None]).astype(np.float32)
    return kernels.Gradients(*found[:4], sh, found.screen, found.radii)


# --- the image, its gradients, the loss, the step ---------------------------------------------------


@pytest.mark.slow
@every_case
def test_the_image_is_that_of_the_twin(cuda_engine_on_cpu, case):
    image = device_pass(cuda_engine_on_cpu, case).image
    sure = ~decisions_of(case).unsure
    assert_allclose(image[sure], twin_image(case, background_of(case))[sure], rtol=0, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["off-centre", "antialiased"])
def test_gradients_are_those_of_finite_differences(cuda_engine_on_cpu, case):
    found = device_pass(cuda_engine_on_cpu, case).backward(image_gradient_of(case))
    assert_gradients_agree(with_harmonics(found, scene_of(case), view_of(case)), slopes_of(case))


@every_case
def test_gradients_and_radii_are_those_of_the_native_kernels(cuda_engine_on_cpu, case):
    found = device_pass(cuda_engine_on_cpu, case).backward(image_gradient_of(case))
    given = scene_of(case), view_of(case), CASES[case].sh_degree, background_of(case)
    native = kernels.forward(*given, near=NEAR, antialiased=CASES[case].antialiased).backward(image_gradient_of(case))
    assert_gradients_agree(with_harmonics(found, scene_of(case), view_of(case)), native)
    assert (found.radii != native.radii).sum() <= 1  # a radius is rounded up


@pytest.mark.parametrize("active", [0, 1, 2])
def test_degrees_beyond_the_active_one_do_nothing(cuda_engine_on_cpu, active):
    scene, view = random_scene(60, 3, 3), there.sent_view(cuda_engine_on_cpu, view_of("black"), NEAR)
    cut = scene._replace(sh=np.ascontiguousarray(scene.sh[:, : (active + 1) ** 2]))
    full, short = (
        there.forward(cuda_engine_on_cpu, each, view, active, np.zeros(3, np.float32), False) for each in (scene, cut)
    )
    assert_array_equal(full.image, short.image)
    gradient = image_gradient_of("black")
    for one, other in zip(full.backward(gradient)[:7], short.backward(gradient)[:7], strict=True):
        assert_array_equal(one, other)


def test_a_pass_gives_the_same_bits_each_time(cuda_engine_on_cpu):
    first, second = (
        [drawn.image, *drawn.backward(image_gradient_of("inside"))[:7]]
        for drawn in (device_pass(cuda_engine_on_cpu, "inside") for _ in range(2))
    )
    for one, other in zip(first, second, strict=True):
        assert_array_equal(one, other)


@pytest.mark.parametrize("count", [0, 60])
def test_what_is_not_seen_has_no_gradient(cuda_engine_on_cpu, count):
    """No Gaussians at all, and those behind the camera."""
    scene = kernels.SceneParameters(*(column[:count].copy() for column in scene_of("outside")))
    away = ds.View("v", view_of("outside").K, view_of("outside").cam_from_world.copy(), 48, 40)
    away.cam_from_world[2, 3] -= 100
    background = np.float32([0.25, 0.5, 0.75])
    drawn = there.forward(
        cuda_engine_on_cpu, scene, there.sent_view(cuda_engine_on_cpu, away, NEAR), 0, background, False
    )
    assert_array_equal(drawn.image, np.broadcast_to(background, (40, 48, 3)))
    gradients = drawn.backward(np.ones((40, 48, 3), np.float32))
    assert [len(column) for column in gradients[:7]] == [count] * 7
    assert not any(column.any() for column in gradients[:7])


def test_extreme_parameters_give_finite_gradients(cuda_engine_on_cpu):
    view = view_of("black")
    columns = extreme_columns(view)
    parameters, sent = kernels.SceneParameters(*columns), there.sent_view(cuda_engine_on_cpu, view, NEAR)
    drawn = there.forward(cuda_engine_on_cpu, parameters, sent, 3, np.zeros(3, np.float32), False)
    assert np.isfinite(drawn.image).all()
    for name, column in zip(
        there.DeviceGradients._fields, drawn.backward(image_gradient_of("black"))[:7], strict=False
    ):
        assert np.isfinite(column).all(), name
        assert column.any(), name


def random_pictures(size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return an image and a photo's bytes; a third of the pixels are equal."""
    rng = default_rng(size[0])
    image, pixels = rng.random((*size, 3), np.float32), rng.integers(0, 256, (*size, 3), np.uint8)
    equal = rng.random(size) < 1 / 3
    image[equal] = pixels[equal] * np.float32(1 / 255)
    return image, pixels


def device_loss(engine, image: np.ndarray, photo: there.DevicePhoto, weight: float) -> there.DeviceLoss:
    return there.photometric_loss(engine, image, photo, weight, there.loss_window(engine))


@pytest.mark.slow
@pytest.mark.parametrize("size", [(5, 9), (16, 16), (21, 37)])
@pytest.mark.parametrize("weight", [0.0, 0.2, 1.0])
def test_the_loss_is_that_of_the_twin_and_of_the_native_kernels(cuda_engine_on_cpu, size, weight):
    image, pixels = random_pictures(size)
    found = device_loss(cuda_engine_on_cpu, image, there.DevicePhoto(pixels, None), weight)
    target = pixels * np.float32(1 / 255)
    for expected in (reference_loss.photometric_loss, kernels.photometric_loss):
        value = expected(image, target, weight)
        assert found.value() == pytest.approx(value.value, abs=1e-6)
        largest = np.abs(value.gradient).max()
        assert_allclose(found.gradient, value.gradient, rtol=1e-4, atol=1e-4 * largest)


def test_unused_pixels_are_their_own_target(cuda_engine_on_cpu):
    """So they are compared with what is drawn, and learn nothing."""
    image, pixels = random_pictures((21, 37))
    unused = default_rng(1).random((21, 37)) < 0.3
    target = pixels * np.float32(1 / 255)
    target[unused] = image[unused]
    expected = kernels.photometric_loss(image, target, 0.2)
    expected.gradient[unused] = 0
    found = device_loss(cuda_engine_on_cpu, image, there.DevicePhoto(pixels, unused.astype(np.uint8)), 0.2)
    assert found.value() == pytest.approx(expected.value, abs=1e-6)
    assert not found.gradient[unused].any()
    assert_allclose(found.gradient, expected.gradient, rtol=1e-4, atol=1e-4 * np.abs(expected.gradient).max())


@pytest.mark.slow
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_a_step_is_that_of_the_cpu(cuda_engine_on_cpu, degree):
    """Three steps with moments; coefficients beyond the active degree are stored, and rest."""
    view = view_of("black")
    sent = there.sent_view(cuda_engine_on_cpu, view, NEAR)
    device = DeviceOptimizer.sent(copied(Optimizer(random_scene(70, 1, 3))), cuda_engine_on_cpu)
    for step in (1, 2, 3):
        here = copied(device)
        drawn = there.forward(cuda_engine_on_cpu, device.parameters, sent, degree, np.zeros(3, np.float32), False)
        slopes = drawn.backward(image_gradient_of("black"))
        here.step(with_harmonics(slopes, here.parameters, view), RATES, step)
        device.step(slopes, RATES, step)
        for name, array in here.state().items():
            assert_allclose(device.state()[name], array, rtol=1e-4, atol=1e-6, err_msg=f"{step} {name}")
    beyond = (degree + 1) ** 2
    assert_array_equal(device.parameters.sh[:, beyond:], random_scene(70, 1, 3).sh[:, beyond:])
    assert (device.parameters.sh[:, :beyond] != random_scene(70, 1, 3).sh[:, :beyond]).any()


def copied(optimizer: Optimizer) -> Optimizer:
    return Optimizer.from_state(optimizer.state())


# --- whole runs ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scene() -> ds.Gaussians:
    return known_scene(60)


@pytest.fixture(scope="module")
def views(scene, tmp_path_factory) -> list[ds.View]:
    small = [view.resized(32, 24) for view in ring(8)]
    return photographed(tmp_path_factory.mktemp("photos"), scene, small)


@pytest.fixture(scope="module")
def points(scene) -> SparsePoints:
    return perturbed_points(scene)


def fresh_run(kind, views, points, s: ds.TrainingSettings, **more):
    optimizer = Optimizer(first_gaussians(points, s))
    return kind(Beginning(views, s, optimizer, default_rng(s.seed)), **more)


def both_runs(engine, views, points, s: ds.TrainingSettings) -> tuple[DeviceRun, Run]:
    return fresh_run(DeviceRun, views, points, s, engine=engine), fresh_run(Run, views, points, s)


def masked_views(views: list[ds.View], folder: Path, kept: int) -> list[ds.View]:
    """Return views of which the first `kept` columns of 32 are used."""
    Image.fromarray(np.repeat(np.uint8([[255] * kept + [0] * (32 - kept)]), 24, axis=0)).save(folder / "mask.png")
    return [replace(view, mask_path=folder / "mask.png") for view in views]


def assert_same_losses(device: DeviceRun, here: Run, steps: int, tolerance: float = 2e-4) -> None:
    for _ in range(steps):
        found, expected = device.step(), here.step()
        assert found.loss == pytest.approx(expected.loss, rel=tolerance)
        assert found.psnr() == pytest.approx(expected.psnr(), abs=0.02)
        assert len(device) == len(here)


@pytest.mark.slow
@pytest.mark.parametrize("masked", [False, True], ids=["unmasked", "masked"])
@pytest.mark.parametrize("distortion", [None, (0.3, 0.0, 0.0, 0.0)], ids=["whole", "with-edges"])
def test_a_run_is_that_of_the_cpu(cuda_engine_on_cpu, views, points, distortion, masked, tmp_path, monkeypatch):
    """Same photos, coarse ones too, backgrounds, rates, edges and masks: the same losses, step for step."""
    s = replace(BUSY, refine_until=0, full_size_from=8, opacity_penalty=0.01)
    monkeypatch.setattr("drsplat.training.run.MIN_SIDE_PIXELS", 6)  # the photos are small
    views = [replace(view, distortion=distortion) for view in views]
    if masked:
        views = masked_views(views, tmp_path, 20)
    device, here = both_runs(cuda_engine_on_cpu, views, points, s)
    if distortion is not None:
        assert here.photos[0].outside.sum() > 5
    assert_same_losses(device, here, 10)
    for name, ours in here.optimizer.parameters._asdict().items():
        if name != "quats":  # of round Gaussians: the slope is rounding alone, and Adam's step its sign
            assert (np.abs(ours - getattr(device.optimizer.parameters, name)) > 1e-3).mean() < 0.02, name


@pytest.mark.slow
@pytest.mark.parametrize("antialiased", [False, True])
def test_density_control_is_that_of_the_cpu(cuda_engine_on_cpu, views, points, antialiased):
    """Clones, splits and prunes at 5 and 10, a reset at 9; random places are the CPU's as well."""
    s = replace(BUSY, antialiased=antialiased)
    device, here = both_runs(cuda_engine_on_cpu, views, points, s)
    counts = []
    for _ in range(11):
        assert device.step().loss == pytest.approx(here.step().loss, rel=5e-3)
        counts.append(len(device))
        assert counts[-1] == pytest.approx(len(here), abs=2)
    assert counts[3] == 60
    assert counts[10] > counts[8] > 60


def test_the_chain_is_that_of_the_cpu(cuda_engine_on_cpu, views, points, monkeypatch):
    """With the CPU's noise, of which a device draws other numbers."""
    monkeypatch.setattr(DeviceOptimizer, "noise", Optimizer.noise)
    device, here = both_runs(cuda_engine_on_cpu, views, points, CHAIN)
    assert_same_losses(device, here, 11, tolerance=5e-3)
    assert 60 < len(device) <= 80


@pytest.mark.slow
def test_gaussians_that_only_left_out_pixels_show_are_not_seen(cuda_engine_on_cpu, views, points, tmp_path):
    """The counts of density control are those of the CPU."""
    counts = []
    for some in (views, masked_views(views, tmp_path, 7)):
        device, here = both_runs(cuda_engine_on_cpu, some, points, replace(BUSY, refine_from=100))
        for _ in range(5):
            device.step()
            here.step()
        assert_allclose(device.density.pull, here.density.pull, rtol=1e-2, atol=1e-7)
        assert np.abs(device.density.times_seen - here.density.times_seen).sum() <= 2
        counts.append(device.density.times_seen.sum())
    assert counts[1] < 0.9 * counts[0]


@pytest.mark.slow
@pytest.mark.parametrize("s", [BUSY, CHAIN], ids=["default", "mcmc"])
def test_a_run_may_move_between_devices(cuda_engine_on_cpu, views, points, tmp_path, s):
    """From the CPU to the device and back: each goes on where the other stopped, or the same one does."""
    path, runs = tmp_path / "checkpoint.safetensors", both_runs(cuda_engine_on_cpu, views, points, s)
    here, device = runs[1], runs[0]
    for last, following in ((here, device), (device, fresh_run(Run, views, points, s))):
        for _ in range(6):
            last.step()
        save_checkpoint(path, last, "{}")
        load_checkpoint(path, following, "{}")
        assert following.iteration == last.iteration
        for name, array in last.state()[0].items():
            assert_array_equal(following.state()[0][name], array, err_msg=name)
        again = fresh_run(type(last), views, points, s, **({"engine": cuda_engine_on_cpu} if last is device else {}))
        load_checkpoint(path, again, "{}")
        loss = last.step().loss
        assert again.step().loss == loss  # on the same device to the same bits
        assert following.step().loss == pytest.approx(loss, rel=1e-4)
        load_checkpoint(path, following, "{}")
    with pytest.raises(MismatchError, match="other settings"):
        load_checkpoint(path, fresh_run(DeviceRun, views, points, replace(s, seed=3), engine=cuda_engine_on_cpu), "{}")


@pytest.mark.slow
@pytest.mark.parametrize("room", [0, 3 * 32 * 24 * 3, 1 << 20])
def test_photos_that_do_not_fit_are_sent_each_time(views, points, room):
    """Whatever fits into a quarter of what is free: the losses are the same to the bit."""

    class Tight(CpuEngine):
        def free_bytes(self):
            return 4 * room

    run = fresh_run(DeviceRun, views, points, BUSY, engine=Tight(compiled()))
    losses = [run.step().loss for _ in range(3)]
    plenty = fresh_run(DeviceRun, views, points, BUSY, engine=CpuEngine(compiled()))
    assert losses == [plenty.step().loss for _ in range(3)]
    assert len(run.targets._kept) == min(room // (32 * 24 * 3), 3)


@pytest.mark.slow
def test_the_whole_of_train(cuda_engine_on_cpu, views, points, tmp_path):
    s = replace(BUSY, iterations=14, background="black", reset_every=1000, start_opacity=0.5, scales_rate=0.02)
    reports = []
    folder = tmp_path / "model"
    job = Job(views, s, folder, points, save_at=(10,), report=reports.append)
    training = device_run.train(job, cuda_engine_on_cpu)
    assert [status.iteration for status in reports] == list(range(1, 15))
    assert np.mean([status.loss for status in reports[-5:]]) < 0.9 * np.mean([status.loss for status in reports[:5]])
    assert np.isnan(reports[8].psnr)
    results = json.loads((folder / "results.json").read_text())
    assert results["psnr_test"] == training.evaluation.psnr
    assert (results["iterations"], results["num_gaussians"]) == (14, len(training.gaussians))
    written = ds.read_gaussians(folder / "point_cloud/iteration_14/point_cloud.ply")
    assert_allclose(written.means, training.gaussians.means)
    assert (folder / "point_cloud/iteration_10/point_cloud.ply").is_file()
    assert len(list((folder / "test").iterdir())) == 2
    here = ds.train(views, s, points=points, device="cpu")
    assert training.evaluation.psnr == pytest.approx(here.evaluation.psnr, abs=0.3)


def test_a_loss_that_is_no_number_stops_the_run(views, points):
    class Broken(CpuEngine):
        def launch(self, kernel, *rest, **more):
            super().launch(kernel, *rest, **more)
            if kernel == "draw_colors":
                rest[-1][5, 7] = np.nan

    run = fresh_run(DeviceRun, views, points, BUSY, engine=Broken(compiled()))
    with pytest.raises(DrSplatError, match="iteration 1: the optimisation has left the finite numbers"):
        run.step()


@pytest.mark.parametrize("name", kernels.SceneParameters._fields)
def test_parameters_that_are_no_numbers_stop_the_run(cuda_engine_on_cpu, views, points, monkeypatch, name):
    monkeypatch.setattr("drsplat.training.run.FINITE_CHECK_EVERY", 2)
    run = fresh_run(DeviceRun, views, points, BUSY, engine=cuda_engine_on_cpu)
    getattr(run.optimizer.parameters, name)[5] = np.nan
    with pytest.raises(DrSplatError, match=r"iteration [12]: the optimisation has left the finite numbers"):
        run.step() and run.step()


class OutOfMemoryError(Exception):
    """Named as CuPy's."""


def test_full_memory_is_explained(views, points, tmp_path):
    class Full(CpuEngine):
        def launch(self, kernel, *rest, **more):
            if kernel == "loss_gradient":
                raise OutOfMemoryError("tried to allocate 3 GiB")
            super().launch(kernel, *rest, **more)

    with pytest.raises(DrSplatError, match=r"full at 60 Gaussians, in iteration 1.*max_gaussians=N.*3 GiB"):
        device_run.train(Job(views, BUSY, points=points), Full(compiled()))


def test_a_gpu_without_room_for_the_start_says_so(views, points):
    class Numpy:
        def __getattr__(self, name):
            return getattr(np, name)

        def asarray(self, array):
            raise OutOfMemoryError("tried to allocate 3 GiB")

    full = CpuEngine(compiled())
    full.xp = Numpy()
    with pytest.raises(DrSplatError, match=r"full at 60 Gaussians, which are sent there: .*max_gaussians=N.*3 GiB"):
        device_run.train(Job(views, BUSY, points=points), full)


# --- the device that is chosen ---------------------------------------------------------------------


@pytest.fixture
def machine(monkeypatch):
    """One that has all, of which tests take away; what is remembered of this machine is forgotten meanwhile."""
    parts = SimpleNamespace(cupy=True, gpus=1, fault=None)

    def count():
        if parts.fault is not None:
            raise parts.fault
        return parts.gpus

    attributes = {"MaxSharedMemoryPerBlockOptin": 1 << 16}
    cupy = SimpleNamespace(
        cuda=SimpleNamespace(
            runtime=SimpleNamespace(getDeviceCount=count), Device=lambda: SimpleNamespace(attributes=attributes)
        )
    )
    monkeypatch.setattr(engines, "find_spec", lambda name: parts.cupy or None)
    monkeypatch.setattr(engines, "import_module", {"cupy": cupy}.__getitem__)
    for cached in (engines.unavailable, engines.cuda_engine):
        cached.cache_clear()
    yield parts
    for cached in (engines.unavailable, engines.cuda_engine):
        cached.cache_clear()


def test_auto_is_cuda_where_cupy_and_a_gpu_are(machine):
    assert engines.unavailable() is None
    assert devices.chosen_device("auto") == devices.chosen_device("cuda") == "cuda"
    assert devices.chosen_device("cpu") == "cpu"
    assert engines.cuda_engine().shared_bytes == 1 << 16


@pytest.mark.parametrize(
    ("absent", "said"),
    [
        ({"cupy": False}, r'CuPy, which is not installed: pip install .*\[cuda\]"'),
        ({"gpus": 0}, "CuPy finds no GPU: check nvidia-smi"),
        ({"fault": RuntimeError("driver is too old")}, r"CuPy finds no GPU \(driver is too old\)"),
    ],
)
def test_what_is_absent_is_said_with_the_cure(machine, tmp_path, absent, said):
    vars(machine).update(absent)
    assert devices.chosen_device("auto") == "cpu"
    for use in (
        lambda: devices.chosen_device("cuda"),
        engines.cuda_engine,
        lambda: ds.train([], None, tmp_path / "model", device="cuda"),
        lambda: device_run.train(Job([], output_dir=tmp_path / "model")),
    ):
        with pytest.raises(MissingExtraError, match=said) as caught:
            use()
        assert "device 'cpu'" in str(caught.value)
    assert not (tmp_path / "model").exists()


def test_a_device_that_does_not_exist_is_refused():
    with pytest.raises(InputError, match=r"device: expected one of .*'cuda'.*, got 'tpu'"):
        devices.chosen_device("tpu")


def test_a_device_is_used_within_its_block(machine, cuda_engine_on_cpu, monkeypatch, scene):
    monkeypatch.setattr(devices, "cuda_engine", lambda: cuda_engine_on_cpu)
    assert devices.device_in_use() == "cpu"
    with devices.using_device("auto") as chosen:
        assert chosen == devices.device_in_use() == "cuda"
        assert splat_arrays(scene).engine is cuda_engine_on_cpu
        with devices.using_device("cpu"):
            assert splat_arrays(scene).engine is None
        assert devices.device_in_use() == "cuda"
    with pytest.raises(ZeroDivisionError), devices.using_device("cuda"):
        _ = 1 / 0
    assert devices.device_in_use() == "cpu"
    assert splat_arrays(scene).engine is None


# --- noise ----------------------------------------------------------------------------------------


def philox(counter: int, low: int, high: int) -> list[int]:
    """Philox 4x32-10 as its paper has it."""
    x, key = [counter, 0, 0, 0], [low, high]
    for _ in range(10):
        a, b = x[0] * 0xD2511F53, x[2] * 0xCD9E8D57
        x = [(b >> 32) ^ x[1] ^ key[0], b & 0xFFFFFFFF, (a >> 32) ^ x[3] ^ key[1], a & 0xFFFFFFFF]
        key = [(key[0] + 0x9E3779B9) & 0xFFFFFFFF, (key[1] + 0xBB67AE85) & 0xFFFFFFFF]
    return x


def test_noise_is_that_of_philox(cuda_engine_on_cpu):
    assert philox(0, 0, 0) == [0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8]  # the known answer of its authors
    low, high = (int(word) for word in default_rng(3).integers(1 << 32, size=2))
    drawn = there.normals(cuda_engine_on_cpu, default_rng(3), 5).ravel()
    for place in range(0, 14, 2):
        first, second = ((word >> 8) + 0.5 for word in philox(place // 4, low, high)[place % 4 : place % 4 + 2])
        length, angle = math.sqrt(-2 * math.log(first / 2**24)), 2 * math.pi * second / 2**24
        assert_allclose(drawn[place : place + 2], [length * math.cos(angle), length * math.sin(angle)], atol=2e-6)
