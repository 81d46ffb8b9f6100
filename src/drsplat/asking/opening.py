"""From a folder, or from files, to a scene that can be asked."""

import warnings
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path

from ..adapters.loading import load_encoder
from ..boxes import up_of
from ..errors import DrSplatWarning, InputError, MismatchError
from ..field import LanguageField, load_field
from ..formats.captures import read_views
from ..formats.scenes import read_gaussians
from ..gaussians import Gaussians
from ..views import View
from .encoding import Load, encoder_for
from .scene import AskableScene

FIELD_SUFFIX = ".field"
SCENE_SUFFIXES = (".ply", ".spz", ".sog", ".splat", ".ksplat")
CAMERAS = ("sparse", "transforms.json", "cameras.json", "colmap")


@dataclass(frozen=True)
class SceneFiles:
    """What a scene is read from. scenes: candidates; the one that the field was registered on is taken.

    capture: poses and photos, or None.
    """

    name: str
    field: Path
    scenes: tuple[Path, ...]
    capture: Path | None = None


def find_scene(folder: str | PathLike[str]) -> SceneFiles:
    """The files of a folder such as `drsplat demo` writes: one *.field, a scene, and if there is one a capture.

    Raises: InputError: no such folder, not exactly one field, no scene.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder")
    entries = sorted(folder.iterdir())
    fields = [path for path in entries if path.suffix == FIELD_SUFFIX and path.is_dir()]
    if len(fields) != 1:
        listed = ", ".join(path.name for path in fields) or "none"
        raise InputError(
            f"{folder}: expected one field (a folder NAME{FIELD_SUFFIX}, as `drsplat register` writes), got {listed}"
        )
    scenes = [path for path in entries if path.suffix.lower() in SCENE_SUFFIXES and path.is_file()]
    if (folder / "point_cloud").is_dir():
        scenes.append(folder)
    if not scenes:
        raise InputError(
            f"{folder}: expected a scene ({', '.join(SCENE_SUFFIXES)}) beside the field"
        )
    has_capture = any((folder / name).exists() for name in CAMERAS)
    name = folder.resolve().name
    return SceneFiles(name, fields[0], tuple(scenes), folder if has_capture else None)


def open_scene(
    files: SceneFiles | str | PathLike[str],
    *,
    encoder: str | None = None,
    vocabulary: str | None = None,
    device: str = "auto",
    threads: int = 0,
    load: Load = load_encoder,
) -> AskableScene:
    """Open a folder, or the files named.

    encoder, vocabulary, device: who embeds words, as on the command line;
    fields of the built-in encoders need none. load: see `encoder_for`. The encoder is loaded when it is
    first needed.

    Raises: InputError: files are missing. FormatError: damaged files. MismatchError: the field is of
    none of the scenes.
    """
    if not isinstance(files, SceneFiles):
        files = find_scene(files)
    field = load_field(files.field)
    gaussians = registered_scene(files, field)[1]
    views = () if files.capture is None else _views(files.capture)
    if field.up is None:  # registered by an older version
        field = replace(field, up=up_of(views))
    return AskableScene(
        files.name,
        gaussians,
        field,
        views,
        lambda: encoder_for(field, vocabulary, encoder, device, load),
        threads,
    )


def registered_scene(
    files: SceneFiles, field: LanguageField | None = None
) -> tuple[Path, Gaussians]:
    """The scene that the field was made of; others may lie beside it, such as saved answers.

    field: that of the files, where it is loaded already. Raises: MismatchError: it is of none of them.
    """
    field, scenes = field or load_field(files.field), files.scenes
    for number, path in enumerate(scenes):
        gaussians = read_gaussians(path)
        try:
            field.check_scene(gaussians)
        except MismatchError:
            if number == len(scenes) - 1:
                raise
            continue
        return path, gaussians
    raise InputError("no scene was given")


def _views(capture: Path) -> tuple[View, ...]:
    with warnings.catch_warnings():  # of photos that are missing; the views stay
        warnings.simplefilter("ignore", DrSplatWarning)
        return tuple(read_views(capture))
