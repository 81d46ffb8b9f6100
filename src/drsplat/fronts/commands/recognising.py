"""Kinds of files and folders that `drsplat inspect` knows: recognised by name and content, and how each is verified."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from ...errors import InputError

FORMAT_KINDS = {
    "drsplat labels": "labels",
    "drsplat edits": "edits",
    "drsplat annotations": "annotations",
    "drsplat-path": "camera path",
}
FOLDER_KINDS = {
    "field.json": "field",
    "tiles.json": "tiles",
    "catalogue.json": "catalogue",
    "lod-meta.json": "scene",
    "tileset.json": "scene",
}
MANIFEST_KINDS = {
    "field.json": "field",
    "tiles.json": "tiles",
    "catalogue.json": "catalogue",
    "embedding.json": "features",
}


def kind_of(path: Path) -> str:
    """Return the kind of what is at `path`: one of those of `inspect`.

    Raises: InputError: there is nothing at `path`.
    """
    from ...formats.langsplat import has_features
    from ...formats.moving_scenes import is_moving
    from ...query.opening import find_scene

    if path.is_file():
        return _file_kind(path)
    if not path.is_dir():
        raise InputError(f"{path}: there is no such file or folder")
    for manifest, kind in FOLDER_KINDS.items():
        if (path / manifest).is_file():
            return kind
    if (path / "meta.json").is_file() and _json_kind(path / "meta.json") == "scene":
        return "scene"
    with suppress(InputError):  # of a folder that `drsplat view` and `drsplat serve` would not take
        find_scene(path)
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


def _file_kind(path: Path) -> str:
    from ...formats.faiss_index import is_faiss
    from ...formats.tensors import map_tensors

    if path.name in ("motion.safetensors", "lod-meta.json", "tileset.json"):
        return "scene"
    if path.suffix == ".safetensors":
        tensors, metadata = map_tensors(path)
        if metadata.get("format", "").startswith("drsplat codebook") or set(tensors) <= {"centroids", "coarse"}:
            return "codebook"
        return "vocabulary" if "embeddings" in tensors and "texts" in metadata else "tensors"
    if path.suffix == ".json":
        return MANIFEST_KINDS.get(path.name) or _json_kind(path)
    if path.suffix in (".bin", ".txt"):
        return "capture"
    return "codebook" if path.suffix == ".faiss" or is_faiss(path) else "scene"


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


Verified = tuple[Sequence[str], str]
"""Names of the files that were compared with checksums, and a phrase on what was checked."""


def verified(path: Path) -> Verified:
    """Verify what is at `path`; return what was checked. Raises: DrSplatError: damage, with the name of the file."""
    kind = kind_of(path)
    verify = _VERIFIERS.get(kind)
    return ((), UNPROVEN[kind]) if verify is None else verify(place_of(path, kind))


def _field(path: Path) -> Verified:
    from ...field.loading import verify_field

    return verify_field(path), "all files"


def _tiles(path: Path) -> Verified:
    from ...formats.tiles import read_tiles

    return read_tiles(path).verify(), "all files"


def _catalogue(path: Path) -> Verified:
    from ...query.catalogue import Catalogue

    return Catalogue.open(path).verify(), "all files"


def _scene(path: Path) -> Verified:
    from ...formats.moving_scenes import read_scene, verify_motion
    from ...formats.scenes import MOTION
    from ...formats.tensors import read_tensors
    from ...scene.moving import Moving
    from ...training.model_folder import CHECKPOINT

    if path.name == MOTION or (path / MOTION).is_file():
        return verify_motion(path.parent if path.name == MOTION else path), "all files"
    scene = read_scene(path)
    if isinstance(scene, Moving):
        for time in scene.times.tolist():
            scene.at(time)
    names = [CHECKPOINT] if (path / CHECKPOINT).is_file() else []
    for name in names:
        read_tensors(path / name)
    return names, "read whole: files of Gaussians have no checksums"


def _features(path: Path) -> Verified:
    from ... import read_features
    from ...formats.embedding_record import COMPACT, stems, verify_embedding

    names, folder = verify_embedding(path), read_features(path)
    for key in folder:
        folder.stored(key)
    compact = [f"{stem}{COMPACT}" for stem in stems(path, COMPACT)]  # with checksums of their own
    return sorted({*names, *compact}), "all photos read whole; .npy files of masks have no checksums"


def _tensors(path: Path) -> Verified:
    """Verify arrays; `inspect` reads a codebook or a vocabulary whole by itself."""
    from ...formats.tensors import TENSORS, map_tensors, read_tensors

    if path.suffix != ".safetensors":
        return (), "read whole: it has no checksum"
    if TENSORS not in map_tensors(path)[1]:
        return (), "its header was read: it has no checksums"
    read_tensors(path)
    return [path.name], "all of it"


def _scene_folder(path: Path) -> Verified:
    """Verify all parts of a folder: the field, scenes beside it, and features."""
    from ...query.opening import find_scene

    files = find_scene(path)
    parts = [files.field, *(scene for scene in files.scenes if scene != path)]
    parts += [folder for folder in sorted(path.iterdir()) if folder.is_dir() and kind_of(folder) == "features"]
    results = [(part.name, *verified(part)) for part in parts]
    names = [f"{part}/{name}" for part, compared, _ in results for name in compared]
    return names, "; ".join(f"{part}: {checked}" for part, _, checked in results)


_VERIFIERS: dict[str, Callable[[Path], Verified]] = {
    "field": _field, "tiles": _tiles, "catalogue": _catalogue, "scene": _scene, "scene folder": _scene_folder,
    "features": _features, "tensors": _tensors, "codebook": _tensors, "vocabulary": _tensors,
}  # fmt: skip
UNPROVEN = {
    "capture": "poses and cameras were read, photos were not opened: captures have no checksums",
    **dict.fromkeys(
        ("labels", "edits", "annotations", "camera path"), "read whole: it has no checksum, as people may edit it"
    ),
}
