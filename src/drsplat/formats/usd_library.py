"""Binary OpenUSD (`.usdc`, `.usdz`) through its own library, `usd-core`: the format is defined by that code alone.

A layer is read as it lies in the file: nothing that it refers to is opened. Counts in the head of a `.usdc` are checked
before the library allocates what they promise: byte 16 says where the table of contents is, a count and, of 32 bytes
each, a section's name, start and size. A section begins with the count of its entries; a second one follows in two of
them. Numbers are little-endian, of 8 bytes.

Source: OpenUSD 26.11, pxr/usd/sdf/crateFile.cpp, which is all that describes the format.
"""

import struct
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from ..base.arrays import ByteValues
from ..errors import FormatError, MissingExtraError, pip_install
from ..scene.labelled import LabelledScene
from .replacing import take_over
from .usd_text import API_SCHEMAS, MAX_NESTING, TIME_SAMPLES, UsdPrim, Value, is_wanted
from .usd_writing import ROOT, SPLAT, Column, columns_of, layer_text

HEAD_BYTES, ENTRY_BYTES = 24, 32
MAX_INTEGERS_PER_BYTE = 4 * 255  # LZ4 makes at most 255 bytes of one, with four integers in each
FIRST_COMPRESSED_VERSION = (0, 4)  # the first whose sections are compressed and begin as they do here
TWO_COUNTS = (b"TOKENS", b"PATHS")


MARK = b"PXR-USDC"
_ARRAYS = {
    "point3f[]": "Vec3fArray", "float3[]": "Vec3fArray", "quatf[]": "QuatfArray", "float[]": "FloatArray",
    "int[]": "IntArray",
}  # fmt: skip
_TO_XYZW, _TO_WXYZ = [1, 2, 3, 0], [3, 0, 1, 2]  # of quaternions, whose real part the library keeps last


def openusd() -> Any:
    """Return the package pxr. Raises: MissingExtraError: it is not installed."""
    try:
        from pxr import Gf, Sdf, Tf, UsdUtils, Vt  # noqa: F401
    except ModuleNotFoundError:
        raise MissingExtraError(f"binary USD needs OpenUSD's own library: {pip_install('usd')}, or use .usda") from None
    import pxr

    return pxr


def write_usdc(path: Path, scene: LabelledScene, overwrite: bool = False) -> None:
    """Write a scene as binary OpenUSD. Raises: MissingExtraError: no library. InputError: as `write_usda`."""
    pxr = openusd()
    layer = _library_layer_of(pxr, scene)
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / f"{ROOT}.usdc"
        _export(pxr, layer, made)
        take_over(made, path, overwrite)


def write_usdz(path: Path, scene: LabelledScene, overwrite: bool = False) -> None:
    """Write a scene as a package of one binary layer. Raises: as `write_usdc`."""
    pxr = openusd()
    layer = _library_layer_of(pxr, scene)
    with tempfile.TemporaryDirectory() as folder:
        made, package = Path(folder) / f"{ROOT}.usdc", Path(folder) / f"{ROOT}.usdz"
        _export(pxr, layer, made)
        with pxr.Sdf.ZipFileWriter.CreateNew(str(package)) as writer:
            writer.AddFile(str(made), made.name)
        take_over(package, path, overwrite)


def library_layer(path: Path, content: ByteValues) -> UsdPrim:
    """Return the layer of a binary file or a package, as `parse_usda` does that of a text. content: of the layer.

    Raises: MissingExtraError: no library. FormatError: damaged.
    """
    pxr = openusd()
    if content[:8].tobytes() == MARK:
        refuse_false_counts(content)
    try:
        return _layer(pxr, path)
    except pxr.Tf.ErrorException as error:  # also of a value that is unpacked only when somebody asks for it
        raise FormatError(f"OpenUSD does not read it: {_message(error)}") from None
    except (UnicodeDecodeError, MemoryError) as error:
        raise FormatError(f"OpenUSD reads what is no text, or has no end: {error}") from None


def _layer(pxr: Any, path: Path) -> UsdPrim:
    layer = pxr.Sdf.Layer.OpenAsAnonymous(str(path))
    if layer is None:
        raise FormatError("OpenUSD does not read it")
    root = UsdPrim("", "")
    waiting = [(root, spec, 1) for spec in layer.rootPrims]
    while waiting:
        parent, spec, depth = waiting.pop(0)
        if spec is None:
            raise FormatError(f"prim '{parent.name}' names a child that is not there")
        prim = _prim(pxr, spec)
        parent.children.append(prim)
        if depth > MAX_NESTING:
            raise FormatError(f"expected prims in prims up to {MAX_NESTING} deep")
        waiting += [(prim, child, depth + 1) for child in spec.nameChildren]
    return root


