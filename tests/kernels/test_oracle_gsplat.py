"""The twin's projection and colours against an oracle of other hands: gsplat's PyTorch functions.

gsplat clamps the Jacobian to the raster plus 0.3 tan(fov / 2) on each side, we (as 3DGS) to
+-1.3 tan(fov / 2): the same for a centred principal point, and otherwise inside both.
"""

import importlib.util
import warnings
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drsplat.kernels import sh_colors, splat_arrays
from drsplat.scene.gaussians import PUBLISHED_NEAR, Gaussians
from drsplat.scene.views import View
from scenes import look_at_view, random_gaussians
from twins import registering as reference
from twins.projection import BLUR, project

missing = [name for name in ("torch", "gsplat") if importlib.util.find_spec(name) is None]
pytestmark = [pytest.mark.oracle, pytest.mark.skipif(bool(missing), reason=f"the oracle needs {' and '.join(missing)}")]

VIEWS = {
    "outside": look_at_view((0, -6, 1), width=160, height=112),
    "inside": look_at_view((0.1, 0.2, 0), (1, 0.3, 0.1), width=160, height=112, fov_degrees=90),
    "off-centre": look_at_view((4, -4, 3), width=161, height=97, principal=(60.0, 70.0)),
}


@pytest.fixture(scope="module")
def gsplat() -> ModuleType:
    with warnings.catch_warnings():  # of its optional CUDA build
        warnings.simplefilter("ignore")
        from gsplat.cuda import _torch_impl
    return _torch_impl


def tensor(array: np.ndarray):
    import torch

    return torch.from_numpy(np.ascontiguousarray(array, np.float32))


def gsplat_projection(gsplat: ModuleType, gaussians: Gaussians, view: View) -> SimpleNamespace:
    covariances, _ = gsplat._quat_scale_to_covar_preci(
        tensor(gaussians.quats), tensor(gaussians.scales), compute_preci=False
    )
    _, centers, depths, conics, _ = gsplat._fully_fused_projection(
        tensor(gaussians.means),
        covariances,
        tensor(view.cam_from_world[None]),
        tensor(view.K[None]),
        view.width,
        view.height,
        eps2d=BLUR,
        near_plane=PUBLISHED_NEAR,
    )
    arrays = (column[0].numpy() for column in (centers, depths, conics))
    return SimpleNamespace(**dict(zip(("centers", "depths", "conics"), arrays, strict=True)))


def in_both_clamps(gaussians: Gaussians, view: View) -> np.ndarray:
    """True where neither gsplat nor 3DGS moves the point at which the Jacobian is taken."""
    points = gaussians.means @ view.cam_from_world[:3, :3].T + view.cam_from_world[:3, 3]
    slopes = points[:, :2] / points[:, 2:]
    size, focal = np.array([view.width, view.height]), view.K[[0, 1], [0, 1]]
    beyond, principal = 0.3 * 0.5 * size / focal, view.K[:2, 2]
    low = np.maximum(-principal / focal, -0.5 * size / focal) - beyond
    high = np.minimum((size - principal) / focal, 0.5 * size / focal) + beyond
    return ((low < slopes) & (slopes < high)).all(axis=1)


def test_covariances_agree(gsplat):
    """To a few float32 roundings of the trace; theirs is computed in float32, ours in float64."""
    gaussians = random_gaussians(3000, 1)
    theirs, _ = gsplat._quat_scale_to_covar_preci(
        tensor(gaussians.quats), tensor(gaussians.scales), compute_preci=False, triu=True
    )
    ours = gaussians.covariances()
    size = ours[:, [0, 3, 5]].sum(axis=1, keepdims=True)
    assert_allclose(theirs.numpy() / size, ours / size, rtol=0, atol=2e-6)


@pytest.mark.parametrize("name", VIEWS)
@pytest.mark.parametrize("seed", [0, 1])
def test_projections_agree(gsplat, name, seed):
    """Within twice the float32 error that the twin itself predicts, and closely in the median."""
    gaussians, view = random_gaussians(3000, seed), VIEWS[name]
    theirs, ours = (gsplat_projection(gsplat, gaussians, view), project(splat_arrays(gaussians), view))
    ids = ours.ids
    assert len(ids) > 1000
    assert (np.abs(theirs.depths[ids] - ours.depths) <= 2 * ours.depth_error).all()
    assert (np.abs(theirs.centers[ids] - ours.centers) <= 2 * ours.center_error).all()

    shared = np.ones(len(ids), bool) if name != "off-centre" else in_both_clamps(gaussians, view)[ids]
    assert shared.sum() > 1000
    error, size = relative_conic_errors(theirs.conics[ids], ours.conics)
    predicted = (ours.covariance_error * size + 1e-6) * ours.cancellation
    assert (error <= predicted)[shared].all()
    assert np.median(error[shared]) < 5e-7


def relative_conic_errors(theirs: np.ndarray, ours: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Largest entry of the difference over the largest entry, and that entry."""
    size = np.abs(ours).max(axis=1)
    return np.abs(theirs - ours).max(axis=1) / size, size


def test_the_clamps_agree_far_outside_the_image(gsplat):
    gaussians = random_gaussians(3000, 2, extent=8.0)
    view = VIEWS["inside"]
    ours, theirs = (project(splat_arrays(gaussians), view), gsplat_projection(gsplat, gaussians, view))
    outside = ~in_both_clamps(gaussians, view)[ours.ids]
    assert outside.sum() > 300
    error, _ = relative_conic_errors(theirs.conics[ours.ids], ours.conics)
    assert np.median(error[outside]) < 1e-6
    assert np.quantile(error[outside], 0.99) < 1e-3


@pytest.mark.parametrize("degree", range(4))
def test_colors_agree(gsplat, degree):
    gaussians = random_gaussians(2000, degree, sh_degree=degree)
    center = np.array([0.5, -3.0, 1.0])
    directions = tensor(gaussians.means - center.astype(np.float32))
    theirs = gsplat._spherical_harmonics(degree, directions, tensor(gaussians.sh)).numpy()
    theirs = np.maximum(0, theirs + 0.5)
    assert_allclose(reference.sh_colors(gaussians.sh, gaussians.means, center), theirs, atol=3e-6)
    assert_allclose(sh_colors(gaussians.sh, gaussians.means, center), theirs, atol=3e-6)
