"""Writing a scene, and bringing together what its file holds: Gaussians as edited, objects, matches, annotations.

A format of other programs may not hold all of it; what it could not is told.
"""

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from ...base.arrays import Arrays, Flags
from ...base.contents import AnyPath
from ...base.system import folder_bytes
from ...errors import InputError
from ...formats.annotations import AnnotationFile
from ...formats.georeference import Georeference
from ...formats.json_files import ids_of, written_name
from ...formats.known import TILES3D, format_of, lacks, read_labels, write_scene
from ...formats.labels import Labels
from ...formats.streamed_sog import LOD_META, write_streamed_sog
from ...formats.tiles import Tiles
from ...formats.tiles3d_writing import TiledScene, write_tiles3d
from ...query import Answer, Match, Query, Scene
from ...scene.eight_bits import fitted_to_8_bits
from ...scene.gaussians import Gaussians
from ...scene.labelled import PLY_UP, Annotation, LabelledScene, numbers_of, places_of
from ...scene.moving import Moving, canonical_of
from ...scene.views import View
from ..editing import EditFile, EditList, Rows
from ..editing.draft import OBJECT_ID
from ..editing.edits import KeptEdits
from ..editing.resolving import complete_rows
from .placing import After, Placing, after_edits, groups_of, match_thing, only_used, rows_of, things_of

MATCHES: Literal["matches"] = "matches"
Only = Literal["matches"] | Rows | None
RELEVANCY, ONLY = "relevancy", "drsplat_only"  # columns that go along with the rows while they are edited