def _message(error: Exception) -> str:
    """Return what an error of OpenUSD says, without the place in its source code."""
    return str(error).rsplit(" : ", 1)[-1].strip("'\n\t ")[:200]


def _library_layer_of(pxr: Any, scene: LabelledScene) -> Any:
    """Return an open layer: its text without arrays is parsed by the library, and the arrays are set."""
    columns = columns_of(scene)
    layer = pxr.Sdf.Layer.CreateAnonymous(".usda")
    layer.ImportFromString("".join(layer_text(scene, map(_declared, columns))))
    for column in columns:
        rows = column.rows[:, _TO_XYZW] if column.kind == "quatf[]" else column.rows
        layer.GetAttributeAtPath(f"/{ROOT}/{SPLAT}.{column.name}").default = getattr(
            pxr.Vt, _ARRAYS[column.kind]
        ).FromNumpy(np.ascontiguousarray(rows))
    return layer


def _declared(column: Column) -> str:
    metadata = f" (\n            {column.metadata}\n        )" if column.metadata else ""
    return f"        {column.kind} {column.name}{metadata}\n"


def _export(pxr: Any, layer: Any, path: Path) -> None:
    if not layer.Export(str(path)):
        raise FormatError(f"OpenUSD could not write {path.name}")


def _prim(pxr: Any, spec: Any) -> UsdPrim:
    prim = UsdPrim(spec.typeName, spec.name, spec.specifier == pxr.Sdf.SpecifierDef)
    if spec.HasInfo("displayName"):
        prim.metadata["displayName"] = str(spec.GetInfo("displayName"))
    if spec.HasInfo(API_SCHEMAS):
        prim.metadata[API_SCHEMAS] = str(spec.GetInfo(API_SCHEMAS))
    for attribute in spec.attributes:
        value = _value(attribute.default) if is_wanted(attribute.name) else None
        if is_wanted(attribute.name) and attribute.HasInfo("colorSpace"):
            prim.metadata["colorSpace"] = str(attribute.GetInfo("colorSpace"))
        if value is not None:
            prim.attributes[attribute.name] = value
        elif attribute.HasInfo("timeSamples"):
            prim.attributes[f"{attribute.name}{TIME_SAMPLES}"] = ""
    return prim


def _value(value: Any) -> Value | None:
    """Return text, or numbers in one row; None for anything else."""
    if value is None or isinstance(value, str):
        return value
    try:
        numbers = np.asarray(value)
        if type(value).__name__.startswith("Quat") and numbers.ndim == 2:
            numbers = numbers[:, _TO_WXYZ]
    except (TypeError, ValueError):
        return None
    return numbers.reshape(-1) if numbers.dtype.kind in "fiub" else None


def refuse_false_counts(content: ByteValues) -> None:
    """Check the counts of a file. Raises: FormatError: one that its bytes have no room for, or a section elsewhere."""
    view = content.data
    if len(view) < HEAD_BYTES:
        raise FormatError(f"the file ends after {len(view)} bytes")
    version, table = tuple(view[8:10]), _number(view, 16)
    if table + 8 > len(view) or _number(view, table) > (len(view) - table - 8) // ENTRY_BYTES:
        raise FormatError(f"no table of contents at byte {table:,} of {len(view):,}")
    for place in range(table + 8, table + 8 + ENTRY_BYTES * _number(view, table), ENTRY_BYTES):
        name, start, size = bytes(view[place : place + 16]).rstrip(b"\0"), *struct.unpack_from("<QQ", view, place + 16)
        counts = 2 if name in TWO_COUNTS and version >= FIRST_COMPRESSED_VERSION else 1
        if start + size > len(view) or size < 8 * counts:
            raise FormatError(f"section {name!r}: {size:,} bytes at byte {start:,} of {len(view):,}")
        most = max(_number(view, start + 8 * number) for number in range(counts))
        if most > MAX_INTEGERS_PER_BYTE * size:
            raise FormatError(f"section {name!r}: {size:,} bytes hold no {most:,} entries")


def _number(view: memoryview, place: int) -> int:
    return int(struct.unpack_from("<Q", view, place)[0])
