"""Content of a file of an opened scene: Gaussians as edited, objects, matches, annotations."""

from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from ...base.arrays import Bool
from ...errors import InputError
from ...formats.annotations import AnnotationFile
from ...formats.json_files import ids_of, written_name
from ...formats.known import read_labels
from ...formats.labels import Labels
from ...formats.tiles import Tiles
from ...formats.tiles3d_writing import TiledScene
from ...query import Answer, Match, Query, Scene
from ...scene.annotations import Annotation
from ...scene.gaussians import Gaussians
from ...scene.labelled import PLY_UP, LabelledScene, numbers_of, places_of
from ...scene.moving import Moving, canonical_of
from ...scene.views import View
from ..editing import EditFile, EditList, Rows
from ..editing.draft import OBJECT_ID
from ..editing.kept import KeptEdits
from ..editing.resolving import complete_rows
from .placing import After, Placing, after_edits, groups_of, match_thing, only_used, rows_of, things_of

MATCHES: Literal["matches"] = "matches"
Only = Literal["matches"] | Rows | None
RELEVANCY, ONLY = "relevancy", "drsplat_only"  # columns that go along with the rows while they are edited


@dataclass(frozen=True, eq=False)
class _QueryMatches:
    """The answer to a query and its matches. words: the query in words."""

    answer: Answer
    matches: list[Match]
    words: str

    @property
    def numbered(self) -> list[tuple[int, Match]]:
        return list(enumerate(self.matches))


def labelled(
    scene: Scene,
    query: Query | str | None = None,
    *,
    only: Only = None,
    time: float | None = None,
    edits: KeptEdits = "kept",
    embeddings: bool = False,
    photos: bool = False,
    words: str = "",
) -> LabelledScene:
    """Bring together what is known of a scene, as it is after the edits that are kept beside it.

    Args:
        scene: an opened scene; what it knows of objects, labels and names goes along.
        query: its relevancy goes to every Gaussian, its matches become named boxes.
        only: "matches" leaves out all that matches nothing; rows of an object or a label
            (`authoring.editing.resolving`) leave out the others.
        time: of a scene that moves, which is written as it is then.
        edits: "none" leaves out the edits that are kept beside the scene.
        embeddings: whether objects take their descriptors along.
        photos: whether the photos and their cameras go along.
        words: the query in words, where it has none.

    Raises: InputError: nothing is left, a scene that moves without a time, no Gaussians; as `Scene.ask`.
    """
    standing = _standing(scene, time)
    found = None if query is None else _matches_of(standing, query, words)
    columns = _columns(standing, found, _chosen(standing, only, found))
    own = replace(standing.gaussians, extra={**standing.gaussians.extra, **columns})
    listed = kept_edits(scene.path, scene.gaussians, edits)
    after = after_edits(own, scene.path, listed)
    kept = _kept_rows(after)
    placing = Placing(scene.gaussians, after, scene.up)
    things = placing.objects(things_of(scene, embeddings))
    owners = after.everything.extra[OBJECT_ID][kept] if OBJECT_ID in columns else None
    whole_scene = LabelledScene(
        _without(_rows(after.everything, kept), columns),
        written_name(scene.name),
        tuple(things),
        groups_of(scene),
        None if owners is None else rows_of(things, owners),
        "" if found is None else found.words,
        None if found is None else after.everything.extra[RELEVANCY][kept],
        () if found is None else placing.matches(found.matches, [match_thing(scene, *one) for one in found.numbered]),
        annotations_of(scene.path),
        _up_of(scene),
        scene.field.encoder.name if embeddings else "",
        listed.done,
        _views(scene) if photos else (),
    )
    return whole_scene if only is None else only_used(whole_scene)


def _views(scene: Scene) -> tuple[View, ...]:
    if not scene.views:
        raise InputError("photos: this scene has none: pass views=CAPTURE, the photos and their poses")
    return scene.views


def tiled(tiles: Tiles, scene: Scene | None = None) -> TiledScene:
    """Bring together tiles on disk and the objects of their field, without loading the tiles.

    scene: their field, opened without Gaussians; None where they have none.

    Raises: MismatchError: the field is of another scene.
    """
    if scene is None:
        return TiledScene(tiles)
    scene.field.check_scene(tiles)
    if scene.field.objects is None:
        return TiledScene(tiles, up=_up_of(scene))
    things = tuple(things_of(scene))
    return TiledScene(tiles, things, rows_of(things, scene.object_ids()), _up_of(scene))


