"""drsplat export: a scene, its objects and the answer to a query -> a file for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

from ...base.terminal import counted
from ...errors import InputError
from ...query.schema import CUT, EXCLUDE, SUBJECTS
from .declaring import Facts, argument, declaration, finite, flag, option, part, whole, words
from .edit_options import kept_edits, note_applied, note_left_out, only_one
from .options import Encoders, Photos, Verb, new_output, overwrite
from .query_options import asked, open_with, query_of, query_text

if TYPE_CHECKING:
    import numpy as np

    from ...authoring.editing.edits import KeptEdits
    from ...authoring.exporting.writing import Exported
    from ...formats.tiles import Tiles
    from ...query import Query, Scene
    from ...scene.labelled import LabelledScene
    from ...scene.views import View
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


class _Given(NamedTuple):
    """Inputs of an export.

    named: the files that were named, the scene first. tiles: they are written as they are. opened: a scene with its
    field. views: photos of a scene that has none.
    """

    named: list[Path]
    tiles: Tiles | None
    opened: Scene | None
    query: Query | None
    words: str
    views: Sequence[View]


def run(options: Options) -> Facts:
    from ...authoring.exporting.writing import written, written_streamed_sog

    output = _output(options)
    given = _given(options, output)
    if options.masks:
        facts = _masks(options, given)
    elif options.tiles3d:
        facts = _tiles3d(options, given)
    elif given.tiles is not None:  # levels of detail, for which a few of the tiles are in memory at a time
        facts = _facts(written_streamed_sog(output, given.tiles, options.overwrite))
    else:
        scene = _labelled(options, given)
        done = written(output, scene, options.overwrite, options.content.spz_version)
        facts = _facts(done, scene.query, scene.object_of)
    return {"scene": options.source, "saved": options.output, **facts}


def show(answer: Facts) -> None:
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


def _given(options: Options, output: Path) -> _Given:
    """Read what is written. Raises: InputError: options that do not go together; as what reads it."""
    part_of = only_one(options.asked, ("only", "object", "label"))
    subject = only_one(options.asked, QUERIES)
    if part_of == "only" and subject is None:
        raise InputError("only: what matches is that of a query: give --query WORDS")
    named = [Path(path) for path in (options.source, options.scene, options.field) if path is not None]
    tiles = None if part_of or subject else _whole_tiles(options, output, named)
    if tiles is None:
        field, scene = _field(options, subject)
    else:  # the Gaussians of their field stay on the disk
        field, scene = options.field or (options.scene and options.source), None
    views: Sequence[View] = ()
    if tiles is None and field is None and not options.masks and options.content.photos:
        if options.views is None:
            raise InputError("photos: a scene without a field has none of its own: pass views=CAPTURE as well")
        views = options.photos.views(options.views)
    opened = None if field is None or (tiles is not None and not options.tiles3d) else open_with(options, field, scene)
    query, words = (None, "") if subject is None else (query_of(options.asked), query_text(options.asked))
    return _Given(named, tiles, opened, query, words, views)


def _output(options: Options) -> Path:
    """Return the output. Raises: InputError: it cannot be written."""
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
    return output


def _whole_tiles(options: Options, output: Path, named: list[Path]) -> Tiles | None:
    """Return the tiles that are written as they are; None for another scene, or an edited one."""
    from ...authoring.editing import EditFile
    from ...formats.streamed_sog import LOD_META
    from ...formats.tiles import TILES, read_tiles

    content, tiles = options.content, next((path for path in named if (path / TILES).is_file()), None)
    is_in_levels = not options.masks and (options.tiles3d or output.name == LOD_META)
    if tiles is None or not is_in_levels or content.embeddings or options.time is not None:
        return None
    if content.edits != "none" and EditFile.beside(tiles).num_done():
        return None
    if content.fit_8bit:
        raise InputError("fit_8bit: the scene is cut into tiles, whose colours are written as they are")
    return read_tiles(tiles)


def _field(options: Options, subject: str | None) -> tuple[str | None, str | None]:
    """Return the field, None where there is none, and its scene. Raises: InputError: options that need a field."""
    from ...formats.scenes import Kind, recognised

    source, content = Path(options.source), options.content
    if recognised(source) is Kind.FIELD or (source.is_dir() and any(source.glob("*.field"))):
        if options.field is not None:
            raise InputError(f"{options.source} has a field already: drop --field, or name the scene's file")
        return options.source, options.scene
    if options.scene is not None:
        raise InputError("--scene is the scene of a field: name the field first, or pass the scene and --field FIELD")
    chosen = subject is not None or content.embeddings or (content.object, content.label) != (None, None)
    if options.field is None and chosen:
        raise InputError("queries, objects and labels need the field of the scene: pass field=FIELD")
    return options.field, options.source


def _masks(options: Options, given: _Given) -> Facts:
    """Write masks of the photos. Raises: InputError: as `write_masks`; a scene without a field."""
    from ...authoring.exporting.masking import write_masks

    if given.opened is None:
        raise InputError("masks are drawn of what a field knows: pass field=FIELD as well")
    done = write_masks(options.output, given.opened, given.query, overwrite=options.overwrite)
    return {"format": "masks", **done._asdict()}


def _tiles3d(options: Options, given: _Given) -> Facts:
    """Write 3D Tiles, where the scene lies on the Earth if a georeference.json beside it says so."""
    from ...authoring.exporting.writing import tiled, written_tiles3d
    from ...formats.georeference import read_georeference

    folders = [path if path.is_dir() else path.parent for path in given.named] + [path.parent for path in given.named]
    earth, output = read_georeference(*folders), Path(options.output)
    if given.tiles is not None:
        source = tiled(given.tiles, given.opened)
        return _facts(written_tiles3d(output, source, earth, options.overwrite), owners=source.object_of)
    scene = _labelled(options, given)
    return _facts(written_tiles3d(output, scene, earth, options.overwrite), scene.query, scene.object_of)


def _labelled(options: Options, given: _Given) -> LabelledScene:
    """Return the scene that is written, with what its field knows if it has one."""
    from ...authoring.editing import EditFile
    from ...authoring.editing.resolving import label_rows, object_rows
    from ...authoring.exporting.writing import Only, for_8_bits, labelled, labelled_alone, whole_motion
    from ...formats.moving_scenes import read_scene
    from ...scene.moving import canonical_of

    content, opened, path = options.content, given.opened, given.named[0]
    read = read_scene(path) if opened is None else opened.motion or opened.gaussians
    place, edits = path if opened is None else opened.path, content.edits or "kept"
    if edits == "none" and place is not None:
        note_left_out(EditFile.beside(place).num_done(canonical_of(read)))
    motion, time = whole_motion(Path(options.output), read, options.time)
    if opened is None:
        scene = replace(labelled_alone(read, path, time=time, edits=edits), views=tuple(given.views))
    else:
        only: Only = "matches" if content.only else None
        if content.object is not None:
            only = object_rows(opened, content.object)
        elif content.label is not None:
            only = label_rows(opened, content.label)
        scene = labelled(
            opened, given.query, only=only, time=time, edits=edits, embeddings=content.embeddings,
            photos=content.photos, words=given.words,
        )  # fmt: skip
    note_applied(scene.num_edits)
    scene = replace(scene, motion=motion)
    return for_8_bits(scene) if content.fit_8bit else scene


def _facts(done: Exported, query: str = "", owners: np.ndarray | None = None) -> Facts:
    """Return what was written. owners: per Gaussian its object, -1 for none; None where there are no objects."""
    return {
        "format": done.format,
        "bytes": done.bytes,
        "query": query or None,
        "num_gaussians": done.num_gaussians,
        "num_objects": None if owners is None else done.num_objects,
        "num_in_objects": None if owners is None else int((owners >= 0).sum()),
        "num_matches": done.num_matches if query else None,
        "num_annotations": done.num_annotations,
        "num_edits": done.num_edits,
        "lacks": done.lacks,
    }
