"""Rendering with gradients, the photometric loss and the Adam step (native; float32).

Semantics of the forward pass are those of `kernels.splatting`; the backward pass takes the same
decisions: no gradient through the clamp at 0.99, the cut at 1/255 and the stop at 1e-4. Every function
is the same to the bit for any number of threads.
"""

from typing import NamedTuple

import numpy as np

from .. import _native
from ..base.arrays import Float32, Harmonics, Image, Numbers, PixelNumbers, Quats, Vectors
from ..errors import InputError
from ..scene.gaussians import PUBLISHED_NEAR
from ..scene.views import View
from .splats import camera_numbers, checked_isa

BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-15  # of Adam


class SceneParameters(NamedTuple):
    """Parameters of a scene before activation, as they are optimised: C-contiguous float32.

    quats: wxyz, of any length. log_scales: natural logarithms. logits: of the opacities.
    """

    means: Vectors
    log_scales: Vectors
    quats: Quats
    logits: Numbers
    sh: Harmonics


class Rates(NamedTuple):
    """Learning rate of each kind of parameter; sh of the constant term, sh_rest of all others."""

    means: float
    log_scales: float
    quats: float
    logits: float
    sh: float
    sh_rest: float


class HarmonicsStep(NamedTuple):
    """Adam's step of the harmonics, in place, to be taken on the way back; the arguments are those of `adam_step`.

    Coefficients beyond the pass's degree are left as they are. They have had no gradient and their moments are zero.
    """

    first_moment: Harmonics
    second_moment: Harmonics
    rate: float
    constant_rate: float
    step: int


class Gradients(NamedTuple):
    """Gradients dL/d(parameter) and what density control needs; all zero for unseen Gaussians.

    sh: empty, N x 0 x 3, where the harmonics took their step on the way back.
    screen: norm of dL/d(projected centre), with the image 2 units wide and high (3DGS's measure).
    radii: three standard deviations of the splat's longer axis, rounded up, in pixels.
    """

    means: Vectors
    log_scales: Vectors
    quats: Quats
    logits: Numbers
    sh: Harmonics
    screen: Numbers
    radii: Numbers


class Loss(NamedTuple):
    """Photometric loss, value = (1 - w) l1 + w (1 - ssim), and its gradient by the image."""

    value: float
    l1: float
    ssim: float
    gradient: Image


class TrainingView:
    """A forward pass, kept for its backward pass; change no parameter in between.

    image: RGB over the background. alpha: 1 - the transmittance that is left.
    """

    image: Image
    alpha: PixelNumbers

    def __init__(self, native: _native.TrainingPass, sh: Harmonics) -> None:
        self._native, self._sh, self._done = native, sh, False
        self.image, self.alpha = native.forward()

    def backward(self, image_gradient: Image, step: HarmonicsStep | None = None) -> Gradients:
        """Return the parameters' gradients, given the loss's gradient by the image; once for each forward pass.

        step: taken at once, which spares the memory of gradients that are four fifths of all.

        Raises: InputError: a gradient of another size than the image; moments of another; a second call.
        """
        if self._done:
            raise InputError("one backward pass for each forward pass: call forward again")
        if image_gradient.shape != self.image.shape:
            raise InputError(f"expected a gradient {self.image.shape}, got {image_gradient.shape}")
        if step is not None and any(moment.shape != self._sh.shape for moment in step[:2]):
            raise InputError(f"expected moments {self._sh.shape}, as the harmonics")
        self._done = True
        slope = np.ascontiguousarray(image_gradient)
        if step is None:
            return Gradients(*self._native.backward(self.image, slope))
        first, second, rate, constant_rate, count = step
        how = BETA1, BETA2, EPSILON, constant_rate
        return Gradients(*self._native.backward_and_step(self.image, slope, self._sh, first, second, rate, count, *how))

    @property
    def seconds(self) -> dict[str, float]:
        """Seconds by stage."""
        return dict(self._native.seconds)


