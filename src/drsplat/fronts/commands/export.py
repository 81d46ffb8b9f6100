"""drsplat export: a scene, its objects and the answer to a query -> a file for other programs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from ...errors import InputError
from ...query.schema import CUT, EXCLUDE, SUBJECTS
from .declaring import Facts, argument, declaration, finite, flag, option, part, whole, words
from .edit_options import kept_edits, note_applied, note_left_out, only_one
from .options import Encoders, Photos, Verb, new_output, overwrite
from .query_options import asked, open_with, query_of, query_text

if TYPE_CHECKING:
    import numpy as np

    from ...authoring.editing.edits import KeptEdits
    from ...authoring.exporting.writing import Exported, Only
    from ...formats.tiles3d_writing import TiledScene
    from ...query import Scene
    from ...scene.labelled import LabelledScene
    from .query_options import Asked

EXAMPLES = """\
  drsplat export drsplat-demo --output room.glb
  drsplat export scene.ply --output scene.spz
  drsplat export scene.ply --field room.field --output room.glb
  drsplat export room.field --scene scene.ply --query "red mug" --output answer.glb
  drsplat export drsplat-demo --query "red vase" --only --output vase.glb
  drsplat export drsplat-demo --object 4 --output thing.ply
  drsplat export film.field --scene film.motion --at 1.5 --output moment.glb
  drsplat export drsplat-demo --query "red vase" --masks --output masks
  drsplat export tiles --output city/lod-meta.json

