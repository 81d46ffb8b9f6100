"""A GPU that is too full for a view: bands of it, and the same answer. Scenes that are on the device already."""

from importlib import import_module

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from captures_to_train import known_scene, ring
from cuda_on_cpu import CpuEngine, compiled
from drsplat.errors import DrSplatError, InputError
from drsplat.fronts.commands.options import Verb
from drsplat.fronts.commands.stages import verb_line
from drsplat.kernels import render_channels, splat_arrays, topk_contributions, view_weights
from drsplat.kernels.cuda.drawing import sent_splats
from drsplat.kernels.cuda.tensors import as_array, drawn_channels, splats_of_tensors
from drsplat.kernels.cuda.tiling import OutOfMemoryError


class SmallEngine(CpuEngine):
    """One that has room for so many pairs of splats and tiles."""

    def __init__(self, folder, room: int) -> None:
        super().__init__(folder)
        self.room, self.refused = room, 0

    def launch(self, kernel, blocks, threads, *arguments, shared_bytes=0):
        if kernel == "list_tiles" and len(arguments[8]) > self.room:
            self.refused += 1
            raise OutOfMemoryError("no room")
        super().launch(kernel, blocks, threads, *arguments, shared_bytes=shared_bytes)


@pytest.fixture(scope="module")
def folder():
    return compiled()


@pytest.fixture(scope="module")
def scene():
    return known_scene(200)


@pytest.fixture(scope="module")
def view():
    return ring(4)[1]


def pairs_of(folder, scene, view) -> int:
    engine = SmallEngine(folder, 1 << 30)
    seen = []
    launch = engine.launch
    engine.launch = lambda kernel, *rest, **more: (
        seen.append(len(rest[10])) if kernel == "list_tiles" else None,
        launch(kernel, *rest, **more),
    )
    render_channels(sent_splats(engine, splat_arrays(scene)), view, np.ones((len(scene), 1), np.float32))
    return seen[0]


@pytest.mark.slow
def test_bands_give_what_the_whole_view_gives(folder, scene, view):
    values = np.random.default_rng(0).random((len(scene), 2), np.float32)
    masks = np.kron(np.arange(12).reshape(3, 4) - 1, np.ones((24, 24))).astype(np.int32)[: view.height, : view.width]
    here = splat_arrays(scene)
    small = SmallEngine(folder, pairs_of(folder, scene, view) // 3)
    there = sent_splats(small, here)
    for name, draw in {
        "image": lambda splats: render_channels(splats, view, values),
        "weights": lambda splats: view_weights(splats, view, masks, 3),
        "largest": lambda splats: topk_contributions(splats, view, 3),
    }.items():
        small.refused = 0
        found, expected = draw(there), draw(here)
        assert small.refused >= 2, name
        for one, other in zip(found, expected, strict=True):
            assert_allclose(one, other, atol=1e-4, err_msg=name)
    whole = view_weights(sent_splats(CpuEngine(folder), here), view, masks, 3)
    assert_array_equal(view_weights(there, view, masks, 3).gaussian_ids, whole.gaussian_ids)


def test_a_gpu_without_room_for_a_row_says_so(folder, scene, view):
    there = sent_splats(SmallEngine(folder, 0), splat_arrays(scene))
    with pytest.raises(DrSplatError, match=r"memory is full, with 200 Gaussians and one row of tiles.*device 'cpu'"):
        render_channels(there, view, np.ones((len(scene), 1), np.float32))


def test_tensors_of_the_device_are_drawn_without_the_host(folder, scene, view):
    engine = CpuEngine(folder)
    tensors = scene.means, 3 * scene.quats, scene.scales, scene.opacities
    there = splats_of_tensors(*tensors, near=scene.near, engine=engine)
    values = np.random.default_rng(1).random((len(scene), 3), np.float32)
    image, _, _ = drawn_channels(there, view, as_array(values, engine), as_array(np.zeros(3, np.float32), engine))
    assert_allclose(image, render_channels(splat_arrays(scene), view, values).channels, atol=1e-4)
    assert as_array(values, engine).ctypes.data == values.ctypes.data  # shared, not copied


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: [t[0], t[1][:, :3], *t[2:]], r"expected means \(n, 3\), quats \(n, 4\).*\(200, 3\), \(200, 3\)"),
        (lambda t: ["means", *t[1:]], "expected a tensor on the GPU that speaks DLPack.*got str"),
    ],
)
def test_tensors_that_do_not_fit_are_refused(folder, scene, change, said):
    tensors = [scene.means, scene.quats, scene.scales, scene.opacities]
    with pytest.raises(InputError, match=said):
        splats_of_tensors(*change(tensors), near=0.2, engine=CpuEngine(folder))


LINES = {
    "register": ["scene", "capture", "--features", "features", "--output", "field"],
    "render": ["scene"],
    "evaluate": ["voxel", "data", "--scene", "room", "--report", "report"],
}


@pytest.mark.parametrize("verb", LINES)
def test_a_verb_that_draws_says_where(verb):
    command = import_module(f"drsplat.fronts.commands.{verb}")
    for device in ("cpu", "auto"):
        assert command.device(verb_line(verb, [*LINES[verb], "--device", device], []).options) == device


def test_the_command_line_draws_where_it_is_asked_to(monkeypatch):
    from drsplat import cli
    from drsplat.fronts.commands import inspect, register
    from drsplat.kernels.cuda import devices

    monkeypatch.setattr(devices, "unavailable", lambda: None)
    with cli._on_device(register, verb_line("register", [*LINES["register"], "--device", "cuda"], []).options):
        assert devices.device_in_use() == "cuda"
    assert devices.device_in_use() == "cpu"
    with cli._on_device(inspect, Verb()):
        assert devices.device_in_use() == "cpu"
