"""Opening scenes: folders and files become a scene that can be queried."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from ..base.contents import AnyPath
from ..errors import DrSplatWarning, InputError, MismatchError
from ..field import LanguageField, load_field
from ..field.labels import LabelFile
from ..formats.field_folder import MANIFEST
from ..formats.gaussian_ply import was_edited
from ..formats.georeference import read_georeference
from ..formats.known import SCENE_SUFFIXES
from ..formats.live_views import ADDED_POSES
from ..formats.moving_scenes import is_moving, is_sequence, read_scene
from ..formats.scan_record import MODEL, read_scan_record
from ..formats.scenes import FIELD_SUFFIX, MOTION, Kind, mistaken, recognised
from ..formats.tiles import TILES, Tiles, read_tiles
from ..photos.models.loading import DEFAULT_ENCODER, load_encoder
from ..scene.gaussians import Gaussians
from ..scene.moving import Moving, canonical_of
from ..scene.views import View
from .encoding import Load, encoder_for
from .scene import Scene

S = TypeVar("S", bound=Gaussians | Moving | Tiles)

EDITS_ENDING = ".edits.json"  # of NAME.ply, NAME.edits.json: a scene that people work on
COPY_ENDINGS = (".glb", ".gltf", ".usda", ".usdc", ".usdz")
"""Suffixes of files with the same rows that `drsplat export` writes; what people trained is another file."""
CAMERA_FILES = ("sparse", "transforms.json", "cameras.json", "colmap", ADDED_POSES)


@dataclass(frozen=True)
class SceneFiles:
    """The files that a scene is read from. scenes: candidates; the one that the field was registered on is taken.

    capture: poses and photos, or None. encoder: of words, where a scan says that it is the default one, else None.
    """

    name: str
    field: Path
    scenes: tuple[Path, ...]
    capture: Path | None = None
    encoder: str | None = None


def find_scene(folder: AnyPath) -> SceneFiles:
    """Find the files of a folder that `drsplat demo` or `drsplat scan` wrote: one *.field, a scene, perhaps a capture.

    Raises: InputError: no such folder, not exactly one field, no scene. FormatError: a damaged record of a scan.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise mistaken(folder, Kind.FIELD)
    entries = sorted(folder.iterdir())
    fields = [path for path in entries if path.suffix == FIELD_SUFFIX and path.is_dir()]
    if not fields:
        raise mistaken(folder, Kind.FIELD)
    if len(fields) > 1:
        raise InputError(f"{folder}: expected one field, got {', '.join(map(str, fields))}: name the one that you mean")
    scan = read_scan_record(folder)
    name = folder.resolve().name
    if scan is not None:
        capture = folder / scan["capture"]
        encoder = scan["models"].get("encoder")
        return SceneFiles(
            name, fields[0], (folder / MODEL,), capture if capture.is_dir() else None,
            encoder if encoder == DEFAULT_ENCODER else None,  # no other model is fetched because a folder names it
        )  # fmt: skip
    files = [path for path in entries if path.suffix.lower() in SCENE_SUFFIXES and path.is_file()]
    scenes = [path for path in files if recognised(path) is not Kind.MESH]
    scenes = [path for path in entries if _is_folder_of_a_scene(path)] + scenes
    if (folder / "point_cloud").is_dir():
        scenes.append(folder)
    edited = {path.name.removesuffix(EDITS_ENDING) for path in entries if path.name.endswith(EDITS_ENDING)}
    # what was saved of a scene lies beside it with the same rows
    scenes.sort(
        key=lambda path: (
            path.stem not in edited,
            path.suffix.lower() in COPY_ENDINGS,
            path.is_file() and was_edited(path),
        )
    )
    if not scenes:
        kinds = f"{', '.join(SCENE_SUFFIXES)}, a folder NAME.motion, one of numbered PLY files, or one of tiles"
        raise InputError(f"{folder}: expected a scene ({kinds}) beside the field")
    has_capture = any((folder / camera).exists() for camera in CAMERA_FILES)
    return SceneFiles(name, fields[0], tuple(scenes), folder if has_capture else None)


def _is_folder_of_a_scene(path: Path) -> bool:
    """Return True for NAME.motion, tiles and numbered PLY files; most folders hold photos, which are many."""
    if (path / MOTION).is_file() or (path / TILES).is_file():
        return True
    return next(path.glob("*[0-9].[pP][lL][yY]"), None) is not None and is_sequence(path)


