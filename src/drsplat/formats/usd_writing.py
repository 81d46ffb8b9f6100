"""Writing a scene and what was found in it as OpenUSD text (`.usda`), without a library.

The Gaussians are one prim of the schema ParticleField3DGaussianSplat (OpenUSD 26.03) in the coordinates of the scene;
the prim above it turns them so that up is +Y. Objects, groups, matches and annotations are prims beside it. Numbers
have the nine digits that float32 takes, so what is read back is what was written, to the bit.
"""

import math
import re
from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..base.arrays import Array, Float32
from ..errors import InputError
from ..scene.gaussians import Gaussians, covariances_of
from ..scene.labelled import Annotation, LabelledScene, Thing
from .activation import refuse_unwritable
from .axes import standing_up
from .json_files import is_text
from .replacing import replacing

BLOCK_ROWS = 1 << 12  # of an array that are made text at once
SUPPORT_SIGMAS = 3.0  # of the schema's kernel
MAX_NAME_CHARACTERS = 64  # of a prim
ROOT, SPLAT = "scene", "gaussians"
VERTEX = 'interpolation = "vertex"'


class Column(NamedTuple):
    """An array of the Gaussians' prim: its type and name in USD, its rows, and its metadata."""

    kind: str
    name: str
    rows: Array
    metadata: str = ""


def write_usda(path: Path, scene: LabelledScene, overwrite: bool = False) -> None:
    """Write a scene as OpenUSD text, some thousand rows at a time.

    Raises: InputError: no Gaussians, or some that no file could give back; a name that is no text; `path` exists and
    not `overwrite`.
    """
    columns = columns_of(scene)
    with replacing(path, overwrite) as file:
        for piece in layer_text(scene, chain.from_iterable(map(_column_text, columns))):
            file.write(piece.encode())


def columns_of(scene: LabelledScene) -> list[Column]:
    """Return the arrays of the Gaussians' prim. Raises: InputError: as `write_usda`."""
    gaussians = scene.gaussians
    refuse_unwritable(gaussians)
    coefficients = gaussians.sh.reshape(-1, 3)
    size = f"elementSize = {gaussians.sh.shape[1]}"
    columns = [
        Column("point3f[]", "positions", gaussians.means),
        Column("quatf[]", "orientations", gaussians.quats),
        Column("float3[]", "scales", gaussians.scales),
        Column("float[]", "opacities", gaussians.opacities),
        Column("float3[]", "radiance:sphericalHarmonicsCoefficients", coefficients, f"{size}\n{VERTEX}"),
        Column("float3[]", "extent", extent_of(gaussians)),
    ]
    numbers = {"object_id": ("int[]", scene.object_numbers), "relevancy": ("float[]", scene.relevancy)}
    columns += [
        Column(kind, f"primvars:{name}", rows, VERTEX) for name, (kind, rows) in numbers.items() if rows is not None
    ]
    return columns


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


def layer_text(scene: LabelledScene, columns: Iterable[str]) -> Iterator[str]:
    """Yield the layer. columns: text of the arrays of the Gaussians' prim, which a library may set itself."""
    gaussians = scene.gaussians
    yield f'#usda 1.0\n(\n    defaultPrim = "{ROOT}"\n    doc = "written by drsplat"\n'
    yield '    metersPerUnit = 1\n    upAxis = "Y"\n)\n\n'
    yield (
        f'def Xform "{ROOT}" (\n    displayName = {quoted(scene.title)}\n    kind = "component"\n)\n'
        f"{{\n    custom double3 drsplat:up = {_tuple(scene.up)}\n"
        f"    custom string drsplat:query = {quoted(scene.query)}\n"
        f"    custom string drsplat:encoder = {quoted(scene.encoder)}\n"
        f"    matrix4d xformOp:transform = {_matrix(standing_up(np.array(scene.up, np.float64)))}\n"
        '    uniform token[] xformOpOrder = ["xformOp:transform"]\n\n'
        f'    def ParticleField3DGaussianSplat "{SPLAT}"\n    {{\n'
        f"        custom double3 drsplat:origin = {_tuple(gaussians.origin)}\n"
        f"        custom bool drsplat:antialiased = {str(gaussians.antialiased).lower()}\n"
        f"        uniform int radiance:sphericalHarmonicsDegree = {gaussians.sh_degree}\n"
        '        uniform token sortingModeHint = "cameraDistance"\n'
        f"        double3 xformOp:translate = {_tuple(gaussians.origin)}\n"
        '        uniform token[] xformOpOrder = ["xformOp:translate"]\n'
    )
    yield from columns
    yield "    }\n"
    yield from _scope("groups", "group", scene.groups)
    yield from _scope("objects", "object", scene.things)
    yield from _scope("matches", "match", scene.matches)
    yield from _notes(scene.annotations)
    yield "}\n"


def _column_text(column: Column) -> Iterator[str]:
    """Yield `type name = [...]` with its metadata, some thousand rows at a time."""
    width = 1 if column.rows.ndim == 1 else column.rows.shape[1]
    number = "%d" if column.rows.dtype.kind in "iu" else "%.9g"
    row = number if width == 1 else f"({', '.join([number] * width)})"
    yield f"        {column.kind} {column.name} = ["
    for begin in range(0, len(column.rows), BLOCK_ROWS):
        block = column.rows[begin : begin + BLOCK_ROWS]
        yield (", " if begin else "") + ", ".join([row] * len(block)) % tuple(block.ravel().tolist())
    metadata = column.metadata.replace("\n", "\n            ")
    yield f"] (\n            {metadata}\n        )\n" if metadata else "]\n"


def _scope(name: str, kind: str, things: tuple[Thing, ...]) -> Iterator[str]:
    """Yield a prim that holds the boxes of things as cubes that are only drawn as guides."""
    yield from _children(name, things, lambda number, thing: _thing_text(kind, number, thing))


def _notes(annotations: tuple[Annotation, ...]) -> Iterator[str]:
    yield from _children("annotations", annotations, _annotation_text)


def _children(name: str, items: tuple[Any, ...], text_of: Callable[..., str]) -> Iterator[str]:
    if items:
        yield f'\n    def Scope "{name}"\n    {{\n'
        yield from (text_of(number, item) for number, item in enumerate(items))
        yield "    }\n"


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
        f'        def {schema} "{prim_name(name, number)}" (\n            displayName = {quoted(name)}\n        )\n'
        f"        {{\n            {body}\n        }}\n"
    )


def prim_name(name: str, number: int) -> str:
    """Return an identifier that looks like the name, with the number, by which it differs from its siblings."""
    letters = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")[:MAX_NAME_CHARACTERS]
    return f"{letters or 'thing'}_{number}" if not letters[:1].isdigit() else f"_{letters}_{number}"


def quoted(text: str) -> str:
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
