"""Kinds of files and folders that `drsplat inspect` knows, recognised by name and content."""

from __future__ import annotations

from pathlib import Path

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
