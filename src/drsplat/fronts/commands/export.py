"""drsplat export: a scene, its objects and the answer to a query -> a file for other programs."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...query.schema import CUT, EXCLUDE, SUBJECTS
from .edit_options import add_kept_edits, note_applied, note_left_out, only_one
from .options import add_capture_options, add_overwrite, add_query_encoders, finite, new_output, views_of, whole, words
from .query_options import add_fields, open_scene, query_of, query_text

if TYPE_CHECKING:
    import numpy as np

    from ...authoring.exporting.labelling import Only
    from ...authoring.exporting.writing import Exported
    from ...formats.tiles3d_writing import TiledScene
    from ...query import Query, Scene
    from ...scene.gaussians import Gaussians
    from ...scene.labelled import LabelledScene

EXAMPLES = """\
  drsplat export drsplat-demo --output room.glb
  drsplat export scene.ply --output scene.spz
  drsplat export scene.ply --field room.field --output room.glb
  drsplat export room.field --scene scene.ply --query "red mug" --output answer.glb
  drsplat export drsplat-demo --query "red vase" --only --output vase.glb
  drsplat export drsplat-demo --object 4 --output thing.ply
  drsplat export film.field --scene film.motion --at 1.5 --output moment.glb
  drsplat export tiles --output city/lod-meta.json

