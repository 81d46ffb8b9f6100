"""Parts of an opened scene: a field, its Gaussians, photos, names and objects. `Scene` asks them."""

from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from ..base.arrays import Flags, Ids, Vector3
from ..errors import InputError, MissingExtraError, did_you_mean
from ..field import LanguageField
from ..field.labels import Label, LabelFile, Matched, matched
from ..field.objects.agreed import agreed
from ..field.objects.surfaces import surfaces
from ..formats.georeference import Georeference
from ..formats.tiles import Tiles
from ..kernels import SplatArrays, splat_arrays
from ..scene.boxes import up_of
from ..scene.encoders import Encoder
from ..scene.gaussians import Gaussians
from ..scene.moving import Moving, canonical_of
from ..scene.parted import AnyGaussians, middle
from ..scene.views import View
from .answer import Match
from .encoding import source_of
from .measuring import Background
from .naming import doubt_of, object_names
from .objects import match_of, objects_of

if TYPE_CHECKING:
    from .seen import Seen


class Held:
    """The parts of a `Scene`, read when they are first needed; see there."""

    def __init__(
        self,
        field: LanguageField,
        gaussians: Gaussians | Moving | Tiles | None = None,
        views: Sequence[View] | Callable[[], Sequence[View]] = (),
        encoder: Encoder | Callable[[], Encoder] | None = None,
        *,
        name: str = "scene",
        threads: int = 0,
        labels: LabelFile | None = None,
        path: Path | None = None,
        georeference: Callable[[], Georeference | None] | None = None,
    ) -> None:
        self.tiles = gaussians if isinstance(gaussians, Tiles) else None
        self._rows = _rows_of(gaussians)
        if self._rows is not None:
            field.check_scene(self._rows)
        self.label_file, self.path = labels, path
        self.field, self.name, self.threads = field, name, threads
        self.motion = gaussians if isinstance(gaussians, Moving) else None
        self._views, self._georeference = views, georeference
        self.background = Background(field, source_of(field, encoder), threads)
        self.kept: dict[tuple[str, object], Any] = {}  # of times and spans that were asked for last

    def __repr__(self) -> str:
        return f"Scene('{self.name}', {self._rows or 'no Gaussians'}, {self.field})"

    @property
    def has_gaussians(self) -> bool:
        """True where the scene has Gaussians, so that matches can be located and pictures drawn."""
        return self._rows is not None

    @property
    def rows(self) -> AnyGaussians:
        """The Gaussians to ask for by their rows, in memory or on disk.

        Raises: InputError: the scene was opened without them.
        """
        if self._rows is None:
            raise InputError(
                f"'{self.name}' was opened without its Gaussians: pass scene=SCENE, the file that was registered"
            )
        return self._rows

    @cached_property
    def gaussians(self) -> Gaussians:
        """All Gaussians in memory, those of tiles read when this is first asked for; queries need only `rows`.

        Raises: InputError: the scene was opened without them. FormatError: a tile is damaged or missing.
        """
        rows = self.rows
        return rows if isinstance(rows, Gaussians) else cast("Tiles", self.tiles).gaussians()

    @cached_property
    def views(self) -> tuple[View, ...]:
        return tuple(self._views() if callable(self._views) else self._views)

    @cached_property
    def georeference(self) -> Georeference | None:
        """The scene's place on the Earth, None where nobody has told it. Raises: FormatError: its file is damaged."""
        return None if self._georeference is None else self._georeference()

    @property
    def encoder(self) -> Encoder:
        """Raises: InputError: none is known for this field; the message says what to give."""
        return self.background.encoder

    @cached_property
    def up(self) -> Vector3 | None:
        """The unit direction that is up, None where the photos do not tell."""
        return up_of(self.views) if self.field.up is None else self.field.up

    @cached_property
    def splats(self) -> SplatArrays:
        """The Gaussians as the renderer takes them, made once."""
        return splat_arrays(self.gaussians)

    @cached_property
    def box(self) -> tuple[Vector3, Vector3]:
        """Lowest and highest corner of the box of the middle 98 % of the Gaussians, along the world's axes."""
        low, high = middle(self.rows, (0.01, 0.99), origin=self.rows.origin)
        return low, high

    def seen(self, view: View) -> "Seen":
        """Return what a view may see: some tiles of a scene on disk, all of one in memory.

        Raises: InputError: the scene was opened without its Gaussians. FormatError: a tile is damaged or missing.

        >>> len(scene.seen(scene.views[0]).gaussians)
        300
        """
        from .seen import Seen, seen_of_tiles

        return Seen(self.gaussians, self.splats) if self.tiles is None else seen_of_tiles(self.tiles, view)

    @property
    def objects(self) -> list[Match]:
        """All objects, number 0 with the largest mass first; their score says how far the photos agree on them.

        Raises: InputError: the field has none.
        """
        labels = self.labels.by_node
        return [
            match_of(self.field, node, labels[node].name if node in labels else None)
            for node in objects_of(self.field).things.tolist()
        ]

    @property
    def agreed(self) -> Flags:
        """True for each object, by number, that photos agree on or people named: those that are shown first.

        Raises: InputError: the field has no objects.
        """
        objects, named = objects_of(self.field), self.labels.by_node
        labelled = np.array([node in named for node in objects.things.tolist()], np.bool_)
        return agreed(objects.sure[objects.things], objects.num_views[objects.things]) | labelled

    @cached_property
    def surfaces(self) -> list[bool] | None:
        """True for each object, by number, that is a surface such as a floor; None without Gaussians.

        Raises: InputError: the field has no objects.
        """
        if self._rows is None:
            return None
        low, high = self.box
        return surfaces(self.object_ids(), len(self.objects), self._rows, float(np.linalg.norm(high - low)))

    def object_names(self, nodes: Sequence[int] | None = None, words: Sequence[str] = ()) -> list[str | None]:
        """Return the word that the encoder is sure of for each object, or each of some nodes, else None.

        words: to choose from; where there are none, those of an encoder that knows a list.

        >>> scene.object_names(words=["red mug", "blue plate"])
        ['red mug', 'blue plate']
        """
        chosen = objects_of(self.field).things.tolist() if nodes is None else nodes
        try:
            return object_names(self.encoder, self.field, chosen, words)
        except (InputError, MissingExtraError):  # nobody embeds words here
            return [None] * len(chosen)

    @property
    def doubt(self) -> str:
        """Reason not to rely on names of things here, "" if there is none or no encoder embeds words."""
        try:
            return doubt_of(self.encoder, self.field)
        except (InputError, MissingExtraError):
            return ""

    def object_ids(self) -> Ids:
        """Return per Gaussian of the scene its object's number, -1: none. Raises: InputError: the field has none.

        >>> np.unique(scene.object_ids()).tolist()
        [0, 1]
        """
        ids = np.full(self.field.num_gaussians, -1, np.int32)
        ids[self.field.gaussian_ids] = objects_of(self.field).thing_of()
        return ids

    @cached_property
    def labels(self) -> Matched:
        """The names that people gave, by node, and those that name nothing here.

        Raises: FormatError: their file is damaged.
        """
        return matched(() if self.label_file is None else self.label_file.read(), self.field)

    def label(self, node: int, name: str) -> None:
        """Name a node as people call it, in place of the name that it had; kept beside the field.

        Raises: InputError: no such node, no objects, an empty name, or nowhere to keep it.

        >>> scene.label(0, "my mug")
        >>> scene.locate("my mug")[0].label
        'my mug'
        """
        if self.label_file is None:
            raise InputError("this scene was not opened from a field on disk: there is nowhere to keep a name")
        named = match_of(self.field, node)
        new = Label.of(name, self.field.scene, named.gaussian_ids, named.center)
        former = [self.labels.by_node[node]] if node in self.labels.by_node else []
        self.labels = matched(self.label_file.add(new, instead=former), self.field)

    def view(self, name: str) -> View:
        """Return the view of a photo's name. Raises: InputError: there is none of that name.

        >>> scene.view("photo_0.png").width
        96
        """
        return view_named(self.views, name)

    def _label_of(self, number: int | None) -> str | None:
        if number is None:
            return None
        label = self.labels.by_node.get(objects_of(self.field).thing(number))
        return None if label is None else label.name


def view_named(views: Sequence[View], name: str) -> View:
    """Return the view of a file name, with or without suffix.

    Raises: InputError: there is none; the message has the nearest names.
    """
    if not views:
        raise InputError(
            f"there is no view '{name}': this scene has none: pass views=CAPTURE, the photos and their poses"
        )
    for view in views:
        path = Path(view.name)
        if name in (view.name, str(path.with_suffix("")), path.name, path.stem):
            return view
    near = did_you_mean(name, [view.name if Path(name).suffix else Path(view.name).stem for view in views])
    raise InputError(
        f"there is no view '{name}': this capture has {len(views)}, from '{views[0].name}' to '{views[-1].name}'.{near}"
    )


def _rows_of(gaussians: Gaussians | Moving | Tiles | None) -> AnyGaussians | None:
    if gaussians is None:
        return None
    return gaussians.parted() if isinstance(gaussians, Tiles) else canonical_of(gaussians)
