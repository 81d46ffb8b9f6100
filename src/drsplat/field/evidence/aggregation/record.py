"""Record of a field's aggregator, and its JSON."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from ....base.arrays import MaskIds
from ....errors import FormatError, InputError
from ....formats.json_files import as_kind
from ....kernels import SplatArrays, Triples, view_weights
from ....scene.views import View


@dataclass(frozen=True)
class Sampling:
    """Settings of W. topk None: all contributors of a pixel. first_hits: only the first ones of each ray.

    near: camera z up to which nothing is seen, scene units; None: the scene's own (`Gaussians.near`).
    pixels: "all" adds up the pixels of a mask. "centre" is in records only, of W that others made of the pixels
    that hold the Gaussians' centres; a subclass whose `triples` does so can be registered with.

    Raises: InputError: another kind of pixels; topk or first_hits less than 1; a near plane that is not in
    front of the camera.
    """

    topk: int | None = 40
    first_hits: int | None = None
    pixels: Literal["all", "centre"] = "all"
    near: float | None = None

    def __post_init__(self) -> None:
        if self.pixels not in ("all", "centre"):
            raise InputError(f"pixels: expected 'all' or 'centre', got {self.pixels!r}")
        for name, value in (("topk", self.topk), ("first_hits", self.first_hits)):
            if value is not None and value < 1:
                raise InputError(f"{name}: expected a positive integer, or None for all; got {value}")
        if self.near is not None and not 0 < self.near < np.inf:
            raise InputError(f"near: expected a distance in front of the camera, got {self.near}")

    def triples(self, splats: SplatArrays, view: View, mask_ids: MaskIds, threads: int = 0) -> Triples:
        """Return the entries of W of one view. Raises: InputError: `pixels` is not "all"."""
        if self.pixels != "all":
            raise InputError(f"pixels: only all of them can be registered, not '{self.pixels}'")
        return view_weights(splats, view, mask_ids, self.topk, first_hits=self.first_hits, threads=threads)


@dataclass(frozen=True)
class AggregatorRecord:
    """Record of an aggregator: its name, the parameters of its steps, and the sampling of W where it is known."""

    name: str = "mean"
    parameters: Mapping[str, int | float] = field(default_factory=dict)
    sampling: Sampling | None = None


MEAN_RECORD = AggregatorRecord()


def record_from_json(document: object, where: str) -> AggregatorRecord:
    """Return the record of a document, as `dataclasses.asdict` makes it of one.

    Raises: FormatError: the document is no such record.
    """
    try:
        return as_kind(document, AggregatorRecord, f"{where}: aggregator")  # type: ignore[no-any-return]
    except InputError as error:  # of the sampling
        raise FormatError(f"{where}: aggregator: {error}") from None
