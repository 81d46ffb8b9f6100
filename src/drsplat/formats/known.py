"""Formats of scenes, each a record: how it is told, read and written, and what it keeps. To add one, add its row here.

`scenes.read_gaussians` and `write_scene` find their way in `FORMATS`, and so do errors, `drsplat export` and the table
of docs/formats.md, which `python -m scripts.made_tables` writes.

Named objects that a scene's file holds beside its Gaussians, whatever its format.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..base.contents import AnyPath
from ..errors import FormatError, InputError, did_you_mean
from ..scene.gaussians import Gaussians
from ..scene.labelled import LabelledScene
from .activation import refuse_packed_name, refuse_unwritable
from .gaussian_ply import is_compressed, parse_compressed_ply, parse_gaussian_ply, write_gaussians
from .glb import labels_in_glb, parse_glb, read_glb
from .glb_writing import write_glb
from .gltf import MAGIC as GLB_MAGIC
from .ksplat import MAGIC as KSPLAT_MAGIC
from .ksplat import parse_ksplat
from .labels import NAMES_SUFFIX, Labels, labels_bytes, parse_labels
from .ply import MARK, read_header
from .replacing import replacing, together
from .rerun_writing import write_rrd
from .sog import META, ZIP_MAGIC, parse_sog, read_sog_labels, read_unpacked_sog
from .sog_writing import sog_bytes
from .splat import parse_splat
from .spz import MAGIC as SPZ_MAGIC
from .spz import parse_spz, read_spz_labels
from .spz_writing import spz4_bytes, spz_bytes
from .streamed_sog import LOD_META, read_streamed_labels, read_streamed_sog, write_streamed_sog
from .tiles import TILES, read_tiles
from .tiles3d_writing import write_tiles3d
from .usd import SUFFIXES as USD_SUFFIXES
from .usd import TEXT as USD_TEXT
from .usd import parse_usd, read_usd
from .usd_writing import write_usd

Writer = Callable[[Path, LabelledScene, bool], None]
GZIP_DEFLATE = b"\x1f\x8b\x08"
TILES3D, SPZ_4 = "3D Tiles", ".spz, version 4"  # formats that no suffix says
ASPECTS: Mapping[str, str] = {
    "numbers": "object of each Gaussian",
    "names": "names and boxes of objects",
    "relevancy": "relevancy of each Gaussian",
    "matches": "boxes of matches",
    "annotations": "annotations",
    "embeddings": "embeddings of objects",
    "columns": "further columns of the scene",
    "surfels": "mark that its Gaussians are surfels (2DGS)",
    "photos": "photos",
}


@dataclass(frozen=True)
class SceneFormat:
    """A format of scenes.

    Attributes:
        name: what errors call it.
        suffixes: of its files, in lower case.
        by_suffix: tells files without a mark by their suffix.
        marks: beginnings of its files, one of which tells it whatever the suffix is.
        files: names of the files that a folder of it has; they may be named themselves.
        parse: reads the bytes of a file.
        read: reads a file that others lie beside; None where `parse` is enough.
        write: writers by the suffix or name that asks for them.
        holds: what of a `LabelledScene` it keeps, of `ASPECTS`.
        row: its row in the table of docs/formats.md; "" where another format has it.
    """

    name: str
    suffixes: tuple[str, ...] = ()
    by_suffix: bool = False
    marks: tuple[bytes, ...] = ()
    files: tuple[str, ...] = ()
    parse: Callable[[memoryview], Gaussians] | None = None
    read: Callable[[Path], Gaussians] | None = None
    write: Mapping[str, Writer] = field(default_factory=dict)
    holds: frozenset[str] = frozenset()
    row: str = ""


def _parse_ply(content: memoryview) -> Gaussians:
    header = read_header(content)
    return (parse_compressed_ply if is_compressed(header) else parse_gaussian_ply)(content, header)


def _write_ply(path: Path, scene: LabelledScene, overwrite: bool) -> None:
    with together():
        write_gaussians(path, scene.gaussians, scene.columns, overwrite, is_edited=scene.num_edits > 0)
        if scene.things:
            with replacing(path.with_suffix(NAMES_SUFFIX), overwrite) as file:
                file.write(labels_bytes(scene))


def _encoded_by(encode: Callable[[LabelledScene], bytes]) -> Writer:
    """Return a writer of what a function encodes in memory."""

    def write(path: Path, scene: LabelledScene, overwrite: bool) -> None:
        content = encode(scene)
        with replacing(path, overwrite=overwrite) as file:
            file.write(content)

    return write


_NAMED = frozenset({"numbers", "names", "relevancy"})
_ALMOST_ALL = frozenset(ASPECTS) - {"columns", "photos"}
FORMATS = (
    SceneFormat(
        "PLY", suffixes=(".ply",), marks=(b"ply\n", b"ply\r"), parse=_parse_ply, write={".ply": _write_ply},
        holds=_NAMED | {"columns", "surfels"},
        row="| 3DGS PLY `.ply` | yes | yes | binary of either byte order, ASCII; properties by name, of a float type "
        "or [as other programs mean them](#files-of-other-programs); SH degree 0 to 3; further scalar properties, "
        "in `Gaussians.extra`; infinite opacity logits; no `scale_2`: [surfels](#surfels) | meshes and point "
        "clouds: train them first; linear light: export in sRGB; rows that are no Gaussians: delete them in "
        "SuperSplat or with `splat-transform --filter-nan` |",
    ),
    SceneFormat(
        "compressed PLY", parse=_parse_ply,
        row="| SuperSplat compressed PLY | yes | no | chunks of 256, with and without colour bounds, SH element | "
        "counts that do not fit |",
    ),
    SceneFormat(
        "SPZ", suffixes=(".spz",), marks=(SPZ_MAGIC, GZIP_DEFLATE), parse=parse_spz,
        write={".spz": _encoded_by(lambda scene: spz_bytes(scene.gaussians))},
        row="| SPZ `.spz` | 2, 3, 4 | 3, by [`drsplat export`](export.md) and in pages; 4 with "
        "`formats/spz_writing.py` ([objects](#objects-in-an-spz)) | extension 0xADBE0003 (axes); several gzip "
        "members; SH degree 4 is cut to 3 with a warning | version 1, level-of-detail trees: export again without |",
    ),
    SceneFormat(
        SPZ_4, write={SPZ_4: _encoded_by(spz4_bytes)}, holds=_NAMED,
    ),
    SceneFormat(
        "SOG", suffixes=(".sog",), marks=(ZIP_MAGIC,), files=(META,), parse=parse_sog, read=read_unpacked_sog,
        write={".sog": _encoded_by(sog_bytes)}, holds=_NAMED | {"surfels"},
        row="| SOG `.sog`, or the folder with its `meta.json` | 1, 2 | 2, `.sog` ([objects](#objects-in-a-sog)) | | "
        "lossy or animated WebP; pictures far larger than their count |",
    ),
    SceneFormat(
        "streamed SOG", files=(LOD_META,), read=read_streamed_sog, write={LOD_META: write_streamed_sog},
        holds=_NAMED | {"surfels"},
        row="| streamed SOG, the folder with its `lod-meta.json` | 1 | 1, of a scene or of tiles "
        "([levels](#streamed-sog)) | the finest level, then the environment; in Python any level | chunks that are "
        "missing or outside of the folder |",
    ),
    SceneFormat(
        ".splat", suffixes=(".splat",), by_suffix=True, parse=parse_splat,
        row="| `.splat` | yes | no | told by its suffix; SH degree 0 | a size that is no multiple of 32 bytes |",
    ),
    SceneFormat(
        "KSPLAT", suffixes=(".ksplat",), by_suffix=True, marks=(KSPLAT_MAGIC,), parse=parse_ksplat,
        row="| KSPLAT `.ksplat` | 0.1 | no | levels 0 to 2; SH degree 0 to 2, [layout](#ksplat) | sections that are "
        "not exactly the file; a scene saved before it was loaded: export it again |",
    ),
    SceneFormat(
        "GLB", suffixes=(".glb",), marks=(GLB_MAGIC,), parse=parse_glb, write={".glb": write_glb}, holds=_ALMOST_ALL,
        row="| GLB `.glb`, glTF `.gltf` with KHR_gaussian_splatting | yes | `.glb` | floats and the integers that the"
        " extension allows; nodes and primitives; SPZ within (`..._compression_spz_2`); numbers and names of "
        "objects, [layout](#glb) | linear light; transforms that shear; unknown required extensions; negative "
        "scales, the logarithms of drafts; buffers that are not right beside a `.gltf` |",
    ),
    SceneFormat(
        "glTF", suffixes=(".gltf",), by_suffix=True, parse=parse_glb, read=read_glb,
    ),
    SceneFormat(
        "USD", suffixes=USD_SUFFIXES, marks=(USD_TEXT,), parse=lambda content: parse_usd(content).gaussians,
        read=lambda path: read_usd(path).gaussians,
        write=dict.fromkeys((".usda", ".usdc", ".usdz"), write_usd), holds=_ALMOST_ALL,
        row="| OpenUSD `.usda`, `.usdc`, `.usdz`, `.usd` | 26.03 | `.usda`, `.usdc`, `.usdz` | "
        "ParticleField3DGaussianSplat, single and half precision; primvars with a number per Gaussian; reading, "
        'and binary files, need `pip install ".[usd]"` ([layout](#openusd)); SH degree above 3 is cut with a warning | '
        "linear light or other primaries: export in `srgb_rec709_scene`; splats in other files or variants: flatten "
        "the stage; splats that move; several splats of which some are moved: one file each |",
    ),
    SceneFormat(
        "trained model",
        row="| folder of a trained model | yes | no | the highest `point_cloud/iteration_*/point_cloud.ply` | a "
        "folder without one: name the file |",
    ),
    SceneFormat(
        "tiles", files=(TILES,), read=lambda path: read_tiles(path.parent).gaussians(),
        row="| tiles, the folder with its `tiles.json` | 1 | yes | [layout](#tiles) | damaged or missing tiles: cut "
        "the scene anew |",
    ),
    SceneFormat(
        TILES3D, write={TILES3D: lambda path, scene, overwrite: write_tiles3d(path, scene, overwrite=overwrite)},
        holds=frozenset({"numbers", "names"}),
        row="| 3D Tiles 1.1, a folder with its `tileset.json` | no | 1.1 | levels of detail, objects, a place on the "
        "Earth ([layout](#3d-tiles)) | |",
    ),
    SceneFormat(
        "rerun", write={".rrd": write_rrd}, holds=frozenset({"names", "matches", "annotations", "photos"}),
        row="| rerun `.rrd` | no | 0.41 | splats (unstable in its SDK), objects, groups and matches as named "
        "boxes, annotations, photos with cameras, motion on a timeline; needs `pip "
        'install ".[rerun]"` | |',
    ),
    SceneFormat(
        "LCC",
        row="| LCC, LCC2 and others | no | no | | convert first: `splat-transform scene.lcc scene.ply` |",
    ),
    SceneFormat(
        "checkpoints",
        row="| checkpoints of nerfstudio, gsplat and 3DGS (`.ckpt`, `.pt`, `.pth`) | no | no | | never opened, as "
        "they can run code: the error names the command that exports a PLY |",
    ),
)  # fmt: skip
WRITERS: Mapping[str, Writer] = {kind: write for one in FORMATS for kind, write in one.write.items()}
SCENE_SUFFIXES = tuple(suffix for one in FORMATS for suffix in one.suffixes)
WRITTEN = sorted(WRITERS.keys() - {SPZ_4, TILES3D})
"""Suffixes and names of files that a scene is written as."""


def format_at(path: Path) -> SceneFormat | None:
    """Return the format of files of this name that others lie beside; None where the bytes of one file are enough."""
    told = (one for one in FORMATS if path.name in one.files or path.suffix.lower() in one.suffixes)
    return next((one for one in told if one.read is not None and (path.name in one.files or not one.files)), None)


@np.errstate(all="ignore")  # what damaged floats do on the way is judged at its end, row by row
def parse_gaussians(buffer: memoryview, suffix: str = "") -> Gaussians:
    """Parse bytes in memory as `scenes.read_gaussians` does; `suffix` (".splat") decides only where no mark does.

    Raises: FormatError: as `read_gaussians`.
    """
    start = bytes(buffer[:19]).removeprefix(MARK)
    marked = (one for one in FORMATS if start.startswith(one.marks))
    named = (one for one in FORMATS if one.by_suffix and suffix.lower() in one.suffixes)
    for one in (*marked, *named):
        if one.parse is not None:
            return one.parse(buffer)
    names = [one.name for one in FORMATS if one.parse is not None and (one.marks or one.read is None)]
    raise FormatError(
        f"no scene format begins with {start[:4]!r}; {', '.join(names[:-1])} and {names[-1]} can be read. Convert "
        "others first, e.g. `splat-transform scene.lcc scene.ply`"
    )


def write_scene(path: AnyPath, scene: LabelledScene, overwrite: bool = False, *, spz_version: int = 3) -> None:
    """Write a scene as the suffix of `path` says; it appears whole or not at all.

    spz_version: 3, which most programs read, or 4, which keeps objects, names and relevancy, of a `.spz`.

    Raises: InputError: a suffix that nothing is written as, a scene without Gaussians or with numbers that are not
    finite, one that the format cannot hold, or `path` exists and not `overwrite`.
    """
    path = Path(path)
    kind = format_of(path, spz_version)
    writer_of(path)  # or the error that says what can be written
    # check a scene. Raises: InputError: what `refuse_unwritable` refuses, or relevancies that are not finite.
    refuse_unwritable(scene.gaussians)
    if scene.relevancy is not None and not np.isfinite(scene.relevancy).all():
        row = int(np.flatnonzero(~np.isfinite(scene.relevancy))[0])
        raise InputError(f"relevancies: expected finite numbers, got {scene.relevancy[row]} in row {row}: ask anew")
    WRITERS[kind](path, scene, overwrite)


def writer_of(path: Path) -> Writer:
    """Return the writer of a file of this name. Raises: InputError: there is none."""
    refuse_packed_name(path)
    if _kind(path) not in WRITTEN:
        near = did_you_mean(path.suffix.lower(), WRITTEN)
        raise InputError(f"{path.name}: expected a name that ends in {', '.join(WRITTEN)}.{near}")
    return WRITERS[_kind(path)]


def _kind(path: Path) -> str:
    return LOD_META if path.name == LOD_META else path.suffix.lower()


def format_of(path: Path, spz_version: int = 3) -> str:
    """Return which of `WRITERS` a file is of. Raises: InputError: another version of SPZ than 3 and 4."""
    if spz_version not in (3, 4):
        raise InputError(f"spz_version: expected 3 or 4, got {spz_version}")
    kind = _kind(path)
    return SPZ_4 if kind == ".spz" and spz_version == 4 else kind


def lacks(kind: str, scene: LabelledScene) -> tuple[str, ...]:
    """Return what of a scene a file of this suffix, or `TILES3D`, cannot hold, in sentences."""
    there = {
        "numbers": scene.object_of is not None,
        "names": bool(scene.things),
        "relevancy": scene.relevancy is not None,
        "matches": bool(scene.matches),
        "annotations": bool(scene.annotations),
        "embeddings": any(thing.embedding is not None for thing in scene.things),
        "columns": bool(scene.gaussians.extra),
        "surfels": scene.gaussians.surfels,
        "photos": bool(scene.views),
    }
    held = next(one.holds for one in FORMATS if kind in one.write)
    return tuple(f"{kind} keeps no {ASPECTS[name]}" for name, has in there.items() if has and name not in held)


MAX_OBJECT_NUMBER = (1 << 31) - 1  # Gaussians store it as int32
_BY_NAME = {LOD_META: read_streamed_labels, META: read_sog_labels}
_BY_SUFFIX = {".sog": read_sog_labels, ".spz": read_spz_labels, ".glb": labels_in_glb, ".gltf": labels_in_glb}


def read_labels(path: Path) -> Labels:
    """Return the names and boxes of the objects and groups in a file of drsplat, or beside a PLY; none in other files.

    path: a scene, or the folder of a streamed SOG.

    Raises: FormatError: damaged, or labels that are none. MissingExtraError: as `read_usd`.
    """
    path = path / LOD_META if (path / LOD_META).is_file() else path
    if path.suffix.lower() in USD_SUFFIXES:
        scene = read_usd(path)
        return _checked(Labels(scene.things, scene.groups, scene.query), path)
    beside = path.with_suffix(NAMES_SUFFIX)
    if path.suffix.lower() == ".ply" and beside.is_file():
        return _checked(parse_labels(beside.read_bytes(), str(beside)), beside)
    reader = _BY_NAME.get(path.name) or _BY_SUFFIX.get(path.suffix.lower())
    return Labels() if reader is None else _checked(reader(path), path)


def _checked(labels: Labels, path: Path) -> Labels:
    """Return labels. Raises: FormatError: a group that is not there, or a number that no Gaussian can have."""
    for thing in (*labels.things, *labels.groups):
        if not (-1 <= thing.parent < len(labels.groups) and -1 <= thing.number <= MAX_OBJECT_NUMBER):
            raise FormatError(
                f"{path}: '{thing.name:.40}': expected a group from -1 to {len(labels.groups) - 1} and a number from "
                f"-1 to {MAX_OBJECT_NUMBER}, got {thing.parent} and {thing.number}: damaged"
            )
    return labels