def scene_files(path: AnyPath, scene: AnyPath | None = None, views: AnyPath | None = None) -> SceneFiles:
    """Find the files of a field or of a folder with one; a given scene or views replace what lies there.

    Raises: as `find_scene`.
    """
    path = Path(path)
    is_field = (path / MANIFEST).exists() or path.suffix == FIELD_SUFFIX or not path.is_dir()
    found = SceneFiles(path.stem, path, ()) if is_field else find_scene(path)
    if scene is not None:
        found = replace(found, scenes=(Path(scene),))
    return found if views is None else replace(found, capture=Path(views))


def open_scene(
    path: AnyPath | SceneFiles,
    *,
    scene: AnyPath | None = None,
    views: AnyPath | None = None,
    encoder: str | None = None,
    vocabulary: str | None = None,
    device: str = "auto",
    search_device: str = "cpu",
    threads: int = 0,
    images: AnyPath | None = None,
    dataparser_transforms: AnyPath | None = None,
    max_side: int | None = None,
    times: AnyPath | None = None,
    load: Load | None = None,
) -> Scene:
    """Open a folder with a field, its scene and photos, or a field (NAME.field) alone.

    scene, views: the Gaussians that were registered and the capture, where they lie elsewhere. A field without
    Gaussians selects, but cannot tell places. encoder, vocabulary, device: who embeds words; fields of the built-in
    encoders need none. search_device: where the field is searched, see `load_field`. images, dataparser_transforms,
    max_side, times: as for `read_views`. load: see `encoder_for`.
    The encoder and the photos are looked at when they are first needed.

    Raises: InputError: files are missing. FormatError: damaged files. MismatchError: the field is of
    none of the scenes. MissingExtraError: search device "cuda" without CuPy or a GPU.

    >>> scene = ds.open_scene("room.field", scene="scene.ply", views="capture")
    >>> len(scene.views), len(scene.objects)
    (4, 2)
    """
    files = path if isinstance(path, SceneFiles) else scene_files(path, scene, views)
    if encoder is None and vocabulary is None:
        encoder = files.encoder
    field = load_field(files.field, search_device=search_device)
    file, gaussians = _registered(files, field, tiles_or_scene) if files.scenes else (None, None)

    def photos() -> Sequence[View]:
        if files.capture is None:
            return ()
        from ..formats.captures import read_views

        with warnings.catch_warnings():  # of photos that are missing; the views stay
            warnings.simplefilter("ignore", DrSplatWarning)
            return read_views(
                files.capture,
                images=None if images is None else Path(images),
                dataparser_transforms=None if dataparser_transforms is None else Path(dataparser_transforms),
                max_side=max_side,
                times=None if times is None else str(times),
            )

    return Scene(
        field,
        gaussians,
        photos,
        lambda: encoder_for(field, vocabulary, encoder, device, load or load_encoder),
        name=files.name,
        threads=threads,
        labels=LabelFile.beside(files.field),
        path=file,
        georeference=lambda: read_georeference(
            files.field.parent, files.capture, None if file is None else file.parent
        ),
    )


def tiles_or_scene(path: Path) -> Gaussians | Moving | Tiles:
    """Read a scene; of one in tiles nothing but the manifest. Raises: as `read_scene` and `read_tiles`."""
    folder = path.parent if path.name == TILES else path
    return read_tiles(folder) if (folder / TILES).is_file() else read_scene(path)


def registered_scene(files: SceneFiles, field: LanguageField | None = None) -> tuple[Path, Gaussians | Moving]:
    """Find and read the scene that the field was registered on; others, such as saved answers, may lie beside it.

    field: the field of the files where it is loaded already. Raises: MismatchError: it is of none of them.
    """
    return _registered(files, field or load_field(files.field), read_scene)


def _registered(files: SceneFiles, field: LanguageField, read: Callable[[Path], S]) -> tuple[Path, S]:
    """Find the scene that the field was registered on, with what reads scenes. Raises: as `registered_scene`."""
    moves = field.times is not None  # what was registered, where a film and its first frame lie side by side
    scenes = sorted(files.scenes, key=lambda path: is_moving(path) != moves)
    for number, path in enumerate(scenes):
        scene = read(path)
        try:
            field.check_scene(canonical_of(scene) if isinstance(scene, Moving) else scene)
        except MismatchError:
            if number == len(scenes) - 1:
                raise
            continue
        return path, scene
    raise InputError("no scene was given")
