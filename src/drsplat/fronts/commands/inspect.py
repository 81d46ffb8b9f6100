"""drsplat inspect: a file or folder -> a description of its content."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from ...base.terminal import counted
from .declaring import Facts, argument, declaration, flag, part
from .options import Photos, Verb
from .recognising import kind_of, place_of, verified
from .tables import code_facts, codebook_facts, show_facts

if TYPE_CHECKING:
    import numpy as np

EXAMPLES = """\
  drsplat inspect scene.ply
  drsplat inspect capture
  drsplat inspect capture/language_features
  drsplat inspect room.field --json
  drsplat inspect room.field --verify

--verify names the damaged file and exits with code 1 if any bit of a field, tiles, a film (NAME.motion), a catalogue
or embedded features has changed since it was written. Other kinds have no checksums; for them, it reports what it
read."""
DAILY = "verify"
PERCENTILES = (1, 50, 99)


@declaration
class Options(Verb):
    """Options of this verb."""

    path: str = argument("file or folder of any of these")
    verify: bool = flag(
        "compare every byte with its checksum; without checksums, report what was read (other verbs check only what "
        "they use)"
    )
    photos: Photos = part(Photos)


def run(options: Options) -> Facts:
    path = Path(options.path)
    kind, more = kind_of(path), {}
    if options.verify:
        more["verified"], more["checked"] = verified(path)
    given = (options.photos,) if kind in ("capture", "scene folder") else ()
    facts = _INSPECTORS[kind](place_of(path, kind), *given)
    return {"path": options.path, "kind": kind, **facts, **more}


def show(answer: Facts) -> None:
    facts = {name: value for name, value in answer.items() if name not in ("path", "kind", "views", "photos")}
    if "objects" in facts:
        facts["objects"] = [f"{one['id']} {one['name']}" for one in facts["objects"]]
    if "clamped_colors" in facts:
        share = f"{facts['clamped_colors']:.1%}"
        facts["clamped_colors"] = f"{share} of Gaussians, in viewers that keep constant colours in bytes"
    if "verified" in facts:
        facts["verified"] = counted(len(facts["verified"]), "file")
    show_facts(f"{answer['kind']}: {answer['path']}", facts)


def _scene(path: Path) -> Facts:
    from ...authoring.editing import EditFile
    from ...formats.moving_scenes import read_scene
    from ...scene.eight_bits import clamped_in_bytes
    from ...scene.moving import Moving, canonical_of

    given = read_scene(path)
    scene = canonical_of(given)
    of_time = {"num_times": len(given.times), "times": list(given.span)} if isinstance(given, Moving) else {}
    return {
        **of_time,
        "num_gaussians": len(scene),
        "sh_degree": scene.sh_degree,
        "antialiased": scene.antialiased,
        "surfels": scene.surfels,
        "clamped_colors": float(clamped_in_bytes(scene).mean()) if len(scene) else 0.0,
        "lowest": scene.positions.min(0) if len(scene) else None,
        "highest": scene.positions.max(0) if len(scene) else None,
        "near": scene.near,
        "opacity": _percentiles(scene.opacities),
        "scale": _percentiles(scene.scales.max(1)),
        "extra_columns": sorted(scene.extra),
        "num_kept_edits": EditFile.beside(path).num_done(scene),
        **_levels(path),
        **_named_objects(path),
        "fingerprint": scene.fingerprint,
    }


def _levels(path: Path) -> Facts:
    """Return the number of Gaussians at each level of a streamed SOG, whose finest is read; {} for other scenes."""
    from ...formats.streamed_sog import LOD_META, counts_of_levels

    lod_meta = path / LOD_META if path.is_dir() else path
    is_streamed = lod_meta.name == LOD_META and lod_meta.is_file()
    return {"num_gaussians_of_levels": counts_of_levels(lod_meta)} if is_streamed else {}


def _named_objects(path: Path) -> Facts:
    """Return the named objects that a scene file holds; {} if there are none."""
    from ...formats.glb import names_in_glb
    from ...formats.known import read_labels
    from ...scene.labelled import numbers_of

    if path.suffix.lower() in (".glb", ".gltf"):
        names = names_in_glb(path)
    else:
        things = read_labels(path).things
        names = list(zip(numbers_of(things), (thing.name for thing in things), strict=True))
    if not names:
        return {}
    return {"num_objects": len(names), "objects": [{"id": number, "name": name} for number, name in names]}


def _capture(path: Path, photos: Photos) -> Facts:
    from ...scene.views import pictures_kind, scenes_rendered

    views = photos.views(str(path))
    sources = [view.rendered_from for view in views]
    return {
        "num_views": len(views),
        "pictures": pictures_kind(sources),
        "rendered_from": scenes_rendered(sources),
        "num_photos": sum(view.image_path is not None for view in views),
        "num_masked": sum(view.mask_path is not None for view in views),
        "sizes": sorted({f"{view.width}x{view.height}" for view in views}),
        "lenses": sorted({"pinhole" if view.distortion is None else "distorted" for view in views}),
        "focal_px": sorted({round(float(view.K[0, 0]), 2) for view in views}),
        "first": views[0].name,
        "last": views[-1].name,
        "without_photo": [view.name for view in views if view.image_path is None],
        "views": [
            {
                "name": view.name, "size": [view.width, view.height], "K": view.K,
                "cam_from_world": view.cam_from_world, "distortion": view.distortion, "photo": view.image_path,
            }
            for view in views
        ],
    }  # fmt: skip


def _features(path: Path) -> Facts:
    from ...formats.langsplat import read_features
    from ...photos.embedding.embed import recorded_renderings
    from ...scene.masks.masks import LEVELS
    from ...scene.views import pictures_kind

    folder = read_features(path)
    by_level = {level: read_features(path, level=level) for level in LEVELS}
    photos = [{"name": key, **{level: len(f[key].embeddings) for level, f in by_level.items()}} for key in folder]
    rendered = recorded_renderings(path)
    return {
        "num_photos": len(folder),
        "pictures": pictures_kind(rendered),
        "rendered_from": rendered,
        "dim": folder.dim,
        "masks_per_level": {level: sum(photo[level] for photo in photos) for level in LEVELS},
        "map_sizes": sorted({"{1}x{0}".format(*folder[key].mask_ids.shape) for key in folder}),
        "first": photos[0]["name"],
        "last": photos[-1]["name"],
        "photos": photos,
    }


def _field(path: Path) -> Facts:
    from ... import load_field
    from ...scene.views import pictures_kind, scenes_rendered

    field = load_field(path)
    files = sorted(file for file in path.iterdir() if file.is_file())
    evidence = field.evidence
    return {
        "num_registered": len(field),
        "num_gaussians": field.num_gaussians,
        "encoder": field.encoder.name,
        "encoder_weights": field.encoder.weights,
        "dim": field.encoder.dim,
        **code_facts(field.code),
        "scene": field.scene,
        "aggregator": field.aggregator.name,
        "left_out": field.left_out,
        "pictures": pictures_kind(field.rendered_from),
        "rendered_from": scenes_rendered(field.rendered_from),
        "num_views": None if evidence is None else len(evidence.masks.view_names),
        "times": None if field.times is None else [field.times.min(), field.times.max()],
        "num_masks": None if evidence is None else len(evidence.masks),
        "num_weights": None if evidence is None else len(evidence.entries.data),
        "num_objects": None if field.objects is None else len(field.objects),
        "negatives": field.negatives.texts if field.negatives else [],
        "file_bytes": {file.name: file.stat().st_size for file in files},
        "fingerprint": field.fingerprint,
    }


def _tiles(path: Path) -> Facts:
    from ...formats.tiles import read_tiles

    tiles = read_tiles(path)
    low, high = tiles.corners
    return {
        "num_gaussians": len(tiles),
        "num_tiles": len(tiles.tiles),
        "lowest": low.min(0) + tiles.origin,
        "highest": high.max(0) + tiles.origin,
        "origin": tiles.origin,
        "near": tiles.near,
        "antialiased": tiles.antialiased,
        "sources": tiles.sources,
        "fingerprint": tiles.fingerprint,
    }


def _catalogue(path: Path) -> Facts:
    from ...query.catalogue import Catalogue

    catalogue = Catalogue.open(path)
    scenes = catalogue.scenes()
    return {
        "num_scenes": len(scenes),
        "num_objects": sum(scene.num_objects for scene in scenes),
        "encoder": catalogue.encoder.name,
        "dim": catalogue.encoder.dim,
        "scenes": [scene.scene for scene in scenes],
        "not_current": [f"{scene.scene}: {scene.state}" for scene in scenes if scene.state != "current"],
    }


def _scene_folder(path: Path, photos: Photos) -> Facts:
    """Describe the parts of a folder as `drsplat view` opens it: its field, scene and capture."""
    from ... import load_field
    from ...authoring.editing import EditFile
    from ...query.opening import find_scene, registered_scene
    from ...scene.moving import canonical_of

    files = find_scene(path)
    field = load_field(files.field)
    place, scene = registered_scene(files, field)
    return {
        "field": files.field,
        "scene": place,
        "capture": files.capture,
        "num_gaussians": len(canonical_of(scene)),
        "num_registered": len(field),
        "num_kept_edits": EditFile.beside(place).num_done(canonical_of(scene)),
        "encoder": field.encoder.name,
        "num_objects": None if field.objects is None else len(field.objects),
        "details": f"drsplat inspect {files.field}",
        **({} if files.capture is None else _capture(path, photos)),
    }


def _tensors(path: Path) -> Facts:
    from ...formats.tensors import map_tensors

    tensors, metadata = map_tensors(path)
    return {
        "format": metadata.get("format"),
        "arrays": {name: f"{array.dtype} {list(array.shape)}" for name, array in sorted(tensors.items())},
        "metadata": sorted(metadata),
    }


def _labels(path: Path) -> Facts:
    from ...field.labels import LabelFile

    labels = LabelFile(path).read()
    return {"num_labels": len(labels), "names": [label.name for label in labels]}


def _edits(path: Path) -> Facts:
    from ...authoring.editing.edits import edits_of
    from ...formats.json_files import read_json

    listed = edits_of(read_json(path), str(path))
    return {"scene": listed.scene, "num_edits": len(listed.edits), "num_done": listed.done}


def _annotations(path: Path) -> Facts:
    from ...formats.annotations import AnnotationFile

    annotations = AnnotationFile(path).read()
    return {"num_annotations": len(annotations), "texts": [annotation.text for annotation in annotations]}


def _camera_path(path: Path) -> Facts:
    from ...authoring.filming.paths import read_path

    way = read_path(path)
    return {"num_key_frames": len(way.keys), "seconds": way.seconds, "fps": way.fps, "size": way.size}


def _codebook(path: Path) -> Facts:
    from ...field.codes.official import read_codebook

    codebook = read_codebook(path)
    return {"encoder": codebook.encoder.name, "dim": codebook.dim, **codebook_facts(codebook)}


def _vocabulary(path: Path) -> Facts:
    from ... import read_vocabulary

    vocabulary = read_vocabulary(path)
    return {
        "encoder": vocabulary.identity.name, "dim": vocabulary.identity.dim, "num_texts": len(vocabulary.texts),
        "texts": vocabulary.texts,
    }  # fmt: skip


def _percentiles(values: np.ndarray) -> dict[str, float]:
    import numpy as np

    if not len(values):
        return {}
    return {f"p{p}": float(v) for p, v in zip(PERCENTILES, np.percentile(values, PERCENTILES), strict=True)}


_INSPECTORS: dict[str, Callable[..., Facts]] = {
    "scene": _scene, "capture": _capture, "features": _features, "field": _field, "codebook": _codebook,
    "vocabulary": _vocabulary, "tiles": _tiles, "catalogue": _catalogue, "scene folder": _scene_folder,
    "tensors": _tensors, "labels": _labels, "edits": _edits, "annotations": _annotations, "camera path": _camera_path,
}  # fmt: skip