class _QueryMatches(NamedTuple):
    """The answer to a query and its matches. words: the query in words."""

    answer: Answer
    matches: list[Match]
    words: str


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
    standing, views = _standing(scene, time), _views(scene) if photos else ()
    found = None
    if query is not None:
        answer, text = standing.ask(query).without_maybe(), query if isinstance(query, str) else query.text
        found = _QueryMatches(answer, standing.locate(answer), words or text or "query")
    columns = _columns(standing, found, _chosen(standing, only, found))
    own = replace(standing.gaussians, extra={**standing.gaussians.extra, **columns})
    listed = kept_edits(scene.path, scene.gaussians, edits)
    after = after_edits(own, scene.path, listed)
    kept = _kept_rows(after)
    placing = Placing(scene.gaussians, after, scene.up)
    things, groups = placing.objects(things_of(scene, embeddings)), groups_of(scene)
    owners = after.everything.extra[OBJECT_ID][kept] if OBJECT_ID in columns else None
    boxes = [] if found is None else [match_thing(scene, *one) for one in enumerate(found.matches)]
    whole_scene = LabelledScene(
        _without(_rows(after.everything, kept), columns),
        written_name(scene.name),
        tuple(things),
        groups,
        None if owners is None else rows_of(things, owners),
        "" if found is None else found.words,
        None if found is None else after.everything.extra[RELEVANCY][kept],
        () if found is None else placing.matches(found.matches, boxes),
        annotations_of(scene.path),
        _up_of(scene),
        scene.field.encoder.name if embeddings else "",
        listed.done,
        views,
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


def _columns(scene: Scene, found: _QueryMatches | None, chosen: Rows | None) -> Arrays:
    columns: Arrays = {}
    if scene.field.objects is not None:
        columns[OBJECT_ID] = scene.object_ids()
    if found is not None:
        columns[RELEVANCY] = found.answer.dense
    if chosen is not None:
        mask: np.ndarray = np.zeros(len(scene.gaussians), np.uint8)
        mask[ids_of(chosen.spans)] = 1
        columns[ONLY] = mask
    return columns


def _kept_rows(after: After) -> Flags:
    """Return which rows are written. Raises: InputError: none is."""
    chosen = after.everything.extra.get(ONLY)
    kept = after.present if chosen is None else after.present & (chosen > 0)
    if not kept.any():
        what = "this scene" if chosen is None else "what was chosen"
        raise InputError(f"nothing is left of {what} after the edits that are kept: undo some, or leave them out")
    return np.asarray(kept)


def _rows(gaussians: Gaussians, kept: Flags) -> Gaussians:
    """Return some rows; the same arrays where those are all."""
    return gaussians if kept.all() else gaussians.subset(kept)


def _without(gaussians: Gaussians, columns: Collection[str]) -> Gaussians:
    """Return Gaussians without the columns that a labelled scene has in places of their own."""
    return replace(gaussians, extra={name: own for name, own in gaussians.extra.items() if name not in columns})


class Exported(NamedTuple):
    """Content of a written file. format: as the suffix says. lacks: what the format could not hold, in sentences."""

    path: Path
    format: str
    bytes: int
    num_gaussians: int
    num_objects: int
    num_matches: int
    num_annotations: int
    num_edits: int
    lacks: tuple[str, ...]


def export(
    path: AnyPath,
    scene: Scene | Gaussians | Moving | LabelledScene,
    query: Query | str | None = None,
    *,
    only: Only = None,
    time: float | None = None,
    edits: KeptEdits = "kept",
    embeddings: bool = False,
    photos: bool = False,
    fit_8bit: bool = False,
    spz_version: int = 3,
    overwrite: bool = False,
) -> Exported:
    """Write a scene as the suffix of `path` says, with its objects and the answer to a query.

    Args:
        path: NAME.glb, .ply, .spz, DIR/lod-meta.json or another that `formats.known.WRITERS` has.
        scene: an opened scene; Gaussians alone; or what `labelled` made, as it is.
        query: as in `labelled`.
        only: as in `labelled`.
        time: as in `labelled`; without one, a `.rrd` of a scene that moves has all of its motion.
        edits: as in `labelled`.
        embeddings: as in `labelled`.
        photos: as in `labelled`.
        fit_8bit: fits colours to viewers that keep them in bytes (`scene.eight_bits.fitted_to_8_bits`).
        spz_version: as of `write_scene`.
        overwrite: replaces what is at `path`.

    Raises: InputError: a suffix that nothing is written as, more than the format can hold, `path` exists and not
    `overwrite`; as `labelled`.
    """
    motion, time = whole_motion(Path(path), scene.motion if isinstance(scene, Scene) else scene, time)
    if isinstance(scene, Scene):
        carried = labelled(scene, query, only=only, time=time, edits=edits, embeddings=embeddings, photos=photos)
    elif query is not None or only is not None:
        raise InputError("a query is answered by a field: open the scene together with its field")
    else:
        carried = scene if isinstance(scene, LabelledScene) else labelled_alone(scene, time=time)
    carried = carried if motion is None else replace(carried, motion=motion)
    return written(Path(path), for_8_bits(carried) if fit_8bit else carried, overwrite, spz_version)


def whole_motion(path: Path, scene: object, time: float | None) -> tuple[Moving | None, float | None]:
    """Return the scene, and its first time, where a recording of rerun has all its motion; else None and the time."""
    if time is None and isinstance(scene, Moving) and path.suffix.lower() == ".rrd":
        return scene, scene.span[0]
    return None, time


def for_8_bits(scene: LabelledScene) -> LabelledScene:
    """Return the scene with colours that viewers which keep them in bytes do not clamp."""
    return replace(scene, gaussians=fitted_to_8_bits(scene.gaussians))


def written(path: Path, scene: LabelledScene, overwrite: bool = False, spz_version: int = 3) -> Exported:
    """Write a labelled scene; returns what is in the file. Raises: as `write_scene`."""
    write_scene(path, scene, overwrite, spz_version=spz_version)
    return described(path, scene, format_of(path, spz_version))


def written_tiles3d(
    path: Path, source: LabelledScene | TiledScene, georeference: Georeference | None = None, overwrite: bool = False
) -> Exported:
    """Write a scene, or tiles without loading them all, as 3D Tiles. Raises: as `write_tiles3d`."""
    write_tiles3d(path, source, georeference=georeference, overwrite=overwrite)
    if isinstance(source, LabelledScene):
        return described(path, source, TILES3D)
    return _of_tiles(path, source.tiles, TILES3D, len(source.things))


def written_streamed_sog(path: Path, source: Tiles, overwrite: bool = False) -> Exported:
    """Write a folder of tiles as a streamed SOG, a tile at a time. Raises: as `write_streamed_sog`."""
    write_streamed_sog(path, source, overwrite)
    return _of_tiles(path, source, LOD_META)


def _of_tiles(path: Path, source: Tiles, kind: str, num_things: int = 0) -> Exported:
    return Exported(path, kind, _size(path), len(source), num_things, 0, 0, 0, ())


def described(path: Path, scene: LabelledScene, kind: str) -> Exported:
    """Return what a file, or a folder, that was written of a scene has in it; kind: one of `formats.known.WRITERS`."""
    counts = (len(scene.gaussians), len(scene.things), len(scene.matches), len(scene.annotations))
    return Exported(path, kind.removeprefix("."), _size(path), *counts, scene.num_edits, lacks(kind, scene))


def _size(path: Path) -> int:
    path = path.parent if path.name == LOD_META else path
    return folder_bytes(path) if path.is_dir() else path.stat().st_size
