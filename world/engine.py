"""The world in Mitsuba 3: meshes, materials, light and cameras.

Dev-time only: `pip install mitsuba==3.9.1`. Fast with LLVM 15 or later (Debian: `apt-get install libllvm19`); the older
ones of some systems crash in it, so that without one we take scalar_rgb, which is slow.
"""

import importlib
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64, Int32

from drsplat import View

from .denoising import denoised
from .looks import MATERIALS, Look
from .meshes import Mesh

LLVM = tuple(f"/usr/lib/x86_64-linux-gnu/libLLVM-{n}.so" for n in (19, 18, 17, 16))
CREASE = 40.0  # degrees; edges sharper than this are drawn sharp
# OpenCV's camera axes (right, down, forward) in Mitsuba's (left, up, forward)
_FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])


@cache
def mitsuba() -> ModuleType:
    """Mitsuba with a variant chosen. DRJIT_LIBLLVM_PATH, if set, is taken at its word.

    Raises: ImportError: it is not installed.
    """
    found = next((path for path in LLVM if Path(path).exists()), None)
    if found is not None:
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", found)
    import mitsuba as mi

    fast = "DRJIT_LIBLLVM_PATH" in os.environ
    mi.set_variant(os.environ.get("WORLD_VARIANT", "llvm_ad_rgb" if fast else "scalar_rgb"))
    return mi


