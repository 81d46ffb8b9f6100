"""A scene together with what was found in it: what an exported file carries besides Gaussians.

Texts that people wrote at points and boxes of a scene.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..base.arrays import Arrays, Embedding, Ids, Matrix3, Numbers, Vector3
from ..errors import InputError
from .gaussians import Gaussians
from .moving import Moving
from .views import View

MAX_TEXT_CHARACTERS = 200
MAX_COORDINATE = 1e30
ORTHONORMAL_TOLERANCE = 1e-4  # of the axes' lengths and right angles


class Outline(NamedTuple):
    """A box's directions and lengths: row a of axes is the unit direction of the full length extent[a]."""

    axes: Matrix3
    extent: Vector3


@dataclass(frozen=True, eq=False)
class Annotation:
    """A text at a place of the world: at a point, or at a box about it, in scene units.

    outline: of the box, None for a point.

    Raises: InputError: a text that is empty, too long or cannot be written; numbers that are not finite; axes that are
    not at right angles, lengths that are not above 0.
    """

    text: str
    center: Vector3
    outline: Outline | None = None

    @classmethod
    def at(cls, text: str, point: Sequence[int | float] | Vector3) -> "Annotation":
        """Annotate a point."""
        return cls(text.strip(), np.asarray(point, np.float64))

    @classmethod
    def box(
        cls, text: str, center: Vector3, axes: Matrix3,
        extent: Vector3,
    ) -> "Annotation":  # fmt: skip
        """Annotate the box of a match or of an object."""
        return cls(text.strip(), center, Outline(axes, extent))

    def __post_init__(self) -> None:
        writable = self.text == self.text.encode(errors="ignore").decode()
        if not writable or not self.text.strip() or len(self.text) > MAX_TEXT_CHARACTERS:
            raise InputError(
                f"an annotation: expected a text of 1 to {MAX_TEXT_CHARACTERS} characters, got {self.text!a:.80}"
            )
        if self.center.shape != (3,) or not (np.abs(self.center) <= MAX_COORDINATE).all():
            raise InputError(f"annotation '{self.text}': expected a place of three finite numbers")
        if self.outline is None:
            return
        axes, extent = self.outline
        if not ((extent > 0) & (extent <= MAX_COORDINATE)).all():
            raise InputError(f"annotation '{self.text}': expected a box of finite lengths above 0")
        if not np.abs(axes @ axes.T - np.eye(3)).max() <= ORTHONORMAL_TOLERANCE:
            raise InputError(f"annotation '{self.text}': expected axes of length one at right angles")


PLY_UP = (0.0, -1.0, 0.0)  # a scene of COLMAP's poses, whose y points down where nothing else is known


@dataclass(frozen=True, eq=False)
class Thing:
    """A named box of the world: an object, a group of objects, or a match of a query.

    name: a label, the word that the encoder is sure of, or "object 7". score: how far photos agree on an object, from 0
    to 1, or the relevancy of a match. center, extent: scene units; axes: rows are the box's unit directions, and
    extent[a] is its full length along axes[a]. parent: the group that it is in, as a number of `LabelledScene.groups`,
    -1 for none. embedding: unit vector of the scene's encoder, where it goes along. number: of the object in the field,
    as `drsplat objects` counts; -1 where it is none.

    Raises: InputError: a box or a score that is not finite, or of another shape.
    """

    name: str
    score: float
    center: Vector3
    axes: Matrix3
    extent: Vector3
    parent: int = -1
    embedding: Embedding | None = None
    number: int = -1

    def __post_init__(self) -> None:
        for name, shape in (("center", (3,)), ("axes", (3, 3)), ("extent", (3,))):
            value = getattr(self, name)
            if value.shape != shape or not np.isfinite(value).all():
                raise InputError(f"'{self.name}': {name}: expected finite numbers of shape {shape}, got {value}")
        if not np.isfinite(self.score):
            raise InputError(f"'{self.name}': score: expected a finite number, got {self.score}")


@dataclass(frozen=True, eq=False)
class LabelledScene:
    """Gaussians with their objects, the answer to a query, and annotations, ready to be written in any format.

    object_of: number of each Gaussian's object in `things`, -1 for none; None where no objects are known. relevancy: of
    each Gaussian to `query`; None without a query. up: unit direction that is up, in the world. encoder: name of the
    encoder of the embeddings. num_edits: edits of the scene's own file that are done in it. views: photos that go
    along. motion: of the same rows, of which `gaussians` are those of the first time; None where one time is written.

    Raises: InputError: lengths that disagree, or an object of a number that there is not.
    """

    gaussians: Gaussians
    title: str = "scene"
    things: tuple[Thing, ...] = ()
    groups: tuple[Thing, ...] = ()
    object_of: Ids | None = None
    query: str = ""
    relevancy: Numbers | None = None
    matches: tuple[Thing, ...] = ()
    annotations: tuple[Annotation, ...] = ()
    up: tuple[float, float, float] = PLY_UP
    encoder: str = ""
    num_edits: int = 0
    views: tuple[View, ...] = ()
    motion: Moving | None = None

    def __post_init__(self) -> None:
        for name, column in (("object_of", self.object_of), ("relevancy", self.relevancy)):
            if column is not None and column.shape != (len(self.gaussians),):
                raise InputError(f"{name}: expected {len(self.gaussians):,} numbers, got an array {column.shape}")
        if self.motion is not None and len(self.motion) != len(self.gaussians):
            raise InputError(
                f"motion: {len(self.motion):,} Gaussians move and {len(self.gaussians):,} are written: of a part, or "
                "after edits, a file holds one time: pass time=T"
            )
        if self.object_of is not None and not ((self.object_of >= -1) & (self.object_of < len(self.things))).all():
            raise InputError(f"object_of: expected numbers from -1 to {len(self.things) - 1}, which things there are")

    @property
    def object_numbers(self) -> Ids | None:
        """The number of each Gaussian's object as `drsplat objects` counts, -1 for none; None without objects."""
        if self.object_of is None:
            return None
        return np.array([*numbers_of(self.things), -1], np.int32)[self.object_of]

    @property
    def columns(self) -> Arrays:
        """The number of each Gaussian's object and its relevancy, as far as they are known, as columns of a file."""
        columns = {"object_id": self.object_numbers, "relevancy": self.relevancy}
        return {name: column for name, column in columns.items() if column is not None}


def numbers_of(things: Sequence[Thing]) -> list[int]:
    """Return the number of each thing, its place where it has none."""
    return [place if thing.number < 0 else thing.number for place, thing in enumerate(things)]


def places_of(numbers: np.ndarray, things: Sequence[Thing]) -> Ids | None:
    """Return the place in `things` of the object of each Gaussian, -1 for none, by the objects' numbers.

    None: there is a number that no object has.
    """
    place_of = {number: place for place, number in enumerate(numbers_of(things))} | {-1: -1}
    known, which = np.unique(numbers, return_inverse=True)
    if not {*known.tolist()} <= place_of.keys():
        return None
    return np.array([place_of[number] for number in known.tolist()], np.int32)[which]