A .glb has a table of the objects (number, name, score, box, group) and the object of each Gaussian; with --query,
also the relevancy of each Gaussian, and the matches as named nodes. Other formats hold what they can, and the
command reports what they omit. Objects come from `drsplat objects`: run it first if the field has none. Kept edits
are applied, and annotations are written too."""
DAILY = "output field scene text only object label edits overwrite"
QUERIES = tuple(field.name for field in SUBJECTS)
SUFFIXES = ".glb, .ply, .rrd, .sog, .spz, .usda, .usdc, .usdz, DIR/lod-meta.json (streamed SOG)"


@declaration
class Content:
    """Content that is written of a scene."""

    TITLE = "content (default: everything)"
    text: str | None = option("query whose answer is also written", "WORDS", words, flags="--query")
    only: bool = flag("write only what matches the query")
    object: int | None = option("write only this object of `drsplat objects`", "NUMBER", whole)
    label: str | None = option("write only the object with this label", "NAME", words)
    embeddings: bool = flag("write the embedding of each object, if the format can hold it")
    photos: bool = flag("write the photos and their cameras, if the format can hold them: .rrd")
    fit_8bit: bool = flag("fit colours to web viewers, which store and clamp them as bytes")
    spz_version: Literal[3, 4] = option(
        "version of an .spz: 3, which most programs read, or 4, which holds objects and names (default: 3)", None, int,
        3, choices=(3, 4),
    )  # fmt: skip
    edits: KeptEdits | None = kept_edits("kept")


@declaration
class Options(Verb):
    """Options of this verb."""

    source: str = argument("scene, a field, or a folder with a field, its scene and photos", value="SCENE")
    output: str = option(
        f"file to write: {SUFFIXES}; a folder of 3D Tiles or masks", "FILE|DIR", flags="-o", required=True
    )  # fmt: skip
    tiles3d: bool = flag("write 3D Tiles, levels of detail for maps, to the folder --output")
    masks: bool = flag(
        "write a mask of each photo to the folder --output: the matches of --query in white, or all objects in a "
        "palette, with the same number in each photo"
    )
    field: str | None = option("field of the scene, for named objects and queries")
    scene: str | None = option("scene that was registered, if SCENE is a field")
    time: float | None = option("time of a scene that moves", "TIME", finite, flags="--at")
    content: Content = part(Content)
    overwrite: bool = overwrite()
    others: Asked = asked((*SUBJECTS[1:], EXCLUDE), "other queries")
    views: str | None = option("posed photos, for --click and to find up", "CAPTURE")
    encoders: Encoders = part(Encoders)
    cut: Asked = asked(CUT)
    photos: Photos = part(Photos)

    @property
    def asked(self) -> Asked:
        """Values that say what is written, by name."""
        return {**vars(self.content), **self.others, **self.cut}

    @property
    def subject(self) -> str | None:
        """Name of the option whose query is answered. Raises: InputError: there are several."""
        return only_one(self.asked, QUERIES)


def run(options: Options) -> Facts:
    from ...authoring.exporting.writing import for_8_bits, written
    from ...formats.streamed_sog import LOD_META

    output, content = _output(options), options.content
    if options.masks:
        return _masks(options, output)
    if (options.tiles3d or output.name == LOD_META) and (tiles := _whole_tiles(options)) is not None:
        return _levels_of_tiles(options, output, tiles)
    scene = _labelled(options, output)
    if content.fit_8bit:
        scene = for_8_bits(scene)
    note_applied(scene.num_edits)
    if options.tiles3d:
        done = _tiles3d(options, output, scene)
    else:
        done = written(output, scene, options.overwrite, content.spz_version)
    return _report(options, scene.query or None, scene.object_of, done)


def _report(options: Options, query: str | None, owners: np.ndarray | None, done: Exported) -> Facts:
    """Return what was written. owners: per Gaussian its object, -1 for none; None where there are no objects."""
    return {
        "scene": options.source,
        "saved": options.output,
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


def show(answer: Facts) -> None:
    from ...base.terminal import counted

    if answer["format"] == "masks":
        shown = counted(answer["num_shown"], "shows", "show")
        print(f"{answer['saved']}: masks of {counted(answer['num_photos'], 'photo')}, of which {shown} something")
        return
    parts = [counted(answer["num_gaussians"], "Gaussian")]
    if answer["num_objects"] is not None:
        parts.append(f"{counted(answer['num_objects'], 'object')}, sure or not")
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


def _output(options: Options) -> Path:
    """Return the output. Raises: InputError: it cannot be written, or options that do not go together."""
    from ...formats.known import writer_of
    from ...formats.streamed_sog import LOD_META

    output = Path(options.output)
    place = output.resolve().parent if output.name == LOD_META else output
    new_output(str(place), options.overwrite)
    if not (options.tiles3d or options.masks):
        try:
            writer_of(output)
        except InputError as error:
            raise InputError(f"{error} A folder of 3D Tiles is written with tiles3d=True") from None
    if not place.parent.is_dir():
        raise InputError(f"there is no folder {place.parent} to write {place.name} into: make it first")
    chosen = only_one(options.asked, ("only", "object", "label"))
    if chosen == "only" and options.subject is None:
        raise InputError("only: what matches is that of a query: give --query WORDS")
    return output


def _masks(options: Options, folder: Path) -> Facts:
    """Write masks of the photos. Raises: InputError: as `write_masks`; a scene without a field."""
    from ...authoring.exporting.masking import write_masks

    scene = _opened(options)
    if scene is None:
        raise InputError("masks are drawn of what a field knows: pass field=FIELD as well")
    query = None if options.subject is None else query_of(options.asked)
    done = write_masks(folder, scene, query, overwrite=options.overwrite)
    return {"scene": options.source, "saved": options.output, "format": "masks", **done._asdict()}


def _tiles3d(options: Options, output: Path, source: LabelledScene | TiledScene) -> Exported:
    """Write 3D Tiles, where the scene lies on the Earth if a georeference.json beside it says so."""
    from ...authoring.exporting.writing import written_tiles3d
    from ...formats.georeference import read_georeference

    named = [Path(path) for path in (options.source, options.scene, options.field) if path is not None]
    folders = [path if path.is_dir() else path.parent for path in named] + [path.parent for path in named]
    return written_tiles3d(output, source, read_georeference(*folders), options.overwrite)


def _whole_tiles(options: Options) -> Path | None:
    """Return the folder of tiles that is written as it is; None for another scene, a part of one, or an edited one."""
    from ...authoring.editing import EditFile
    from ...formats.tiles import TILES

    named = [Path(path) for path in (options.source, options.scene) if path is not None]
    tiles = next((path for path in named if (path / TILES).is_file()), None)
    chosen = options.subject or only_one(options.asked, ("only", "object", "label"))
    if tiles is None or chosen is not None or options.content.embeddings or options.time is not None:
        return None
    return tiles if options.content.edits == "none" or not EditFile.beside(tiles).num_done() else None


def _levels_of_tiles(options: Options, output: Path, path: Path) -> Facts:
    """Write levels of detail of a folder of tiles, a few of which are in memory at a time; 3D Tiles with objects."""
    from ...authoring.exporting.writing import tiled, written_streamed_sog
    from ...formats.tiles import read_tiles

    if options.content.fit_8bit:
        raise InputError("fit_8bit: the scene is cut into tiles, whose colours are written as they are")
    tiles = read_tiles(path)
    if not options.tiles3d:
        return _report(options, None, None, written_streamed_sog(output, tiles, options.overwrite))
    field = options.field or (options.source if options.scene is not None else None)
    scene = None if field is None else open_with(options, field, None)  # its Gaussians stay on the disk
    source = tiled(tiles, scene)
    return _report(options, None, source.object_of, _tiles3d(options, output, source))


def _labelled(options: Options, output: Path) -> LabelledScene:
    """Bring together what is written; --edits none reports the edits that it leaves out."""
    from ...authoring.editing import EditFile
    from ...authoring.editing.resolving import label_rows, object_rows
    from ...authoring.exporting.writing import labelled, labelled_alone, whole_motion
    from ...formats.moving_scenes import read_scene
    from ...scene.moving import canonical_of

    scene, source, content = _opened(options), Path(options.source), options.content
    query = None if options.subject is None else query_of(options.asked)
    read = read_scene(source) if scene is None else scene.motion or scene.gaussians
    path, edits = source if scene is None else scene.path, content.edits or "kept"
    if edits == "none" and path is not None:
        note_left_out(EditFile.beside(path).num_done(canonical_of(read)))
    motion = whole_motion(output, read, options.time)
    time = options.time if motion is None else motion.span[0]
    if scene is None:
        if content.photos and options.views is None:
            raise InputError("photos: a scene without a field has none of its own: pass views=CAPTURE as well")
        views = options.photos.views(options.views) if content.photos and options.views else []
        return replace(labelled_alone(read, path, time=time, edits=edits), views=tuple(views), motion=motion)
    only: Only = "matches" if content.only else None
    if content.object is not None:
        only = object_rows(scene, content.object)
    elif content.label is not None:
        only = label_rows(scene, content.label)
    carried = labelled(
        scene, query, only=only, time=time, edits=edits, embeddings=content.embeddings, photos=content.photos,
        words="" if query is None else query_text(options.asked),
    )  # fmt: skip
    return replace(carried, motion=motion)


def _opened(options: Options) -> Scene | None:
    """Return the scene with its field, None for one that has none. Raises: InputError: options that need a field."""
    from ...formats.scenes import Kind, recognised

    source = Path(options.source)
    if recognised(source) is Kind.FIELD or (source.is_dir() and any(source.glob("*.field"))):
        if options.field is not None:
            raise InputError(f"{options.source} has a field already: drop --field, or name the scene's file")
        return open_with(options, options.source, options.scene)
    if options.scene is not None:
        raise InputError("--scene is the scene of a field: name the field first, or pass the scene and --field FIELD")
    if options.field is not None:
        return open_with(options, options.field, options.source)
    content = options.content
    if options.subject or content.embeddings or (content.object, content.label) != (None, None):
        raise InputError("queries, objects and labels need the field of the scene: pass field=FIELD")
    return None