A .glb has a table of the objects (number, name, score, box, group) and the object of each Gaussian; with --query,
also the relevancy of each Gaussian, and the matches as named nodes. Other formats hold what they can, and the
command reports what they omit. Objects come from `drsplat objects`: run it first if the field has none. Kept edits
are applied, and annotations are written too."""
DAILY = ("output", "field", "scene", "text", "only", "object", "label", "edits", "overwrite")
QUERIES = tuple(field.name for field in SUBJECTS)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "source", metavar="SCENE", help="scene, a field, or a folder with a field, its scene and photos"
    )
    parser.add_argument(
        "--output", "-o", required=True, metavar="FILE|DIR", help=f"file to write: {_suffixes()}; a folder of 3D Tiles"
    )
    parser.add_argument(
        "--tiles3d", action="store_true", help="write 3D Tiles, levels of detail for maps, to the folder --output"
    )
    parser.add_argument("--field", help="field of the scene, for named objects and queries")
    parser.add_argument("--scene", help="scene that was registered, if SCENE is a field")
    parser.add_argument("--at", dest="time", type=finite, metavar="TIME", help="time of a scene that moves")
    what = parser.add_argument_group("content (default: everything)")
    what.add_argument("--query", dest="text", type=words, metavar="WORDS", help="query whose answer is also written")
    what.add_argument("--only", action="store_true", help="write only what matches the query")
    what.add_argument("--object", type=whole, metavar="NUMBER", help="write only this object of `drsplat objects`")
    what.add_argument("--label", type=words, metavar="NAME", help="write only the object with this label")
    what.add_argument(
        "--embeddings", action="store_true", help="write the embedding of each object, if the format can hold it"
    )
    what.add_argument(
        "--photos", action="store_true", help="write the photos and their cameras, if the format can hold them: .rrd"
    )
    what.add_argument(
        "--fit-8bit", action="store_true", help="fit colours to web viewers, which store and clamp them as bytes"
    )
    what.add_argument(
        "--spz-version", type=int, choices=(3, 4), default=3, help="version of an .spz: 3, which most programs read, "
        "or 4, which holds objects and names (default: 3)",
    )  # fmt: skip
    add_kept_edits(what, "kept")
    add_overwrite(parser)
    add_fields(parser.add_argument_group("other queries"), (*SUBJECTS[1:], EXCLUDE))
    parser.add_argument("--views", metavar="CAPTURE", help="posed photos, for --click and to find up")
    add_query_encoders(parser)
    add_fields(parser, CUT)
    add_capture_options(parser)


def _suffixes() -> str:
    return ".glb, .ply, .rrd, .sog, .spz, .usda, .usdc, .usdz, DIR/lod-meta.json (streamed SOG)"


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from ...authoring.exporting.writing import for_8_bits
    from ...formats.streamed_sog import LOD_META

    output = _output(arguments)
    if (arguments.tiles3d or output.name == LOD_META) and (tiles := _whole_tiles(arguments)) is not None:
        return _levels_of_tiles(arguments, output, tiles)
    scene = _labelled(arguments, output)
    if arguments.fit_8bit:
        scene = for_8_bits(scene)
    note_applied(scene.num_edits)
    done = _tiles3d(arguments, output, scene) if arguments.tiles3d else _written(arguments, output, scene)
    return _report(arguments, scene.query or None, scene.object_of, done)


def _written(arguments: argparse.Namespace, output: Path, scene: LabelledScene) -> Exported:
    from ...authoring.exporting.writing import written

    return written(output, scene, arguments.overwrite, arguments.spz_version)


def _report(
    arguments: argparse.Namespace, query: str | None, owners: np.ndarray | None, done: Exported
) -> dict[str, Any]:
    """Return what was written. owners: per Gaussian its object, -1 for none; None where there are no objects."""
    return {
        "scene": arguments.source,
        "saved": arguments.output,
        "format": done.format,
        "bytes": done.bytes,
        "query": query,
        "num_gaussians": done.num_gaussians,
        "num_objects": None if owners is None else done.num_objects,
        "num_in_objects": None if owners is None else int((owners >= 0).sum()),
        "num_matches": None if query is None else done.num_matches,
        "num_annotations": done.num_annotations,
        "num_edits": done.num_edits,
        "lacks": list(done.lacks),
    }


def show(answer: dict[str, Any]) -> None:
    from ...base.terminal import counted

    parts = [counted(answer["num_gaussians"], "Gaussian")]
    parts += [] if answer["num_objects"] is None else [counted(answer["num_objects"], "object")]
    if answer["query"] is not None:
        parts.append(f"{counted(answer['num_matches'], 'match', 'matches')} of '{answer['query']}'")
    if answer["num_annotations"]:
        parts.append(counted(answer["num_annotations"], "annotation"))
    print(f"{answer['saved']}: {', '.join(parts)}, {answer['bytes'] / 1e6:.1f} MB")
    for sentence in answer["lacks"]:
        print(sentence)
    if answer["num_objects"] is None:
        print(
            "It has no objects: `drsplat objects FIELD --scene SCENE` finds them, then --field FIELD takes them along."
        )


def _output(arguments: argparse.Namespace) -> Path:
    """Return the output. Raises: InputError: it cannot be written, or options that do not go together."""
    from ...authoring.exporting.writers import writer_of
    from ...errors import InputError
    from ...formats.streamed_sog import LOD_META

    output = Path(arguments.output)
    place = output.resolve().parent if output.name == LOD_META else output
    new_output(str(place), arguments.overwrite)
    if not arguments.tiles3d:
        writer_of(output)
    if not place.parent.is_dir():
        raise InputError(f"there is no folder {place.parent} to write {place.name} into: make it first")
    chosen = only_one(arguments, ("only", "object", "label"))
    if chosen == "only" and only_one(arguments, QUERIES) is None:
        raise InputError("only: what matches is that of a query: give --query WORDS")
    return output


def _tiles3d(arguments: argparse.Namespace, output: Path, source: LabelledScene | TiledScene) -> Exported:
    """Write 3D Tiles, where the scene lies on the Earth if a georeference.json beside it says so."""
    from ...authoring.exporting.writing import written_tiles3d
    from ...formats.georeference import read_georeference

    named = [Path(path) for path in (arguments.source, arguments.scene, arguments.field) if path is not None]
    folders = [path if path.is_dir() else path.parent for path in named] + [path.parent for path in named]
    return written_tiles3d(output, source, read_georeference(*folders), arguments.overwrite)


def _whole_tiles(arguments: argparse.Namespace) -> Path | None:
    """Return the folder of tiles that is written as it is; None for another scene, a part of one, or an edited one."""
    from ...authoring.editing import EditFile
    from ...formats.tiles import TILES

    named = [Path(path) for path in (arguments.source, arguments.scene) if path is not None]
    tiles = next((path for path in named if (path / TILES).is_file()), None)
    chosen = only_one(arguments, QUERIES) or only_one(arguments, ("only", "object", "label"))
    if tiles is None or chosen is not None or arguments.embeddings or arguments.time is not None:
        return None
    return tiles if arguments.edits == "none" or not EditFile.beside(tiles).num_done() else None


def _levels_of_tiles(arguments: argparse.Namespace, output: Path, path: Path) -> dict[str, Any]:
    """Write levels of detail of a folder of tiles, a few of which are in memory at a time; 3D Tiles with objects."""
    from ...authoring.exporting.labelling import tiled
    from ...authoring.exporting.writing import written_streamed_sog
    from ...formats.tiles import read_tiles

    if arguments.fit_8bit:
        from ...errors import InputError

        raise InputError("fit_8bit: the scene is cut into tiles, whose colours are written as they are")
    if not arguments.tiles3d:
        return _report(arguments, None, None, written_streamed_sog(output, read_tiles(path), arguments.overwrite))
    field = arguments.field or (arguments.source if arguments.scene is not None else None)
    scene = None
    if field is not None:
        arguments.scene = None  # its Gaussians stay on the disk
        scene = open_scene(arguments, field)
    source = tiled(read_tiles(path), scene)
    return _report(arguments, None, source.object_of, _tiles3d(arguments, output, source))


def _labelled(arguments: argparse.Namespace, output: Path) -> LabelledScene:
    from ...authoring.exporting.labelling import labelled
    from ...authoring.exporting.writing import whole_motion

    scene = _opened(arguments)
    if scene is None:
        return _alone(arguments, output)
    query = _query(arguments)
    _note_none(arguments, scene.path, scene.gaussians)
    motion = whole_motion(output, scene.motion, arguments.time)
    carried = labelled(
        scene,
        query,
        only=_only(arguments, scene),
        time=arguments.time if motion is None else motion.span[0],
        edits=arguments.edits or "kept",
        embeddings=arguments.embeddings,
        photos=arguments.photos,
        words="" if query is None else query_text(arguments),
    )
    return replace(carried, motion=motion)


def _opened(arguments: argparse.Namespace) -> Scene | None:
    """Return the scene with its field, None for one that has none. Raises: InputError: options that need a field."""
    from ...errors import InputError
    from ...formats.recognising import Kind, recognised

    source = Path(arguments.source)
    has_field = recognised(source) is Kind.FIELD or (source.is_dir() and any(source.glob("*.field")))
    if has_field:
        if arguments.field is not None:
            raise InputError(f"{arguments.source} has a field already: drop --field, or name the scene's file")
        arguments.field = arguments.source
    elif arguments.scene is not None:
        raise InputError("--scene is the scene of a field: name the field first, or pass the scene and --field FIELD")
    else:
        arguments.scene = arguments.source if arguments.field is not None else None
    if arguments.field is not None:
        return open_scene(arguments)
    named = only_one(arguments, QUERIES) or only_one(arguments, ("object", "label"))
    if named is not None or arguments.embeddings:
        raise InputError("queries, objects and labels need the field of the scene: pass field=FIELD")
    return None


def _alone(arguments: argparse.Namespace, output: Path) -> LabelledScene:
    from ...authoring.exporting.labelling import labelled_alone
    from ...authoring.exporting.writing import whole_motion
    from ...errors import InputError
    from ...formats.moving_scenes import read_scene
    from ...scene.moving import canonical_of

    source = Path(arguments.source)
    gaussians = read_scene(source)
    _note_none(arguments, source, canonical_of(gaussians))
    if arguments.photos and arguments.views is None:
        raise InputError("photos: a scene without a field has none of its own: pass views=CAPTURE as well")
    views = tuple(views_of(arguments, arguments.views)) if arguments.photos else ()
    motion = whole_motion(output, gaussians, arguments.time)
    time = arguments.time if motion is None else motion.span[0]
    carried = labelled_alone(gaussians, source, time=time, edits=arguments.edits or "kept")
    return replace(carried, views=views, motion=motion)


def _query(arguments: argparse.Namespace) -> Query | None:
    return None if only_one(arguments, QUERIES) is None else query_of(arguments)


def _only(arguments: argparse.Namespace, scene: Scene) -> Only:
    from ...authoring.editing.resolving import label_rows, object_rows

    if arguments.object is not None:
        return object_rows(scene, arguments.object)
    if arguments.label is not None:
        return label_rows(scene, arguments.label)
    return "matches" if arguments.only else None


def _note_none(arguments: argparse.Namespace, path: Path | None, gaussians: Gaussians) -> None:
    """Report the kept edits that --edits none leaves out."""
    from ...authoring.editing import EditFile

    if arguments.edits == "none" and path is not None:
        note_left_out(EditFile.beside(path).num_done(gaussians))
