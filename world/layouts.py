"""A rendered room in the files of LERF-OVS and of ScanNet, and the whole truth beside them.

OUTPUT/truth.json, OUTPUT/ids/*.png, OUTPUT/depth/*.npz
OUTPUT/lerf_ovs/SCENE/{images,sparse/0}, OUTPUT/lerf_ovs/label/SCENE/frame_XXXXX.{json,jpg}
OUTPUT/scannet/SCENE/{SCENE_vh_clean_2.labels.ply, SCENE_vh_clean_2.0.010000.segs.json, SCENE.aggregation.json}
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from drsplat import View

from .contours import polygons
from .render import Shot
from .rooms import Room
from .scan import Points

HELD_OUT = 8  # every so many photos are for testing, as in `drsplat train` and COLMAP-based 3DGS
LEAST_SEEN = 60  # pixels of a labelled frame that a category must have to be labelled
NYU40 = {
    "wall": 1, "floor": 2, "chair": 5, "sofa": 6, "table": 7, "window": 9, "shelf": 10, "cushion": 18,
    "rug": 20, "book": 23, "box": 29, "lamp": 35, "stool": 39,
}  # fmt: skip
OTHER_PROP = 40  # NYU40's word for things it has no class for
NO_FACES = ("element face 0", "property list uchar int vertex_indices")


def phrase(color: str, name: str) -> str:
    """What a thing is called in the labels: "red mug", but "orange" for an orange one."""
    return name if color == name else f"{color} {name}"


def category(room: Room, number: int) -> str:
    thing = room.objects[number].thing
    return phrase(thing.color, thing.name)


def write_truth(folder: Path, room: Room, shots: list[Shot], about: dict[str, Any]) -> None:
    """All objects, structures and views; ids as 16-bit PNG (id + 1, 0 for none), depth in metres."""
    (folder / "ids").mkdir(parents=True)
    (folder / "depth").mkdir()
    for shot in shots:
        stem = Path(shot.view.name).stem
        Image.fromarray((shot.ids + 1).astype(np.uint16)).save(folder / "ids" / f"{stem}.png")
        np.savez_compressed(folder / "depth" / f"{stem}.npz", depth=shot.depth)
    first = len(room.objects)
    truth = {
        **about,
        "objects": [_object(room, k, shots) for k in range(first)],
        "structures": [{"id": first + k, "name": s.name} for k, s in enumerate(room.structures)],
        "views": [_view(shot.view) for shot in shots],
    }
    _write_json(folder / "truth.json", truth)


def _object(room: Room, number: int, shots: list[Shot]) -> dict[str, Any]:
    placed = room.objects[number]
    thing = placed.thing
    return {
        "id": number, "name": thing.name, "color": thing.color, "material": thing.material,
        "category": category(room, number), "center": _numbers(placed.center),
        "box": {"center": _numbers(placed.center), "size": _numbers(thing.size), "degrees": placed.degrees % 360},
        "position": list(placed.position),
        "pixels": {s.view.name: n for s in shots if (n := int((s.ids == number).sum()))},
    }  # fmt: skip


def _view(view: View) -> dict[str, Any]:
    pose = view.cam_from_world.tolist()
    return {"name": view.name, "width": view.width, "height": view.height, "K": view.K.tolist(), "cam_from_world": pose}


def write_lerf(folder: Path, scene: str, room: Room, shots: list[Shot], points: Points) -> None:
    """COLMAP in text, photos, and polygons for those photos that training holds out."""
    images, sparse = folder / scene / "images", folder / scene / "sparse" / "0"
    labels = folder / "label" / scene
    for place in (images, sparse, labels):
        place.mkdir(parents=True)
    for shot in shots:
        _save_photo(shot, images / shot.view.name)
    _write_colmap(sparse, [shot.view for shot in shots], points)
    for shot in shots[::HELD_OUT]:
        _save_photo(shot, labels / shot.view.name)
        _write_json(labels / Path(shot.view.name).with_suffix(".json").name, label(room, shot))


def label(room: Room, shot: Shot) -> dict[str, Any]:
    """LERF-OVS's record of a frame: one object per connected piece of a category."""
    names = [category(room, k) for k in range(len(room.objects))]
    objects = []
    for name in sorted(set(names)):
        mask = np.isin(shot.ids, [k for k, other in enumerate(names) if other == name])
        if mask.sum() >= LEAST_SEEN:
            objects += [_piece(name, polygon) for polygon in polygons(mask)]
    info = {"name": shot.view.name, "width": shot.view.width, "height": shot.view.height}
    return {"info": info, "objects": objects}


