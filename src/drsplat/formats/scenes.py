"""`read_gaussians`: any scene file in, by the table of `known`.

Recognition of what lies at a path, by names and first bytes, for errors about a thing in another's place.

Nothing is decoded and no file is read beyond its first bytes: this runs when something is wrong already.
"""

import re
from collections.abc import Iterator
from enum import Enum
from itertools import islice
from pathlib import Path

from ..base.contents import AnyPath, file_bytes, open_file
from ..errors import DrSplatError, FormatError, InputError, did_you_mean, placed, warn
from ..scene.gaussians import Gaussians
from ..scene.units import lost_precision
from .colmap import find_models
from .embedding_record import COMPACT, EMBEDDINGS
from .field_folder import MANIFEST
from .known import SCENE_SUFFIXES, format_at, parse_gaussians
from .photo_files import PHOTO_SUFFIXES
from .sog import META
from .streamed_sog import LOD_META
from .tiles import TILES
from .tiles3d_writing import TILESET

TRANSFORMS, TRAIN_TRANSFORMS, CAMERAS = "transforms.json", "transforms_train.json", "cameras.json"
MOTION = "motion.safetensors"
FIELD_SUFFIX = ".field"
_TORCH_NAME_BYTES = 256  # of an archive: its first member is NAME/data.pkl
_HEAD_BYTES = 4096  # a PLY's header names its properties within them
_SPLAT_EXTENSION = b"KHR_gaussian_splatting"
_MAX_GLTF_NAMES_BYTES = 1 << 20  # that are searched: the extension may be named anywhere in them
_MAX_FOLDER_ENTRIES = 2000  # that are looked at
_TUTORIAL = "docs/tutorials/from_a_phone.md has the steps"


class Kind(Enum):
    """A thing that people name: what it is called, and the way on from it where another was meant."""

    CAPTURE = "posed photos", "`drsplat train` makes a scene of them, `drsplat embed` the features of a field"
    SCENE = "a scene of Gaussians", "`drsplat register SCENE CAPTURE --features DIR --output NAME.field` makes a field"
    FIELD = "a field", "ask it with `drsplat locate FIELD WORDS`"
    FEATURES = "features of photos", "pass them as `--features` to `drsplat register SCENE CAPTURE`"
    PHOTOS = (
        "photos without poses",
        f"find the poses first: `drsplat capture PHOTOS --output capture`, or COLMAP's own program; {_TUTORIAL}",
    )
    UNREAD_PHOTOS = (
        "photos that cannot be read as they are (HEIC, AVIF or raw)",
        f"`drsplat capture PHOTOS --output capture` finds poses and reads HEIC; convert others to JPEG; {_TUTORIAL}",
    )
    VIDEO = (
        "a video",
        f"`drsplat capture VIDEO --output capture` takes sharp pictures of it and finds their poses; {_TUTORIAL}",
    )
    PHOTO = "a single photo", "name the folder that holds the photos and their poses"
    ARCHIVE = "an archive", "unpack it and name the folder"
    DATABASE = "COLMAP's database without a model", "run `colmap mapper`, then name the folder above sparse/0"
    CHECKPOINT = (
        "a checkpoint of PyTorch, which is never opened because it can run code",
        "export a PLY with the program that wrote it: nerfstudio by `ns-export gaussian-splat --load-config config.yml "
        "--output-dir exports`, gsplat by `simple_trainer.py --save_ply` or `gsplat.export_splats`, 3DGS writes "
        "point_cloud/iteration_N/point_cloud.ply beside it",
    )
    MESH = "a mesh", "Gaussians are made of photos: `drsplat train CAPTURE` makes a scene"
    POINTS = "points without Gaussians", "Gaussians are made of photos: `drsplat train CAPTURE` makes a scene"
    TILES3D = "3D Tiles", "drsplat writes them and does not read them: name the scene that they are of"
    RECORDING = "a recording of rerun", "drsplat writes such and does not read them: name the scene that it is of"
    EMPTY = "an empty folder", "name the folder that holds the files"
    OTHER = "something else", "`drsplat inspect PATH` describes what can be read"

    def __init__(self, called: str, way: str) -> None:
        self.called, self.way = called, way


