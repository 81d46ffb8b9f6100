"""Posed photos -> a scene of Gaussians: the optimisation of 3DGS, on a CPU or a GPU, and the points it starts from.

Begin with `loop` and `run`.

Imports `scene`, `formats`, `kernels`, `photos` and `drawing`.
"""

from .devices import everyday, train
from .run import Status, Training
from .settings import TrainingSettings

__all__ = ["Status", "Training", "TrainingSettings", "everyday", "train"]