def _piece(name: str, polygon: list[tuple[int, int]]) -> dict[str, Any]:
    corners = np.array(polygon)
    box = [*corners.min(0).tolist(), *corners.max(0).tolist()]
    return {"category": name, "bbox": box, "segmentation": [list(point) for point in polygon]}


def _write_colmap(folder: Path, views: list[View], points: Points) -> None:
    """Source: https://colmap.github.io/format.html"""
    lenses = [(v.width, v.height, *v.K[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()) for v in views]
    sizes = list(dict.fromkeys(lenses))
    cameras = [f"{k} PINHOLE {' '.join(map(repr, size))}" for k, size in enumerate(sizes, 1)]
    images = []
    for k, (v, lens) in enumerate(zip(views, lenses, strict=True), 1):
        x, y, z, w = Rotation.from_matrix(v.cam_from_world[:3, :3]).as_quat().tolist()
        numbers = " ".join(map(repr, (w, x, y, z, *v.cam_from_world[:3, 3].tolist())))
        images += [f"{k} {numbers} {sizes.index(lens) + 1} {v.name}", ""]
    rows = zip(points.positions.tolist(), points.colors.tolist(), strict=True)
    cloud = [f"{k} {x:.6f} {y:.6f} {z:.6f} {r} {g} {b} 0" for k, ((x, y, z), (r, g, b)) in enumerate(rows, 1)]
    for name, lines in (("cameras", cameras), ("images", images), ("points3D", cloud)):
        (folder / f"{name}.txt").write_text("\n".join([f"# {name}", *lines, ""]), encoding="utf-8")


def write_scannet(folder: Path, scene: str, room: Room, points: Points) -> None:
    """The labelled cloud and its instances."""
    place = folder / scene
    place.mkdir(parents=True)
    names = [o.thing.name for o in room.objects] + [s.name for s in room.structures]
    labels = np.array([NYU40.get(name, OTHER_PROP) for name in names], np.uint16)[points.ids]
    columns = {
        **{axis: points.positions[:, k].astype(np.float32) for k, axis in enumerate("xyz")},
        **{name: points.colors[:, k] for k, name in enumerate(("red", "green", "blue"))},
        "alpha": np.full(len(labels), 255, np.uint8),
        "label": labels,
    }
    (place / f"{scene}_vh_clean_2.labels.ply").write_bytes(ply(columns, *NO_FACES))
    _write_json(place / f"{scene}_vh_clean_2.0.010000.segs.json", {"sceneId": scene, "segIndices": points.ids.tolist()})
    groups = [
        {"id": n, "objectId": n, "segments": [k], "label": names[k]}
        for n, k in enumerate(np.unique(points.ids).tolist())
    ]
    _write_json(place / f"{scene}.aggregation.json", {"sceneId": scene, "segGroups": groups})


def ply(columns: dict[str, np.ndarray], *more: str) -> bytes:
    """A binary file of points, with more elements in its header."""
    words = {"float32": "float", "uint8": "uchar", "uint16": "ushort"}
    rows = np.rec.fromarrays([*columns.values()], [(name, column.dtype.str) for name, column in columns.items()])
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    header += [f"property {words[column.dtype.name]} {name}" for name, column in columns.items()]
    return "\n".join([*header, *more, "end_header", ""]).encode() + rows.tobytes()


def _save_photo(shot: Shot, path: Path) -> None:
    Image.fromarray(shot.image).save(path, quality=95, subsampling=0)


def _write_json(path: Path, value: Any) -> None:
    path.write_text(json.dumps(value) + "\n", encoding="utf-8")


def _numbers(values: np.ndarray) -> list[float]:
    return [round(x, 6) for x in np.asarray(values, float).tolist()]
