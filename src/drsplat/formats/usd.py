"""Reading OpenUSD: the Gaussians of a ParticleField3DGaussianSplat, and what drsplat wrote beside them.

Coordinates are those of the prim itself: converters turn the prim, or one above it, to the stage's up axis, and leave
the numbers in the axes of the poses. So a scene that was written and read back has the fingerprint that it had.

Sources: openusd.org, UsdVol "ParticleField3DGaussianSplat" of OpenUSD 26.03.
"""

import re
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..base.arrays import Array, Float64
from ..base.contents import file_bytes, open_file
from ..errors import FormatError, InputError, placed, warn
from ..scene.gaussians import SH_COEFFICIENTS, Gaussians, concatenated
from ..scene.labelled import PLY_UP, Annotation, LabelledScene, Thing, places_of
from .activation import checked
from .usd_library import MARK as CRATE
from .usd_library import library_layer
from .usd_text import API_SCHEMAS, COLOR_SPACE, TIME_SAMPLES, UsdPrim, parse_usda

SUFFIXES = (".usda", ".usdc", ".usdz", ".usd")
INHERITED_SPACE = "colour space of the prims above"
SCHEMA, TEXT = "ParticleField3DGaussianSplat", b"#usda"
ZIP = b"PK\x03\x04"
KINDS = ("object", "group", "match")
DISPLAYED = re.compile(r"(srgb|g22)(_rec709\w*|_texture)?|raw|data|auto|unknown|identity|", re.IGNORECASE)
MAX_DEGREE, MAX_STORED_DEGREE = 3, 10
_COLUMNS = {"positions": 3, "orientations": 4, "scales": 3, "opacities": 1}
_HARMONICS = "radiance:sphericalHarmonicsCoefficients"


def read_usd(path: Path) -> LabelledScene:
    """Read a scene with its objects from `.usda`, `.usdc`, `.usd` or `.usdz`.

    Raises: InputError: there is no such file. FormatError: no USD, no Gaussians in it, damaged. MissingExtraError: a
    binary file, and OpenUSD's library is not installed.
    """
    try:
        return scene_of(layer_of(path))
    except FormatError as error:
        raise FormatError(placed(path, error)) from None


def layer_of(path: Path) -> UsdPrim:
    """Read the layer of a file, the first one of a `.usdz`; nothing that it refers to is opened."""
    content = file_bytes(path)
    start = content[:8].tobytes()
    if start.startswith(ZIP):
        return _first_layer(path)
    if start.startswith(TEXT):
        return parse_usda(content.data)
    if start == CRATE:
        return library_layer(path, content)
    raise FormatError(f"no USD begins with {start[:5]!r}: expected text (#usda), binary (PXR-USDC) or a .usdz")


def _first_layer(path: Path) -> UsdPrim:
    """Return the first file of a package, which is the one that is opened; its bytes lie there as they are."""
    try:
        with open_file(path) as file, zipfile.ZipFile(file) as package:
            first = package.infolist()[0]
            if first.compress_type != zipfile.ZIP_STORED:
                raise FormatError(f"{first.filename!a:.60} is compressed, and files of a .usdz are stored")
            if Path(first.filename).suffix.lower() not in (".usda", ".usdc", ".usd"):
                raise FormatError(f"the first file of a .usdz is its scene, got {first.filename!a:.60}")
            content = package.read(first)
    except (zipfile.BadZipFile, IndexError, EOFError, OSError, ValueError, NotImplementedError, RuntimeError) as error:
        raise FormatError(f"the package is damaged: {error}") from None
    if content.startswith(TEXT):
        return parse_usda(memoryview(content))
    return library_layer(path, np.frombuffer(content, np.uint8))


def scene_of(layer: UsdPrim) -> LabelledScene:
    """Return the scene of a layer. Raises: FormatError: no Gaussians, or damaged."""
    prims = list(_walk(layer))
    gaussians = _gaussians(prims)
    root = next((prim for prim in prims if "drsplat:up" in prim.attributes), layer)
    things = {kind: tuple(_thing(prim) for prim in prims if prim.text("drsplat:kind") == kind) for kind in KINDS}
    notes = tuple(_annotation(prim) for prim in prims if prim.text("drsplat:kind") == "annotation")
    numbers = gaussians.extra.get("object_id")
    x, y, z = _numbers(root, "drsplat:up", np.array(PLY_UP)).tolist()
    return LabelledScene(
        gaussians, root.text("displayName") or "scene", things["object"], things["group"],
        None if numbers is None else places_of(numbers, things["object"]), root.text("drsplat:query"),
        gaussians.extra.get("relevancy"), things["match"], notes, (x, y, z), root.text("drsplat:encoder"),
    )  # fmt: skip


def _walk(layer: UsdPrim) -> Iterator[UsdPrim]:
    """Yield all defined prims, a parent before its children, in the order of the file."""
    waiting = [layer]
    while waiting:
        prim = waiting.pop()
        if prim.is_defined:
            yield prim
            for child in prim.children:
                child.metadata[INHERITED_SPACE] = _color_space(prim)
            waiting += reversed(prim.children)


def _color_space(prim: UsdPrim) -> str:
    """Return the colour space of a prim: its own where ColorSpaceAPI is applied to it, else that of those above."""
    own = prim.text(COLOR_SPACE) if "ColorSpaceAPI" in prim.text(API_SCHEMAS) else ""
    return own or prim.text(INHERITED_SPACE)