EXPECTED = {
    Kind.CAPTURE: "posed photos (a folder with a COLMAP model: cameras and images in sparse/0, .bin or .txt; or with "
    f"a {TRANSFORMS}, {TRAIN_TRANSFORMS} or {CAMERAS})",
    Kind.SCENE: f"a scene ({', '.join(SCENE_SUFFIXES)}, a trained model's folder, tiles or NAME.motion)",
    Kind.FIELD: "a searchable scene (a folder that `drsplat demo` or `drsplat scan` wrote, or a field, NAME"
    f"{FIELD_SUFFIX}, as `drsplat register` writes it)",
    Kind.FEATURES: f"features of photos (*{COMPACT}, as `drsplat embed` writes them, or *{EMBEDDINGS})",
}
_WAYS = {
    (Kind.CAPTURE, Kind.SCENE): "name the photos that this scene was trained from, with their poses",
    (Kind.CAPTURE, Kind.FIELD): "name the photos that the scene of this field was trained from, with their poses",
    (Kind.CAPTURE, Kind.FEATURES): "name the photos that they are of, with their poses",
    (Kind.SCENE, Kind.FIELD): "name the scene that this field was registered on",
    (
        Kind.SCENE,
        Kind.CAPTURE,
    ): "`drsplat train CAPTURE --output-dir model` makes a scene of them; a verb that takes both takes the scene first",
    (Kind.FIELD, Kind.CAPTURE): "`drsplat train`, `embed` and `register` make a field of them, as "
    "docs/tutorials/from_a_phone.md shows",
    (Kind.FEATURES, Kind.CAPTURE): "`drsplat embed CAPTURE` makes features of them",
}
_WRITTEN_ONLY = (Kind.TILES3D, Kind.RECORDING)  # beside which lies what is a part of them, if anything
_VIDEOS = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mts", ".mpg", ".insv")
_UNREAD = (".heic", ".heif", ".avif", ".dng", ".cr2", ".cr3", ".nef", ".arw", ".raw")
_SUFFIXES = {
    **dict.fromkeys((suffix.lower() for suffix in PHOTO_SUFFIXES), Kind.PHOTO),
    **dict.fromkeys(SCENE_SUFFIXES, Kind.SCENE),
    **dict.fromkeys(_VIDEOS, Kind.VIDEO),
    **dict.fromkeys(_UNREAD, Kind.UNREAD_PHOTOS),
    **dict.fromkeys((".zip", ".tar", ".tgz", ".gz", ".7z", ".rar"), Kind.ARCHIVE),
    **dict.fromkeys((".obj", ".fbx", ".stl", ".dae", ".blend"), Kind.MESH),
    **dict.fromkeys((".las", ".laz", ".e57", ".pcd", ".xyz"), Kind.POINTS),
    **dict.fromkeys((COMPACT, EMBEDDINGS), Kind.FEATURES),
    **dict.fromkeys((".ckpt", ".pt", ".pth", ".pkl"), Kind.CHECKPOINT),
    ".db": Kind.DATABASE,
    TILESET: Kind.TILES3D,
    ".rrd": Kind.RECORDING,
}
_HEADS = {
    b"\xff\xd8\xff": Kind.PHOTO, b"\x89PNG": Kind.PHOTO, b"NGSP": Kind.SCENE, b"\x1aE\xdf\xa3": Kind.VIDEO,
    b"7z\xbc\xaf": Kind.ARCHIVE, b"Rar!": Kind.ARCHIVE, b"LASF": Kind.POINTS,
    b"SQLite format 3": Kind.DATABASE, b"\x80\x02": Kind.CHECKPOINT,
}  # fmt: skip
STILL_BRANDS = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"mif1", b"msf1", b"avif")
_IN_FOLDERS = {Kind.PHOTO: Kind.PHOTOS, Kind.SCENE: Kind.OTHER}  # a scene beside other files is not the folder's kind


