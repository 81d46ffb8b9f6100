"""CUDA kernels of our own, compiled at first use for the GPU at hand: no nvcc, no torch; extra `[cuda]`.

`engine`: CuPy and the kernels. `sorting`, `tiling`: splats of each tile, front to back. `drawing`: images and blending
weights. `training`: gradients, loss and Adam's steps. `scanning`: search in codes. Sources are the `.cuh` files beside
these modules; the native kernels are the reference that each is held to. `using_device` says where scenes are drawn:

    with using_device("cuda"):
        registration = register(gaussians, views, features)
"""

from .devices import using_device

__all__ = ["using_device"]
