"""Writing a scene and what was found in it as OpenUSD: text without a library, binary by its own library.

The Gaussians are one prim of the schema ParticleField3DGaussianSplat (OpenUSD 26.03) in the coordinates of the scene;
the prim above it turns them so that up is +Y. Objects, groups, matches and annotations are prims beside it. Numbers
have the nine digits that float32 takes, so what is read back is what was written, to the bit.
"""

import math
import re
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..base.arrays import Array, Float32
from ..errors import FormatError, InputError
from ..scene.gaussians import Gaussians, covariances_of
from ..scene.labelled import Annotation, LabelledScene, Thing
from .activation import refuse_unwritable
from .axes import standing_up
from .json_files import is_text
from .replacing import replacing, take_over
from .usd import HARMONICS, SCHEMA, openusd

BLOCK_ROWS = 1 << 12  # that are made text at once
SUPPORT_SIGMAS = 3.0  # of the schema's kernel
MAX_NAME_CHARACTERS = 64  # of a prim
ROOT, SPLAT = "scene", "gaussians"
_ARRAYS = {
    "point3f[]": "Vec3fArray", "float3[]": "Vec3fArray", "quatf[]": "QuatfArray", "float[]": "FloatArray",
    "int[]": "IntArray",
}  # fmt: skip
_HEAD = f"""#usda 1.0
(
    defaultPrim = "{ROOT}"
    doc = "written by drsplat"
    metersPerUnit = 1
    upAxis = "Y"
)
"""
_VERTEX = 'interpolation = "vertex"\n        )'
_PLACE = "\0"  # of the arrays in the text, which is in no name
_TO_XYZW = [1, 2, 3, 0]  # of quaternions, whose real part the library keeps last


Columns = dict[str, tuple[Array, str]]
"""Arrays of the Gaussians' prim and their metadata, by type and name."""


def write_usd(path: Path, scene: LabelledScene, overwrite: bool = False) -> None:
    """Write a scene as OpenUSD: text, some thousand rows at a time, where `path` ends in .usda, .usdc or .usdz.

    Raises: InputError: no Gaussians, or some that no file could give back; a name that is no text; `path` exists and
    not `overwrite`. MissingExtraError: a binary file, and no library.
    """
    refuse_unwritable(scene.gaussians)
    suffix, columns = path.suffix.lower(), _columns(scene)
    if suffix == ".usda":
        before, after = _layer_text(scene, _PLACE).split(_PLACE)
        with replacing(path, overwrite) as file:
            file.write(before.encode())
            for declared, column in columns.items():
                file.writelines(_column_text(declared, *column))
            file.write(after.encode())
        return
    pxr = openusd()
    layer = _layer_of(pxr, scene, columns)
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder, f"{ROOT}.usdc")
        if not layer.Export(str(made)):
            raise FormatError(f"OpenUSD could not write {path.name}")
        if suffix == ".usdz":
            with pxr.Sdf.ZipFileWriter.CreateNew(f"{made}.usdz") as writer:
                writer.AddFile(str(made), made.name)
            made = Path(f"{made}.usdz")
        take_over(made, path, overwrite)


def _columns(scene: LabelledScene) -> Columns:
    gaussians = scene.gaussians
    size = f" (\n            elementSize = {gaussians.sh.shape[1]}\n            {_VERTEX}"
    columns: Columns = {
        "point3f[] positions": (gaussians.means, ""),
        "quatf[] orientations": (gaussians.quats, ""),
        "float3[] scales": (gaussians.scales, ""),
        "float[] opacities": (gaussians.opacities, ""),
        f"float3[] {HARMONICS}": (gaussians.sh.reshape(-1, 3), size),
        "float3[] extent": (extent_of(gaussians), ""),
    }
    if scene.object_numbers is not None:
        columns["int[] primvars:object_id"] = scene.object_numbers, f" (\n            {_VERTEX}"
    if scene.relevancy is not None:
        columns["float[] primvars:relevancy"] = scene.relevancy, f" (\n            {_VERTEX}"
    return columns