def labelled_alone(
    gaussians: Gaussians | Moving, path: Path | None = None, *, time: float | None = None, edits: KeptEdits = "kept"
) -> LabelledScene:
    """Bring together what is known of a scene without a field: what its file says of objects, too.

    path: its file, beside which edits and annotations are.

    Raises: InputError: a scene that moves without a time, nothing is left after its edits. FormatError: as
    `read_labels`.
    """
    own, labels = _at(gaussians, time), Labels() if path is None else read_labels(path)
    listed = kept_edits(path, canonical_of(gaussians), edits)
    after = after_edits(own, path, listed)
    kept = _kept_rows(after)
    rows = _rows(after.everything, kept)
    title, notes = "scene" if path is None else written_name(path.resolve().stem), annotations_of(path)
    if not labels.things or OBJECT_ID not in rows.extra:
        return LabelledScene(rows, title, annotations=notes, num_edits=listed.done)
    numbers = zip(labels.things, numbers_of(labels.things), strict=True)
    things = tuple(Placing(own, after, None).objects([replace(thing, number=number) for thing, number in numbers]))
    relevancy = rows.extra.get(RELEVANCY)
    return LabelledScene(
        _without(rows, (OBJECT_ID, RELEVANCY)),
        title,
        things,
        labels.groups,
        places_of(rows.extra[OBJECT_ID], things),
        labels.query or ("query" if relevancy is not None else ""),
        relevancy,
        annotations=notes,
        num_edits=listed.done,
    )


def kept_edits(path: Path | None, gaussians: Gaussians, edits: KeptEdits) -> EditList:
    """Return the edits that are kept beside a scene, or no edit.

    Raises: FormatError, MismatchError: the list is damaged, or of another scene.
    """
    if path is None or edits == "none":
        return EditList(gaussians.fingerprint)
    return EditFile.beside(path).read(gaussians)


def _up_of(scene: Scene) -> tuple[float, float, float]:
    return PLY_UP if scene.up is None else (float(scene.up[0]), float(scene.up[1]), float(scene.up[2]))


def annotations_of(path: Path | None) -> tuple[Annotation, ...]:
    """Return the annotations beside a scene. Raises: FormatError: their file is damaged."""
    return () if path is None else AnnotationFile.beside(path).read()


def _at(gaussians: Gaussians | Moving, time: float | None) -> Gaussians:
    if not isinstance(gaussians, Moving):
        if time is not None:
            raise InputError("this scene stands still: leave out the time")
        return gaussians
    if time is None:
        low, high = gaussians.span
        raise InputError(f"this scene moves, and a file holds one time of it: pass time=T, from {low:g} to {high:g}")
    return gaussians.at(time)


def _standing(scene: Scene, time: float | None) -> Scene:
    """Return the scene at a time, itself where it stands still. Raises: InputError: as `_at`."""
    if scene.motion is None:
        _at(scene.gaussians, time)
        return scene
    _at(scene.motion, time)
    assert time is not None
    return scene.at(time)


def _matches_of(scene: Scene, query: Query | str, words: str) -> _QueryMatches:
    answer = scene.ask(query).without_maybe()
    text = query if isinstance(query, str) else query.text
    return _QueryMatches(answer, scene.locate(answer), words or text or "query")


def _chosen(scene: Scene, only: Only, found: _QueryMatches | None) -> Rows | None:
    """Return the rows that stay, None for all. Raises: InputError: nothing matches, or nothing was asked."""
    if only != MATCHES:
        return only if isinstance(only, Rows) else None
    if found is None:
        raise InputError("only: 'matches' are of a query: give one")
    if not found.matches:
        raise InputError(f"no match for “{found.words}”, so nothing to export: `drsplat locate` prints how near it was")
    ids = np.concatenate([match.gaussian_ids for match in found.matches])
    return Rows.of(complete_rows(scene, ids), "query", found.words)


def _columns(scene: Scene, found: _QueryMatches | None, chosen: Rows | None) -> dict[str, np.ndarray]:
    columns: dict[str, np.ndarray] = {}
    if scene.field.objects is not None:
        columns[OBJECT_ID] = scene.object_ids()
    if found is not None:
        columns[RELEVANCY] = found.answer.dense
    if chosen is not None:
        mask: np.ndarray = np.zeros(len(scene.gaussians), np.uint8)
        mask[ids_of(chosen.spans)] = 1
        columns[ONLY] = mask
    return columns


def _kept_rows(after: After) -> Bool[np.ndarray, " d"]:
    """Return which rows are written. Raises: InputError: none is."""
    chosen = after.everything.extra.get(ONLY)
    kept = after.present if chosen is None else after.present & (chosen > 0)
    if not kept.any():
        what = "this scene" if chosen is None else "what was chosen"
        raise InputError(f"nothing is left of {what} after the edits that are kept: undo some, or leave them out")
    return np.asarray(kept)


def _rows(gaussians: Gaussians, kept: Bool[np.ndarray, " n"]) -> Gaussians:
    """Return some rows; the same arrays where those are all."""
    return gaussians if kept.all() else gaussians.subset(kept)


def _without(gaussians: Gaussians, columns: Collection[str]) -> Gaussians:
    """Return Gaussians without the columns that a labelled scene has in places of their own."""
    return replace(gaussians, extra={name: own for name, own in gaussians.extra.items() if name not in columns})
