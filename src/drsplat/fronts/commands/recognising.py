"""Kinds of files and folders that `drsplat inspect` knows: recognised by name and content, and how each is verified."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from ...errors import InputError

FORMAT_KINDS = {
    "drsplat labels": "labels",
    "drsplat edits": "edits",
    "drsplat annotations": "annotations",
    "drsplat-path": "camera path",
}
FOLDER_KINDS = {"field.json": "field", "tiles.json": "tiles", "lod-meta.json": "scene", "tileset.json": "scene"}
MANIFEST_KINDS = {
    "field.json": "field",
    "tiles.json": "tiles",
    "checksums.json": "catalogue",
    "embedding.json": "features",
}


def kind_of(path: Path) -> str:
    """Return the kind of what is at `path`: one of those of `inspect`.

    Raises: InputError: there is nothing at `path`.
    """
    from ...formats.langsplat import has_features
    from ...formats.moving_scenes import is_moving

    if path.is_file():
        return _file_kind(path)
    if not path.is_dir():
        raise InputError(f"{path}: there is no such file or folder")
    for manifest, kind in FOLDER_KINDS.items():
        if (path / manifest).is_file():
            return kind
    if (path / "objects.lance").is_dir():
        return "catalogue"
    if (path / "meta.json").is_file() and _json_kind(path / "meta.json") == "scene":
        return "scene"
    if _has_field(path):
        return "scene folder"
    if (path / "point_cloud").is_dir():
        return "scene"
    has_models = any((path / name).exists() for name in ("sparse", "colmap", "transforms.json", "cameras.json"))
    if not has_models and is_moving(path):
        return "scene"
    return "features" if not has_models and has_features(path) else "capture"


def place_of(path: Path, kind: str) -> Path:
    """Return the folder that a manifest stands for; any other path is its own place."""
    return path.parent if path.is_file() and MANIFEST_KINDS.get(path.name) == kind else path


def _has_field(path: Path) -> bool:
    """Return whether `drsplat view` and `drsplat serve` would take the folder."""
    from ...query.opening import find_scene

    try:
        find_scene(path)
    except InputError:
        return False
    return True


def _file_kind(path: Path) -> str:
    from ...formats.faiss_index import is_faiss

    if path.name in ("motion.safetensors", "lod-meta.json", "tileset.json"):
        return "scene"
    if path.suffix == ".safetensors":
        return _tensors_kind(path)
    if path.suffix == ".json":
        return MANIFEST_KINDS.get(path.name) or _json_kind(path)
    if path.suffix in (".bin", ".txt"):
        return "capture"
    return "codebook" if path.suffix == ".faiss" or is_faiss(path) else "scene"


def _tensors_kind(path: Path) -> str:
    from ...formats.tensors import map_tensors

    tensors, metadata = map_tensors(path)
    if metadata.get("format", "").startswith("drsplat codebook") or set(tensors) <= {"centroids", "coarse"}:
        return "codebook"
    return "vocabulary" if "embeddings" in tensors and "texts" in metadata else "tensors"


def _json_kind(path: Path) -> str:
    """Return the kind of a JSON file: cameras.json is a list, transforms.json has frames."""
    from ...formats.json_files import read_json
    from ...formats.sog import is_sog_meta

    document = read_json(path)
    if is_sog_meta(document):
        return "scene"
    about = document if isinstance(document, dict) else {}
    if str(about.get("format")) in FORMAT_KINDS:
        return FORMAT_KINDS[str(about["format"])]
    if about.get("type") == "FeatureCollection":
        return "annotations"
    if isinstance(about.get("camera_path"), list):
        return "camera path"
    frames = document.get("frames") if isinstance(document, dict) else document
    posed = isinstance(frames, list) and not any(isinstance(frame, int | float) for frame in frames)
    return "capture" if posed or path.name == "transforms.json" else "vocabulary"


class Verified(NamedTuple):
    """Names of the files that were compared with checksums, and a phrase on what was checked."""

    names: list[str]
    checked: str


def verified(path: Path) -> Verified:
    """Verify what is at `path`; return what was checked. Raises: DrSplatError: damage, with the name of the file."""
    kind = kind_of(path)
    return _VERIFIERS[kind](place_of(path, kind))


def _field(path: Path) -> Verified:
    from ...field.loading import verify_field

    return Verified(verify_field(path), "all files")


def _tiles(path: Path) -> Verified:
    from ...formats.tiles import read_tiles

    return Verified(read_tiles(path).verify(), "all files")


def _catalogue(path: Path) -> Verified:
    from ...query.catalogue import Catalogue

    names = Catalogue.open(path).verify()
    return Verified(names, "all files" if names else "opened: it has no checksums before the next add or remove")


def _scene(path: Path) -> Verified:
    from ...formats.moving_scenes import read_scene, verify_motion
    from ...formats.scenes import MOTION
    from ...formats.tensors import read_tensors
    from ...scene.moving import Moving
    from ...training.model_folder import CHECKPOINT

    if path.name == MOTION or (path / MOTION).is_file():
        return Verified(verify_motion(path.parent if path.name == MOTION else path), "all files")
    scene = read_scene(path)
    if isinstance(scene, Moving):
        for time in scene.times.tolist():
            scene.at(time)
    names = [CHECKPOINT] if (path / CHECKPOINT).is_file() else []
    for name in names:
        read_tensors(path / name)
    return Verified(names, "read whole: files of Gaussians have no checksums")


def _features(path: Path) -> Verified:
    from ... import read_features
    from ...formats.embedding_record import COMPACT, stems, verify_embedding

    names, folder = verify_embedding(path), read_features(path)
    for key in folder:
        folder.stored(key)
    compact = [f"{stem}{COMPACT}" for stem in stems(path, COMPACT)]  # with checksums of their own
    return Verified(sorted({*names, *compact}), "all photos read whole; .npy files of masks have no checksums")


def _tensors(path: Path) -> Verified:
    from ...formats.tensors import TENSORS, map_tensors, read_tensors

    if TENSORS not in map_tensors(path)[1]:
        return Verified([], "its header was read: it has no checksums")
    read_tensors(path)
    return Verified([path.name], "all of it")


def _codebook(path: Path) -> Verified:
    from ...field.codes.official import read_codebook

    read_codebook(path)
    return _tensors_or_read(path)


def _vocabulary(path: Path) -> Verified:
    from ... import read_vocabulary

    read_vocabulary(path)
    return _tensors_or_read(path)


def _tensors_or_read(path: Path) -> Verified:
    return _tensors(path) if path.suffix == ".safetensors" else Verified([], "read whole: it has no checksum")


def _capture(path: Path) -> Verified:
    return Verified([], "poses and cameras were read, photos were not opened: captures have no checksums")


def _document(path: Path) -> Verified:
    return Verified([], "read whole: it has no checksum, as people may edit it")


def _scene_folder(path: Path) -> Verified:
    """Verify all parts of a folder: the field, scenes beside it, and features."""
    from ...query.opening import find_scene

    files = find_scene(path)
    parts = [files.field, *(scene for scene in files.scenes if scene != path)]
    parts += [folder for folder in sorted(path.iterdir()) if folder.is_dir() and kind_of(folder) == "features"]
    names, checked = list[str](), list[str]()
    for part in parts:
        result = _VERIFIERS[kind_of(part)](part)
        names += [f"{part.name}/{name}" for name in result.names]
        checked.append(f"{part.name}: {result.checked}")
    return Verified(names, "; ".join(checked))


_VERIFIERS: dict[str, Callable[[Path], Verified]] = {
    "field": _field, "tiles": _tiles, "catalogue": _catalogue, "scene": _scene, "scene folder": _scene_folder,
    "features": _features, "tensors": _tensors, "codebook": _codebook, "vocabulary": _vocabulary, "capture": _capture,
    "labels": _document, "edits": _document, "annotations": _document, "camera path": _document,
}  # fmt: skip