def recognised(path: Path) -> Kind | None:
    """Return what a file or a folder is, Kind.OTHER where that is not known, None where there is nothing."""
    try:
        if path.is_dir():
            return _folder_kind(path)
        return _file_kind(path) if path.exists() else None
    except (OSError, DrSplatError):  # no right to read it, a pipe
        return Kind.OTHER


def mistaken(path: Path, wanted: Kind) -> InputError:
    """Return the error for a path at which a thing of another kind lies, or nothing."""
    try:
        with open_file(path):
            pass
    except FormatError as error:  # what lies there in place of a file
        return InputError(str(error))
    except (OSError, InputError):
        pass
    kind = recognised(path)
    if kind is None:
        return InputError(f"{path}: there is no such file or folder.{_sibling(path)} Expected {EXPECTED[wanted]}")
    expected = EXPECTED[wanted] if kind in (Kind.EMPTY, Kind.OTHER) else wanted.called
    nearby = () if kind in _WRITTEN_ONLY else _nearby(path)
    near = next((other for other in nearby if _serves(other, wanted)), None)
    way = _WAYS.get((wanted, kind), kind.way) if near is None else f"did you mean {near}?"
    return InputError(f"{path}: got {kind.called}, expected {expected}: {way}")


def _sibling(path: Path) -> str:
    """Return the names that are near, of what lies in the same folder."""
    try:
        return did_you_mean(path.name, [entry.name for entry in islice(path.parent.iterdir(), _MAX_FOLDER_ENTRIES)])
    except OSError:
        return ""


def _serves(path: Path, wanted: Kind) -> bool:
    """Return whether it is what was wanted; a folder that has a field serves as one."""
    if wanted is Kind.FIELD and any(path.glob(f"*{FIELD_SUFFIX}/{MANIFEST}")):
        return True
    return recognised(path) is wanted


def _nearby(path: Path) -> Iterator[Path]:
    """Yield the folder above where one was named, and what lies in a folder."""
    if len(path.parts) > 1:
        yield path.parent
    if path.is_dir():
        yield from islice(sorted(islice(path.iterdir(), _MAX_FOLDER_ENTRIES)), 50)


def _file_kind(path: Path) -> Kind:
    with open_file(path) as file:
        head = file.read(_HEAD_BYTES)
        if head[:4] == b"glTF" or path.name.lower().endswith(".gltf"):
            return Kind.SCENE if _SPLAT_EXTENSION in head + file.read(_MAX_GLTF_NAMES_BYTES) else Kind.MESH
    by_suffix = next((kind for suffix, kind in _SUFFIXES.items() if path.name.lower().endswith(suffix)), Kind.OTHER)
    if head[4:8] == b"ftyp":
        return Kind.UNREAD_PHOTOS if head[8:12] in STILL_BRANDS else Kind.VIDEO
    if head[:4] == b"RIFF":
        return Kind.VIDEO if head[8:12] == b"AVI " else Kind.PHOTO
    if head[:4] == b"PK\x03\x04" and b"/data.pkl" in head[:_TORCH_NAME_BYTES]:
        return Kind.CHECKPOINT
    if head[:4] == b"PK\x03\x04" and by_suffix is not Kind.SCENE:  # SOG is a zip
        return Kind.ARCHIVE
    if head[:3] == b"ply" and b"element vertex" in head:
        gaussian = any(name in head for name in (b" f_dc_0", b" packed_position", b" scale_0", b" rot_0"))
        return Kind.SCENE if gaussian else Kind.MESH if b"element face" in head else Kind.POINTS
    return next((kind for start, kind in _HEADS.items() if head.startswith(start)), by_suffix)


def _folder_kind(path: Path) -> Kind:
    if (path / MANIFEST).is_file():
        return Kind.FIELD
    if (path / TILESET).is_file():
        return Kind.TILES3D
    if any((path / mark).exists() for mark in (TILES, MOTION, LOD_META, "point_cloud")):
        return Kind.SCENE
    if any((path / mark).is_dir() for mark in ("nerfstudio_models", "ckpts")):
        return Kind.CHECKPOINT
    if find_models(path) or any((path / name).is_file() for name in (TRANSFORMS, TRAIN_TRANSFORMS, CAMERAS)):
        return Kind.CAPTURE
    return _kind_of_most(path)