def _column_text(declared: str, rows: Array, metadata: str) -> Iterator[bytes]:
    """Yield `type name = [...]` with its metadata, some thousand rows at a time."""
    width = 1 if rows.ndim == 1 else rows.shape[1]
    number = "%d" if rows.dtype.kind in "iu" else "%.9g"
    row = number if width == 1 else f"({', '.join([number] * width)})"
    yield f"        {declared} = [".encode()
    for begin in range(0, len(rows), BLOCK_ROWS):
        block = rows[begin : begin + BLOCK_ROWS]
        yield ((", " if begin else "") + ", ".join([row] * len(block)) % tuple(block.ravel().tolist())).encode()
    yield f"]{metadata}\n".encode()


def _layer_of(pxr: Any, scene: LabelledScene, columns: Columns) -> Any:
    """Return an open layer: its text without arrays is parsed by the library, and the arrays are set."""
    layer = pxr.Sdf.Layer.CreateAnonymous(".usda")
    declarations = [f"        {declared}{metadata}\n" for declared, (_, metadata) in columns.items()]
    layer.ImportFromString(_layer_text(scene, "".join(declarations)))
    for declared, (rows, _) in columns.items():
        kind, name = declared.split()
        attribute = layer.GetAttributeAtPath(f"/{ROOT}/{SPLAT}.{name}")
        ordered = rows[:, _TO_XYZW] if kind == "quatf[]" else rows
        attribute.default = getattr(pxr.Vt, _ARRAYS[kind]).FromNumpy(np.ascontiguousarray(ordered))
    return layer


def extent_of(gaussians: Gaussians) -> Float32[Array, "2 3"]:
    """Return the lowest and highest corner of a box that holds all Gaussians up to three standard deviations."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for begin in range(0, len(gaussians), BLOCK_ROWS):
        rows = slice(begin, begin + BLOCK_ROWS)
        variances = covariances_of(gaussians.quats[rows], gaussians.scales[rows])[[0, 3, 5]].T
        reach = SUPPORT_SIGMAS * np.sqrt(np.maximum(variances, 0))
        low = np.minimum(low, (gaussians.means[rows] - reach).min(0))
        high = np.maximum(high, (gaussians.means[rows] + reach).max(0))
    return np.stack([low, high]).astype(np.float32)


def _layer_text(scene: LabelledScene, arrays: str) -> str:
    """Return the layer. arrays: what stands for those of the Gaussians' prim."""
    gaussians = scene.gaussians
    kinds = {
        "groups": ("group", scene.groups),
        "objects": ("object", scene.things),
        "matches": ("match", scene.matches),
    }
    scopes = [
        _scope(name, [_thing_text(kind, *one) for one in enumerate(some)]) for name, (kind, some) in kinds.items()
    ]
    notes = _scope("annotations", [_annotation_text(*each) for each in enumerate(scene.annotations)])
    return f"""{_HEAD}
def Xform "{ROOT}" (
    displayName = {_quoted(scene.title)}
    kind = "component"
)
{{
    custom double3 drsplat:up = {_tuple(scene.up)}
    custom string drsplat:query = {_quoted(scene.query)}
    custom string drsplat:encoder = {_quoted(scene.encoder)}
    matrix4d xformOp:transform = {_matrix(standing_up(np.array(scene.up, np.float64)))}
    uniform token[] xformOpOrder = ["xformOp:transform"]

    def {SCHEMA} "{SPLAT}"
    {{
        custom double3 drsplat:origin = {_tuple(gaussians.origin)}
        custom bool drsplat:antialiased = {str(gaussians.antialiased).lower()}
        uniform int radiance:sphericalHarmonicsDegree = {gaussians.sh_degree}
        uniform token sortingModeHint = "cameraDistance"
        double3 xformOp:translate = {_tuple(gaussians.origin)}
        uniform token[] xformOpOrder = ["xformOp:translate"]
{arrays}    }}
{"".join(scopes)}{notes}}}
"""


