"""Posed photos -> a scene of Gaussians: the optimisation of 3DGS, on a CPU.

Imports `scene`, `formats`, `kernels`, `drawing` and `triangulation`.
"""

from .devices import train
from .everyday import everyday
from .job import Status
from .result import Training
from .settings import TrainingSettings

__all__ = ["Status", "Training", "TrainingSettings", "everyday", "train"]