def corner_normals(mesh: Mesh) -> Float64[np.ndarray, "f 3 3"]:
    """Smooth normals, per corner of each face: of the faces at that point that are within CREASE."""
    points, faces = np.round(mesh.vertices, 7), mesh.faces
    welded = np.unique(points, axis=0, return_inverse=True)[1].reshape(-1)[faces]
    a, b, c = (mesh.vertices[faces[:, k]] for k in range(3))
    weighted = np.cross(b - a, c - a)
    flat = weighted / np.linalg.norm(weighted, axis=1, keepdims=True)
    corner, order = welded.ravel(), np.argsort(welded.ravel(), kind="stable")
    start = np.searchsorted(corner[order], np.arange(corner.max() + 2))
    total = np.zeros((len(corner), 3))
    counts = np.diff(start)[corner]
    for k in range(int(counts.max())):
        at = np.flatnonzero(counts > k)
        other = order[start[corner[at]] + k] // 3
        near = (flat[other] * flat[at // 3]).sum(1) > np.cos(np.radians(CREASE))
        total[at[near]] += weighted[other[near]]
    total /= np.linalg.norm(total, axis=1, keepdims=True)
    return total.reshape(-1, 3, 3)


def shape(mesh: Mesh, look: Look, name: str) -> Any:
    """A Mitsuba mesh, three vertices to a face."""
    mi = mitsuba()
    props = mi.Properties()
    props["bsdf"] = mi.load_dict(_bsdf(look))
    count = len(mesh.faces)
    built = mi.Mesh(name, 3 * count, count, has_vertex_normals=True, has_vertex_texcoords=True, props=props)
    repeat = 1.0 if look.texture is None else look.texture.metres
    params = mi.traverse(built)
    params["vertex_positions"] = np.ravel(mesh.vertices[mesh.faces]).astype(np.float32)
    params["vertex_normals"] = np.ravel(corner_normals(mesh)).astype(np.float32)
    params["vertex_texcoords"] = np.ravel(mesh.uv[mesh.faces] / repeat).astype(np.float32)
    params["faces"] = np.arange(3 * count, dtype=np.uint32)
    params.update()
    return built


def linear(rgb: Any) -> Float64[np.ndarray, "*n 3"]:
    """sRGB in 0..1 -> linear."""
    values = np.asarray(rgb, float)
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def srgb(values: Float64[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n 3"]:
    """Linear -> sRGB in 0..1, with a soft shoulder above 0.8 instead of clipping."""
    values = np.maximum(values, 0)
    soft = np.where(values < 0.8, values, 0.8 + 0.2 * (1 - np.exp(-(values - 0.8) / 0.2)))
    return np.where(soft <= 0.0031308, 12.92 * soft, 1.055 * soft ** (1 / 2.4) - 0.055)


def _bsdf(look: Look) -> dict[str, Any]:
    roughness = MATERIALS[look.material]
    if look.texture is None:
        tint = {"type": "rgb", "value": linear(look.rgb).tolist()}
    else:
        tint = {"type": "bitmap", "bitmap": mitsuba().Bitmap(look.texture.bitmap)}
    if roughness is None:
        bsdf = {"type": "diffuse", "reflectance": tint}
    elif look.material == "metal":
        bsdf = {"type": "roughconductor", "alpha": roughness, "specular_reflectance": tint}
    else:
        bsdf = {"type": "principled", "roughness": roughness, "specular": 0.5, "base_color": tint}
    return {"type": "twosided", "bsdf": bsdf}


def even_sky(radiance: list[float]) -> dict[str, Any]:
    """The same light from everywhere."""
    return {"type": "constant", "radiance": {"type": "rgb", "value": radiance}}


def sky(image: Float32[np.ndarray, "h w 3"]) -> dict[str, Any]:
    """Light from all around: linear radiance over (polar angle from +z, azimuth)."""
    mi = mitsuba()
    upright = mi.ScalarTransform4f().rotate([1, 0, 0], 90)  # Mitsuba's own pole is +y
    return {"type": "envmap", "bitmap": mi.Bitmap(image), "to_world": upright}


def panel(corner: Any, u: Any, v: Any, radiance: Any) -> dict[str, Any]:
    """A rectangular light: corner + [0, 1] u + [0, 1] v, shining to the side of u x v."""
    corner, u, v = (np.asarray(x, float) for x in (corner, u, v))
    normal = np.cross(u, v)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1] = u / 2, v / 2
    matrix[:3, 2], matrix[:3, 3] = normal / np.linalg.norm(normal), corner + (u + v) / 2
    return {
        "type": "rectangle", "to_world": mitsuba().ScalarTransform4f(matrix),
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": list(radiance)}},
    }  # fmt: skip


def sensor(view: View, spp: int) -> dict[str, Any]:
    """The camera of a view whose principal point is the middle of the picture."""
    mi = mitsuba()
    pose = np.linalg.inv(view.cam_from_world) @ _FLIP
    return {
        "type": "perspective", "fov_axis": "x", "near_clip": 0.01, "far_clip": 100.0,
        "fov": float(np.degrees(2 * np.arctan(view.width / (2 * view.K[0, 0])))),
        "to_world": mi.ScalarTransform4f(pose), "sampler": {"type": "independent", "sample_count": spp},
        "film": {"type": "hdrfilm", "width": view.width, "height": view.height,
                 "rfilter": {"type": "box"}, "component_format": "float32", "pixel_format": "rgb"},
    }  # fmt: skip


def scene(shapes: dict[str, Any], lights: dict[str, Any], depth: int = 4) -> Any:
    """depth: the bounces of light, 2 for direct light alone."""
    path = {"type": "path", "max_depth": depth}
    parts = {"type": "scene", "integrator": path}
    return mitsuba().load_dict({**parts, **shapes, **lights})


def side_by_side(views: list[View], spp: int) -> dict[str, Any]:
    """Cameras of one size that render next to each other into one wide picture, in one go."""
    sensors = {f"sensor_{k:03d}": sensor(view, spp) for k, view in enumerate(views)}
    first = sensor(views[0], spp)
    film: dict[str, Any] = {**first["film"], "width": sum(view.width for view in views)}
    return {"type": "batch", "sampler": first["sampler"], "film": film, **sensors}


def radiance(world: Any, camera: dict[str, Any], seed: int) -> Float64[np.ndarray, "h w 3"]:
    """Linear RGB as the sensor sees it, without most of the noise."""
    mi = mitsuba()
    eye = mi.load_dict(camera)
    light = np.asarray(mi.render(world, sensor=eye, seed=seed))[..., :3]
    surfaces = mi.load_dict({"type": "aov", "aovs": "albedo:albedo,normal:sh_normal"})
    seen = np.asarray(mi.render(world, sensor=eye, integrator=surfaces, spp=4, seed=seed))
    return denoised(light, seen[..., -6:-3], seen[..., -3:])


def pixel_rays(view: View) -> tuple[Float64[np.ndarray, " 3"], Float64[np.ndarray, "h w 3"]]:
    """Origin, and world directions of depth 1 through the centres of the pixels."""
    columns, rows = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    pixels = np.stack([columns, rows, np.ones_like(rows)], axis=2)
    directions = pixels @ np.linalg.inv(view.K).T @ view.cam_from_world[:3, :3]
    return view.center, directions


def first_hits(
    world: Any, views: list[View], index_of: Callable[[str], int]
) -> tuple[Int32[np.ndarray, "n h w"], Float32[np.ndarray, "n h w"]]:
    """What the ray through the centre of each pixel meets first: index_of(name of its shape), or
    -1, and the depth along z in metres, 0 where there is nothing. The views are of one size."""
    rays = [pixel_rays(view) for view in views]
    directions = np.stack([direction for _, direction in rays])
    origins = np.broadcast_to(np.stack([origin for origin, _ in rays])[:, None, None], directions.shape)
    caster = _cast_one_by_one if mitsuba().variant().startswith("scalar") else _cast_together
    indices, depths = caster(world, origins.reshape(-1, 3), directions.reshape(-1, 3), index_of)
    return indices.reshape(directions.shape[:3]), depths.reshape(directions.shape[:3])


def _cast_together(
    world: Any, origins: np.ndarray, directions: np.ndarray, index_of: Callable[[str], int]
) -> tuple[np.ndarray, np.ndarray]:
    mi = mitsuba()
    dr: Any = importlib.import_module("drjit")
    starts, ways = (np.ascontiguousarray(x.T, np.float32) for x in (origins, directions))
    hit = world.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(starts), mi.Vector3f(ways)))
    valid, registered = (np.asarray(hit.is_valid()), np.asarray(dr.reinterpret_array(mi.UInt32, hit.shape)))
    shapes = world.shapes()
    pointers = [int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0]) for shape in shapes]
    table = np.full(max(pointers) + 1, -1, np.int32)
    table[pointers] = [index_of(shape.id()) for shape in shapes]
    depths = np.where(valid, np.asarray(hit.t), 0).astype(np.float32)
    return np.where(valid, table[np.where(valid, registered, 0)], -1).astype(np.int32), depths


def _cast_one_by_one(
    world: Any, origins: np.ndarray, directions: np.ndarray, index_of: Callable[[str], int]
) -> tuple[np.ndarray, np.ndarray]:
    mi = mitsuba()
    indices, depths = np.full(len(origins), -1, np.int32), np.zeros(len(origins), np.float32)
    for k, (origin, direction) in enumerate(zip(origins.tolist(), directions.tolist(), strict=True)):
        hit = world.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(*origin), mi.Vector3f(*direction)))
        if hit.is_valid():
            indices[k], depths[k] = index_of(hit.shape.id()), hit.t
    return indices, depths