def _scope(name: str, prims: Sequence[str]) -> str:
    return f'\n    def Scope "{name}"\n    {{\n{"".join(prims)}    }}\n' if prims else ""


def _thing_text(kind: str, number: int, thing: Thing) -> str:
    lines = [
        f"custom double drsplat:score = {_number(thing.score)}",
        f"custom int drsplat:parent = {thing.parent}",
        f"custom int drsplat:number = {thing.number}",
        *_box_lines(thing.center, thing.axes, thing.extent),
    ]
    if thing.embedding is not None:
        lines.append(f"custom float[] drsplat:embedding = [{', '.join(f'{n:.9g}' for n in thing.embedding.tolist())}]")
    return _prim_text("Cube", kind, number, thing.name, lines)


def _annotation_text(number: int, annotation: Annotation) -> str:
    if annotation.outline is not None:
        lines = _box_lines(annotation.center, *annotation.outline)
        return _prim_text("Cube", "annotation", number, annotation.text, lines)
    place = _tuple(annotation.center)
    lines = [
        f"custom double3 drsplat:center = {place}",
        f"double3 xformOp:translate = {place}",
        'uniform token[] xformOpOrder = ["xformOp:translate"]',
    ]
    return _prim_text("Xform", "annotation", number, annotation.text, lines)


def _box_lines(center: Array, axes: Array, extent: Array) -> list[str]:
    """Return a cube of side 1 that is stretched and turned to the box, and the box in numbers."""
    rows = np.asarray(axes, np.float64)
    return [
        f"custom double3 drsplat:center = {_tuple(center)}",
        f"custom double3 drsplat:extent = {_tuple(extent)}",
        f"custom matrix3d drsplat:axes = ({', '.join(map(_tuple, rows))})",
        "double size = 1",
        "float3[] extent = [(-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)]",
        'uniform token purpose = "guide"',
        f"matrix4d xformOp:transform = {_matrix((rows * np.asarray(extent)[:, None]).T, center)}",
        'uniform token[] xformOpOrder = ["xformOp:transform"]',
    ]


def _prim_text(schema: str, kind: str, number: int, name: str, lines: list[str]) -> str:
    body = "\n            ".join([f'custom string drsplat:kind = "{kind}"', *lines])
    return (
        f'        def {schema} "{prim_name(name, number)}" (\n            displayName = {_quoted(name)}\n        )\n'
        f"        {{\n            {body}\n        }}\n"
    )


def prim_name(name: str, number: int) -> str:
    """Return an identifier that looks like the name, with the number, by which it differs from its siblings."""
    letters = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")[:MAX_NAME_CHARACTERS]
    return f"{letters or 'thing'}_{number}" if not letters[:1].isdigit() else f"_{letters}_{number}"


def _quoted(text: str) -> str:
    """Return text in quotes, on one line. Raises: InputError: half a character, which no file can hold."""
    if not is_text(text):
        raise InputError(f"expected a name that can be written, got {text!a:.80}")
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return '"' + re.sub(r"[\x00-\x1f\x7f]", lambda match: f"\\x{ord(match[0]):02x}", escaped) + '"'


def _matrix(linear: Array, translation: Array | tuple[float, ...] = (0.0, 0.0, 0.0)) -> str:
    """Return a matrix4d, which USD multiplies from the right of a row: the transpose of what columns take."""
    rows = [(*row, 0.0) for row in np.asarray(linear).T] + [(*translation, 1.0)]
    return f"( {', '.join(map(_tuple, rows))} )"


def _tuple(numbers: Iterable[float]) -> str:
    return f"({', '.join(map(_number, numbers))})"


def _number(number: float) -> str:
    if not math.isfinite(number):
        raise InputError(f"expected finite numbers of boxes, places and scores, got {number}")
    return repr(float(number))
