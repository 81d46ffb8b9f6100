"""drsplat inspect: a file or folder -> a description of its content."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from .declaring import Facts, argument, declaration, flag, part
from .options import Photos, Verb
from .recognising import kind_of, place_of, verified
from .tables import code_facts, codebook_facts

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
    kind = kind_of(path)
    proof = verified(path) if options.verify else None
    facts = _INSPECTORS[kind](options)
    more = {} if proof is None else {"verified": proof.names, "checked": proof.checked}
    return {"path": options.path, "kind": kind, **facts, **more}


def show(answer: Facts) -> None:
    from ...base.terminal import counted
    from .tables import show_facts

    facts = {name: value for name, value in answer.items() if name not in ("path", "kind", "views", "photos")}
    if "objects" in facts:
        facts["objects"] = [f"{one['id']} {one['name']}" for one in facts["objects"]]
    if "clamped_colors" in facts:
        share = f"{facts['clamped_colors']:.1%}"
        facts["clamped_colors"] = f"{share} of Gaussians, in viewers that keep constant colours in bytes"
    if "verified" in facts:
        facts["verified"] = counted(len(facts["verified"]), "file")
    show_facts(f"{answer['kind']}: {answer['path']}", facts)


def _scene(options: Options) -> Facts:
    from ...authoring.editing import EditFile
    from ...formats.moving_scenes import read_scene
    from ...scene.eight_bits import clamped_in_bytes
    from ...scene.moving import Moving, canonical_of

    given = read_scene(options.path)
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
        "num_kept_edits": EditFile.beside(options.path).num_done(scene),
        **_levels(Path(options.path)),
        **_named_objects(Path(options.path)),
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


def _capture(options: Options) -> Facts:
    from ...scene.views import pictures_kind, scenes_rendered

    views = options.photos.views(options.path)
    lenses = sorted({"pinhole" if view.distortion is None else "distorted" for view in views})
    sources = [view.rendered_from for view in views]
    return {
        "num_views": len(views),
        "pictures": pictures_kind(sources),
        "rendered_from": scenes_rendered(sources),
        "num_photos": sum(view.image_path is not None for view in views),
        "num_masked": sum(view.mask_path is not None for view in views),
        "sizes": sorted({f"{view.width}x{view.height}" for view in views}),
        "lenses": lenses,
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


def _features(options: Options) -> Facts:
    from ...formats.langsplat import read_features
    from ...photos.embedding.embed import recorded_renderings
    from ...scene.masks.masks import LEVELS
    from ...scene.views import pictures_kind

    place = place_of(Path(options.path), "features")
    folder = read_features(place)
    by_level = {level: read_features(place, level=level) for level in LEVELS}
    photos = [{"name": key, **{level: len(f[key].embeddings) for level, f in by_level.items()}} for key in folder]
    rendered = recorded_renderings(place)
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


def _field(options: Options) -> Facts:
    from ... import load_field
    from ...scene.views import pictures_kind, scenes_rendered

    place = place_of(Path(options.path), "field")
    field = load_field(place)
    files = sorted(file for file in place.iterdir() if file.is_file())
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
        "left_out": list(field.left_out),
        "pictures": pictures_kind(field.rendered_from),
        "rendered_from": scenes_rendered(field.rendered_from),
        "num_views": None if evidence is None else len(evidence.masks.view_names),
        "times": None if field.times is None else [field.times.min(), field.times.max()],
        "num_masks": None if evidence is None else len(evidence.masks),
        "num_weights": None if evidence is None else len(evidence.entries.data),
        "num_objects": None if field.objects is None else len(field.objects),
        "negatives": list(field.negatives.texts) if field.negatives else [],
        "file_bytes": {file.name: file.stat().st_size for file in files},
        "fingerprint": field.fingerprint,
    }


def _tiles(options: Options) -> Facts:
    from ...formats.tiles import read_tiles

    tiles = read_tiles(place_of(Path(options.path), "tiles"))
    low, high = tiles.corners
    return {
        "num_gaussians": len(tiles),
        "num_tiles": len(tiles.tiles),
        "lowest": low.min(0) + tiles.origin,
        "highest": high.max(0) + tiles.origin,
        "origin": tiles.origin,
        "near": tiles.near,
        "antialiased": tiles.antialiased,
        "sources": list(tiles.sources),
        "fingerprint": tiles.fingerprint,
    }


def _catalogue(options: Options) -> Facts:
    from ...query.catalogue import Catalogue

    catalogue = Catalogue.open(place_of(Path(options.path), "catalogue"))
    scenes = catalogue.scenes()
    return {
        "num_scenes": len(scenes),
        "num_objects": sum(scene.num_objects for scene in scenes),
        "encoder": catalogue.encoder.name,
        "dim": catalogue.encoder.dim,
        "scenes": [scene.scene for scene in scenes],
        "not_current": [f"{scene.scene}: {scene.state}" for scene in scenes if scene.state != "current"],
    }


def _scene_folder(options: Options) -> Facts:
    """Describe the parts of a folder as `drsplat view` opens it: its field, scene and capture."""
    from ... import load_field
    from ...authoring.editing import EditFile
    from ...query.opening import find_scene, registered_scene
    from ...scene.moving import canonical_of

    files = find_scene(options.path)
    field = load_field(files.field)
    path, scene = registered_scene(files, field)
    return {
        "field": str(files.field),
        "scene": str(path),
        "capture": None if files.capture is None else str(files.capture),
        "num_gaussians": len(canonical_of(scene)),
        "num_registered": len(field),
        "num_kept_edits": EditFile.beside(path).num_done(canonical_of(scene)),
        "encoder": field.encoder.name,
        "num_objects": None if field.objects is None else len(field.objects),
        "details": f"drsplat inspect {files.field}",
        **({} if files.capture is None else _capture(options)),
    }


def _tensors(options: Options) -> Facts:
    from ...formats.tensors import map_tensors

    tensors, metadata = map_tensors(options.path)
    return {
        "format": metadata.get("format"),
        "arrays": {name: f"{array.dtype} {list(array.shape)}" for name, array in sorted(tensors.items())},
        "metadata": sorted(metadata),
    }


def _labels(options: Options) -> Facts:
    from ...field.labels import LabelFile

    labels = LabelFile(Path(options.path)).read()
    return {"num_labels": len(labels), "names": [label.name for label in labels]}


def _edits(options: Options) -> Facts:
    from ...authoring.editing.edits import edits_of
    from ...formats.json_files import read_json

    listed = edits_of(read_json(Path(options.path)), options.path)
    return {"scene": listed.scene, "num_edits": len(listed.edits), "num_done": listed.done}


def _annotations(options: Options) -> Facts:
    from ...formats.annotations import AnnotationFile

    annotations = AnnotationFile(Path(options.path)).read()
    return {"num_annotations": len(annotations), "texts": [annotation.text for annotation in annotations]}


def _camera_path(options: Options) -> Facts:
    from ...authoring.filming.paths import read_path

    path = read_path(options.path)
    return {"num_key_frames": len(path.keys), "seconds": path.seconds, "fps": path.fps, "size": path.size}


def _codebook(options: Options) -> Facts:
    from ...field.codes.official import read_codebook

    codebook = read_codebook(options.path)
    return {"encoder": codebook.encoder.name, "dim": codebook.dim, **codebook_facts(codebook)}


def _vocabulary(options: Options) -> Facts:
    from ... import read_vocabulary

    vocabulary = read_vocabulary(options.path)
    return {
        "encoder": vocabulary.identity.name, "dim": vocabulary.identity.dim, "num_texts": len(vocabulary.texts),
        "texts": list(vocabulary.texts),
    }  # fmt: skip


def _percentiles(values: np.ndarray) -> dict[str, float]:
    import numpy as np

    if not len(values):
        return {}
    return {f"p{p}": float(v) for p, v in zip(PERCENTILES, np.percentile(values, PERCENTILES), strict=True)}


_INSPECTORS: dict[str, Callable[[Options], Facts]] = {
    "scene": _scene, "capture": _capture, "features": _features, "field": _field, "codebook": _codebook,
    "vocabulary": _vocabulary, "tiles": _tiles, "catalogue": _catalogue, "scene folder": _scene_folder,
    "tensors": _tensors, "labels": _labels, "edits": _edits, "annotations": _annotations, "camera path": _camera_path,
}  # fmt: skip