def forward(
    parameters: SceneParameters,
    view: View,
    sh_degree: int,
    background: Float32[np.ndarray, "3"],
    *,
    near: float = PUBLISHED_NEAR,
    antialiased: bool = False,
    threads: int = 0,
    isa: str = "",
) -> TrainingView:
    """Render the scene as it stands, with SH coefficients up to `sh_degree` (0-3).

    near: camera z up to which nothing is drawn, scene units. antialiased: see `Gaussians`.

    Raises: InputError: a degree beyond what is stored; arrays that are not contiguous float32.
    Source: 3DGS Sec. 4-5.
    """
    active = (sh_degree + 1) ** 2
    if not 0 <= sh_degree <= 3 or active > parameters.sh.shape[1]:
        raise InputError(f"sh_degree {sh_degree}: {parameters.sh.shape[1]} coefficients are stored")
    for name, array in parameters._asdict().items():
        if array.dtype != np.float32 or not array.flags.c_contiguous:
            raise InputError(f"{name}: expected contiguous float32, got {array.dtype}")
    camera = camera_numbers(view, near), view.width, view.height
    behind = np.ascontiguousarray(background, np.float32)
    return TrainingView(
        _native.training_pass(*parameters, antialiased, *camera, active, behind, threads, checked_isa(isa)),
        parameters.sh,
    )


def photometric_loss(image: Image, target: Image, ssim_weight: float = 0.2, *, threads: int = 0, isa: str = "") -> Loss:
    """Return (1 - w) L1 + w (1 - SSIM); SSIM with a Gaussian window of 11, sigma 1.5, zeros outside.

    Raises: InputError: images of different sizes.
    Source: 3DGS Eq. 7; Wang et al. 2004.
    """
    if image.shape != target.shape or image.ndim != 3 or image.shape[2] != 3:
        raise InputError(f"expected two images (H, W, 3), got {image.shape} and {target.shape}")
    l1, ssim, gradient = _native.photometric_loss(
        np.ascontiguousarray(image), np.ascontiguousarray(target), ssim_weight, threads, checked_isa(isa)
    )
    return Loss((1 - ssim_weight) * l1 + ssim_weight * (1 - ssim), l1, ssim, gradient)


def adam_step(
    parameter: np.ndarray,
    gradient: np.ndarray,
    first_moment: np.ndarray,
    second_moment: np.ndarray,
    rate: float,
    step: int,
    *,
    beta1: float = BETA1,
    beta2: float = BETA2,
    epsilon: float = EPSILON,
    constant_rate: float | None = None,
    threads: int = 0,
    isa: str = "",
) -> None:
    """Take an Adam step in place: parameter and both moments change. step counts from 1.

    constant_rate: rate of the constant term (K = 0) of harmonics (N, K, 3).

    Raises: InputError: arrays that are not contiguous float32 of one shape; a constant_rate for anything but harmonics.
    Source: Kingma & Ba 2015, Algorithm 1.
    """
    arrays = (parameter, gradient, first_moment, second_moment)
    for array in arrays:
        if array.shape != parameter.shape or array.dtype != np.float32:
            raise InputError(f"expected float32 {parameter.shape}, got {array.dtype} {array.shape}")
        if not array.flags.c_contiguous:
            raise InputError("adam_step works in place: all arrays must be contiguous")
    if constant_rate is not None and (parameter.ndim != 3 or parameter.shape[2] != 3):
        raise InputError(f"constant_rate: expected harmonics (N, K, 3), got {parameter.shape}")
    flat = parameter, gradient.reshape(-1), first_moment, second_moment
    head: tuple[float, int] = (0.0, 0) if constant_rate is None else (constant_rate, 3 * parameter.shape[1])
    _native.adam_step(*flat, rate, step, beta1, beta2, epsilon, *head, threads, checked_isa(isa))