def _gaussians(prims: list[UsdPrim]) -> Gaussians:
    splats = [prim for prim in prims if prim.schema == SCHEMA]
    if not splats:
        kinds = sorted({prim.schema for prim in prims if prim.schema})[:8]
        raise FormatError(
            f"no prim of the schema {SCHEMA}, only {', '.join(kinds) or 'prims without one'}: what lies in other "
            "files or in variants is not read; flatten the stage first"
        )
    if len(splats) > 1 and any("xformOpOrder" in prim.attributes for prim in prims):
        raise FormatError(f"{len(splats)} splats, and prims that are moved: write each into a file of its own")
    parts = [_splat(prim) for prim in splats]
    return parts[0] if len(parts) == 1 else concatenated(parts)


def _splat(prim: UsdPrim) -> Gaussians:
    spaces = (prim.text("colorSpace") or _color_space(prim), prim.text(COLOR_SPACE))  # the latter may not be applied
    other = next((space for space in spaces if not DISPLAYED.fullmatch(space)), None)
    if other is not None:
        raise FormatError(
            f"prim '{prim.name}': its colour space is {other!a:.60}: colours of linear light, or of "
            "other primaries, look otherwise than those of photos. Export it in srgb_rec709_scene"
        )
    arrays = {name: _rows(prim, name, width) for name, width in _COLUMNS.items()}
    count = len(arrays["positions"])
    for name, array in arrays.items():
        if len(array) != count:
            raise FormatError(f"prim '{prim.name}': {count:,} positions, but {len(array):,} {name}")
    if not count:
        raise FormatError(f"prim '{prim.name}' has no Gaussians")
    # the primvars that have a number for each Gaussian
    columns = {
        name.removeprefix("primvars:"): value
        for name, value in prim.attributes.items()
        if name.startswith("primvars:") and isinstance(value, np.ndarray) and value.shape == (count,)
    }
    whole = {"object_id": np.int32}
    extra = {name: _column(value, whole.get(name, np.float32)) for name, value in columns.items()}
    gaussians = checked(
        arrays["positions"], arrays["orientations"], arrays["scales"], arrays["opacities"][:, 0],
        _harmonics(prim, count), extra, bool(_number(prim, "drsplat:antialiased", 0)),
    )  # fmt: skip
    return replace(gaussians, origin=_numbers(prim, "drsplat:origin", np.zeros(3)))


def _rows(prim: UsdPrim, name: str, width: int) -> Array:
    """Return an array of float32, or of half precision where there is no other."""
    value = next((prim.attributes[n] for n in (name, f"{name}h") if n in prim.attributes), None)
    if value is None and any(f"{n}{TIME_SAMPLES}" in prim.attributes for n in (name, f"{name}h")):
        raise FormatError(f"prim '{prim.name}': its {name} move with time: write one time of it")
    if not isinstance(value, np.ndarray) or value.size % width:
        raise FormatError(f"prim '{prim.name}': expected {name} of {width} numbers each")
    return value.astype(np.float32).reshape(-1, width)


def _harmonics(prim: UsdPrim, count: int) -> Array:
    """Return (count, k, 3) coefficients; those of degrees above 3 are left out, with a warning."""
    degree = _number(prim, "radiance:sphericalHarmonicsDegree", MAX_DEGREE)
    if not (0 <= degree <= MAX_STORED_DEGREE and degree == int(degree)):
        raise FormatError(f"prim '{prim.name}': expected harmonics of a degree from 0 to {MAX_DEGREE}, got {degree}")
    stored = (int(degree) + 1) ** 2
    values = _rows(prim, _HARMONICS, 3)
    if len(values) < count * stored:
        raise FormatError(
            f"prim '{prim.name}': {count:,} Gaussians of degree {int(degree)} have {count * stored:,} harmonics, got "
            f"{len(values):,}"
        )
    if degree > MAX_DEGREE:
        warn(f"harmonics of degree {int(degree)} are cut to {MAX_DEGREE}")
    kept = SH_COEFFICIENTS[min(int(degree), MAX_DEGREE)]
    return np.ascontiguousarray(values[: count * stored].reshape(count, stored, 3)[:, :kept])


@np.errstate(all="ignore")
def _column(value: Array, dtype: type) -> Array:
    column: Array = value.astype(dtype)
    return column if (column == value).all() else value


def _numbers(prim: UsdPrim, name: str, default: Float64[Array, "..."]) -> Float64[Array, "..."]:
    """Return finite numbers of the default's shape, the default where there are none."""
    value = prim.attributes.get(name)
    if value is None:
        return default
    if not isinstance(value, np.ndarray) or value.size != default.size or not np.isfinite(value).all():
        raise FormatError(f"prim '{prim.name}': expected {default.size} finite numbers as {name}")
    return value.astype(np.float64).reshape(default.shape)


def _number(prim: UsdPrim, name: str, default: float | int) -> float:
    return float(_numbers(prim, name, np.array(float(default))))


def _thing(prim: UsdPrim) -> Thing:
    embedding = prim.attributes.get("drsplat:embedding")
    return Thing(
        prim.text("displayName") or prim.name,
        _number(prim, "drsplat:score", 0),
        _numbers(prim, "drsplat:center", np.zeros(3)),
        _numbers(prim, "drsplat:axes", np.eye(3)),
        _numbers(prim, "drsplat:extent", np.zeros(3)),
        int(_number(prim, "drsplat:parent", -1)),
        embedding.astype(np.float32) if isinstance(embedding, np.ndarray) else None,
        int(_number(prim, "drsplat:number", -1)),
    )


def _annotation(prim: UsdPrim) -> Annotation:
    center = _numbers(prim, "drsplat:center", np.zeros(3))
    try:
        if "drsplat:extent" not in prim.attributes:
            return Annotation.at(prim.text("displayName"), center)
        thing = _thing(prim)
        return Annotation.box(thing.name, thing.center, thing.axes, thing.extent)
    except InputError as error:
        raise FormatError(f"prim '{prim.name}': {error}") from None