def _kind_of_most(path: Path) -> Kind:
    """Return the kind of most files, by their names; of those of "images" where there is such a folder."""
    names = [entry.name.lower() for entry in islice(path.iterdir(), _MAX_FOLDER_ENTRIES)]
    if not names:
        return Kind.EMPTY
    if "images" in names and (path / "images").is_dir():
        inner = _kind_of_most(path / "images")
        return Kind.DATABASE if inner is Kind.PHOTOS and "database.db" in names else inner
    kinds = [kind for name in names for suffix, kind in _SUFFIXES.items() if name.endswith(suffix)]
    most = max(kinds, key=kinds.count, default=Kind.OTHER)
    return _IN_FOLDERS.get(most, most)


def read_gaussians(path: AnyPath) -> Gaussians:
    """Read a scene: PLY of 3DGS, compressed PLY, SPZ 2-4, SOG, KSPLAT, `.splat`, GLB, USD, tiles, or a model.

    The format is told by the file's first bytes; `.splat` and `.gltf`, which have no mark, by their suffix.
    In a folder, its tiles, its SOG (meta.json; lod-meta.json of a streamed one, the finest level; they may be named
    themselves) or the PLY of the highest `point_cloud/iteration_*` is read. Row order is the file's.
    The result is in the axes of the trained scene (RDF for SPZ, see formats.spz) and owns its
    memory. A scene far from zero for its size is counted from a local origin (`placing.local_origin`).

    Warns: DrSplatWarning: such a scene in a file of float32 positions, which have lost precision already.
    Raises: InputError: nothing at `path`. FormatError: a format that is not known, a damaged or truncated file, or rows
    that are no Gaussians; the message says how many, which is the first, and the cure.

    >>> len(ds.read_gaussians("scene.ply"))
    300
    """
    path = scene_file(Path(path))
    try:
        known = format_at(path)
        if known is not None and known.read is not None:
            scene = known.read(path)
            return scene if path.name == TILES else local(scene, str(path))  # tiles have their origin
        content = file_bytes(path)
        if not content.size:
            raise FormatError("the file is empty")
        return local(parse_gaussians(content.data, path.suffix), str(path))
    except FormatError as error:
        if recognised(path) not in (Kind.SCENE, Kind.OTHER):
            raise mistaken(path, Kind.SCENE) from None
        raise FormatError(placed(path, error)) from None


def local(gaussians: Gaussians, where: str) -> Gaussians:
    """Move Gaussians far from zero to a local origin, and warn of what float32 has lost by then."""
    for loss in lost_precision(gaussians):
        warn(f"{where}: {loss}", 3)
    return gaussians.localized()


def scene_file(path: Path) -> Path:
    """Return the scene file at `path`, or in that folder: tiles, a SOG, or the latest PLY of a trained model.

    Raises: InputError: there is none.
    """
    if path.is_file():
        return path
    of_folder = next((path / mark for mark in (TILES, LOD_META) if (path / mark).is_file()), None)
    if of_folder is not None:
        return of_folder
    if not path.is_dir():
        raise mistaken(path, Kind.SCENE)
    found = {
        int(match[1]): ply
        for ply in path.glob("point_cloud/iteration_*/point_cloud.ply")
        if (match := re.fullmatch(r"iteration_(\d{1,9})", ply.parent.name))
    }
    if not found and (path / META).is_file():
        return path / META
    if not found:
        raise mistaken(path, Kind.SCENE)
    return found[max(found)]


def companion(scene: AnyPath, kind: str) -> Path:
    """Return the path of a file beside a scene: NAME.kind.json of the file NAME.ply, or of the folder NAME."""
    path = Path(scene)
    path = path.resolve() if path.is_dir() else path
    return path.with_name(f"{path.name if path.is_dir() else path.stem}.{kind}.json")
