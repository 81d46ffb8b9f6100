"""Reading OpenUSD by its own library, `usd-core`: the Gaussians of a ParticleField3DGaussianSplat, and what is named.

Coordinates are those of the prim itself: converters turn the prim, or one above it, to the stage's up axis, and leave
the numbers in the axes of the poses. So a scene that was written and read back has the fingerprint that it had.

A layer is read as it lies in the file: nothing that it refers to is opened. What would crash the library, or make it
allocate what is not there, is refused before it sees it: brackets that lie deep in each other in a text, and the counts
in the head of a `.usdc`. Its byte 16 says where the table of contents is, a count and, of 32 bytes each, a section's
name, start and size. A section begins with the count of its entries; a second one follows in two of them. Numbers are
little-endian, of 8 bytes.

Sources: openusd.org, UsdVol "ParticleField3DGaussianSplat" of OpenUSD 26.03, "USDA File Format"; OpenUSD 26.11,
pxr/usd/sdf/crateFile.cpp, which is all that describes `.usdc`.
"""

import re
import struct
import warnings
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..base.arrays import Array, Arrays, Float64
from ..base.contents import file_bytes, open_file
from ..errors import FormatError, InputError, MissingExtraError, pip_install, placed, warn
from ..scene.gaussians import SH_COEFFICIENTS, Gaussians, concatenated
from ..scene.labelled import PLY_UP, Annotation, LabelledScene, Thing, places_of
from .activation import checked

SUFFIXES = (".usda", ".usdc", ".usdz", ".usd")
SCHEMA, TEXT, CRATE, ZIP = "ParticleField3DGaussianSplat", b"#usda", b"PXR-USDC", b"PK\x03\x04"
DISPLAYED = re.compile(r"(srgb|g22)(_rec709\w*|_texture)?|raw|data|auto|unknown|identity|", re.IGNORECASE)
MAX_DEGREE, MAX_STORED_DEGREE = 3, 10
MAX_NESTING = 200  # of prims, and of brackets in a text
_COLUMNS = {"positions": 3, "orientations": 4, "scales": 3, "opacities": 1}
HARMONICS = "radiance:sphericalHarmonicsCoefficients"
_TO_WXYZ = [3, 0, 1, 2]  # of quaternions, whose real part the library keeps last
_QUOTED = re.compile(  # text, paths and comments, whose brackets are none
    rb"\"{3}(?:\\.|[^\\])*?(?:\"{3}|\Z)|'{3}(?:\\.|[^\\])*?(?:'{3}|\Z)|\"(?:\\.|[^\\\"\n])*+\"?|'(?:\\.|[^\\'\n])*+'?"
    rb"|@@@.*?(?:@@@|\Z)|@[^@\n]*+@?|#[^\n]*+|//[^\n]*+|/\*.*?(?:\*/|\Z)",
    re.DOTALL,
)
_LARGE = re.compile(  # an array of numbers, of which the library would take a dozen times its text
    rb"(\w++)(\[\]\s++[\w:]++\s*+=\s*+)\[([^][\"'@<{#]{262144,}+)\](\s*+\()?+"
)
_PLACE = "displayGroup"  # metadatum that says which of them stood there
_OPENING, _CLOSING = np.frombuffer(b"([{", np.uint8), np.frombuffer(b")]}", np.uint8)
_CHUNK_BYTES = 4 << 20  # whose brackets are counted at once
HEAD_BYTES, ENTRY_BYTES = 24, 32
MAX_INTEGERS_PER_BYTE = 4 * 255  # LZ4 makes at most 255 bytes of one, with four integers in each
FIRST_COMPRESSED_VERSION = (0, 4)  # the first whose sections are compressed and begin as they do here
TWO_COUNTS = (b"TOKENS", b"PATHS")


def openusd() -> Any:
    """Return the package pxr. Raises: MissingExtraError: it is not installed."""
    try:
        from pxr import Sdf, Tf, Vt  # noqa: F401
    except ModuleNotFoundError:
        raise MissingExtraError(f"USD needs OpenUSD's own library: {pip_install('usd')}") from None
    import pxr

    return pxr


def read_usd(path: Path) -> LabelledScene:
    """Read a scene with its objects from `.usda`, `.usdc`, `.usd` or `.usdz`.

    Raises: InputError: there is no such file. FormatError: no USD, no Gaussians in it, damaged. MissingExtraError:
    OpenUSD's library is not installed.
    """
    try:
        content = file_bytes(path).data
        return parse_usd(_first_layer(path) if bytes(content[:4]) == ZIP else content, path)
    except FormatError as error:
        raise FormatError(placed(path, error)) from None


def _first_layer(path: Path) -> memoryview:
    """Return the first file of a package, which is the one that is opened; its bytes lie there as they are."""
    try:
        with open_file(path) as file, zipfile.ZipFile(file) as package:
            first = package.infolist()[0]
            if first.compress_type != zipfile.ZIP_STORED:
                raise FormatError(f"{first.filename!a:.60} is compressed, and files of a .usdz are stored")
            if Path(first.filename).suffix.lower() not in (".usda", ".usdc", ".usd"):
                raise FormatError(f"the first file of a .usdz is its scene, got {first.filename!a:.60}")
            return memoryview(package.read(first))
    except (zipfile.BadZipFile, IndexError, EOFError, OSError, ValueError, NotImplementedError, RuntimeError) as error:
        raise FormatError(f"the package is damaged: {error}") from None


def parse_usd(content: memoryview, path: Path | None = None) -> LabelledScene:
    """Return the scene of a layer. path: of the file that has it, which the library opens where it is binary.

    Raises: FormatError, MissingExtraError: as `read_usd`.
    """
    start = bytes(content[:8])
    if start != CRATE and not start.startswith(TEXT):
        raise FormatError(f"no USD begins with {start[:5]!r}: expected text (#usda), binary (PXR-USDC) or a .usdz")
    pxr = openusd()
    arrays: Arrays = {}
    try:
        if start == CRATE:
            refuse_false_counts(content)
            layer = pxr.Sdf.Layer.OpenAsAnonymous(str(path))
        else:
            text, arrays = _without_large_arrays(content)
            _refuse_deep_brackets(text)
            layer = pxr.Sdf.Layer.CreateAnonymous(".usda")
            layer.ImportFromString(text.decode())
        if layer is None:
            raise FormatError("OpenUSD does not read it")
        return _scene(pxr, layer, arrays)
    except pxr.Tf.ErrorException as error:  # also of a value that is unpacked only when somebody asks for it
        message = str(error).rsplit(" : ", 1)[-1].strip("'\n\t ")[:200]  # without the place in its source code
        raise FormatError(f"OpenUSD does not read it: {message}") from None
    except (UnicodeDecodeError, MemoryError) as error:
        raise FormatError(f"OpenUSD reads what is no text, or has no end: {error}") from None


def _walk(pxr: Any, layer: Any) -> Iterator[tuple[Any, str]]:
    """Yield all defined prims and their colour spaces, a parent before its children, in the order of the file.

    A prim's space is its own where ColorSpaceAPI is applied to it, else that of those above.
    """
    waiting = [(prim, "", 1) for prim in reversed(list(layer.rootPrims))]
    while waiting:
        prim, space, depth = waiting.pop()
        if prim is None:
            raise FormatError("a prim names a child that is not there")
        if depth > MAX_NESTING:
            raise FormatError(f"expected prims in prims up to {MAX_NESTING} deep")
        if prim.specifier == pxr.Sdf.SpecifierDef:
            if "ColorSpaceAPI" in str(prim.GetInfo("apiSchemas")):
                space = _text(prim, "colorSpace:name") or space
            yield prim, space
            waiting += [(child, space, depth + 1) for child in reversed(list(prim.nameChildren))]


def _scene(pxr: Any, layer: Any, arrays: Arrays) -> LabelledScene:
    prims = list(_walk(pxr, layer))
    gaussians = _gaussians(prims, arrays)
    root = next((prim for prim, _ in prims if "drsplat:up" in prim.attributes), layer.pseudoRoot)
    of_kind: dict[str, list[Any]] = {}
    for prim, _ in prims:
        of_kind.setdefault(_text(prim, "drsplat:kind"), []).append(prim)
    things, groups, matches = (tuple(map(_thing, of_kind.get(kind, ()))) for kind in ("object", "group", "match"))
    numbers = gaussians.extra.get("object_id")
    x, y, z = _numbers(root, "drsplat:up", np.array(PLY_UP)).tolist()
    return LabelledScene(
        gaussians, root.GetInfo("displayName") or "scene", things, groups,
        None if numbers is None else places_of(numbers, things), _text(root, "drsplat:query"),
        gaussians.extra.get("relevancy"), matches, tuple(map(_annotation, of_kind.get("annotation", ()))), (x, y, z),
        _text(root, "drsplat:encoder"),
    )  # fmt: skip


def _gaussians(prims: list[tuple[Any, str]], arrays: Arrays) -> Gaussians:
    parts = [_splat(prim, space, arrays) for prim, space in prims if prim.typeName == SCHEMA]
    if not parts:
        kinds = sorted({prim.typeName for prim, _ in prims if prim.typeName})[:8]
        raise FormatError(
            f"no prim of the schema {SCHEMA}, only {', '.join(kinds) or 'prims without one'}: what lies in other "
            "files or in variants is not read; flatten the stage first"
        )
    if len(parts) == 1:
        return parts[0]
    if any("xformOpOrder" in prim.attributes for prim, _ in prims):
        raise FormatError(f"{len(parts)} splats, and prims that are moved: write each into a file of its own")
    return concatenated(parts)


def _splat(prim: Any, space: str, large: Arrays) -> Gaussians:
    where = f"prim '{prim.name}'"
    # that of the prim itself may not be applied
    spaces = [*(attribute.colorSpace for attribute in prim.attributes), space, _text(prim, "colorSpace:name")]
    other = next((space for space in spaces if not DISPLAYED.fullmatch(space)), None)
    if other is not None:
        raise FormatError(
            f"{where}: its colour space is {other!a:.60}: colours of linear light, or of "
            "other primaries, look otherwise than those of photos. Export it in srgb_rec709_scene"
        )
    arrays = {name: _rows(prim, name, width, large) for name, width in _COLUMNS.items()}
    count = len(arrays["positions"])
    for name, array in arrays.items():
        if len(array) != count:
            raise FormatError(f"{where}: {count:,} positions, but {len(array):,} {name}")
    if not count:
        raise FormatError(f"{where} has no Gaussians")
    extra: Arrays = {}
    for name in (name for name in prim.attributes.keys() if name.startswith("primvars:")):  # noqa: SIM118
        value, column = _value(prim, name, large), name.removeprefix("primvars:")
        if isinstance(value, np.ndarray) and value.shape == (count,):
            narrow = value.astype(np.int32 if column == "object_id" else np.float32)
            extra[column] = narrow if (narrow == value).all() else value
    gaussians = checked(
        arrays["positions"], arrays["orientations"], arrays["scales"], arrays["opacities"][:, 0],
        _harmonics(prim, count, large), extra, bool(_number(prim, "drsplat:antialiased", 0)),
    )  # fmt: skip
    return replace(gaussians, origin=_numbers(prim, "drsplat:origin", np.zeros(3)))


def _rows(prim: Any, name: str, width: int, large: Arrays) -> Array:
    """Return an array of float32, or of half precision where there is no other."""
    values = (_value(prim, one, large) for one in (name, f"{name}h"))
    value = next((value for value in values if value is not None), None)
    if value is None and any(
        one in prim.attributes and prim.attributes[one].HasInfo("timeSamples") for one in (name, f"{name}h")
    ):
        raise FormatError(f"prim '{prim.name}': its {name} move with time: write one time of it")
    if not isinstance(value, np.ndarray) or value.size % width:
        raise FormatError(f"prim '{prim.name}': expected {name} of {width} numbers each")
    return value.astype(np.float32).reshape(-1, width)


def _harmonics(prim: Any, count: int, large: Arrays) -> Array:
    """Return (count, k, 3) coefficients; those of degrees above 3 are left out, with a warning."""
    degree = _number(prim, "radiance:sphericalHarmonicsDegree", MAX_DEGREE)
    if not (0 <= degree <= MAX_STORED_DEGREE and degree == int(degree)):
        raise FormatError(f"prim '{prim.name}': expected harmonics of a degree from 0 to {MAX_DEGREE}, got {degree}")
    stored = (int(degree) + 1) ** 2
    values = _rows(prim, HARMONICS, 3, large)
    if len(values) < count * stored:
        raise FormatError(
            f"prim '{prim.name}': {count:,} Gaussians of degree {int(degree)} have {count * stored:,} harmonics, got "
            f"{len(values):,}"
        )
    if degree > MAX_DEGREE:
        warn(f"harmonics of degree {int(degree)} are cut to {MAX_DEGREE}")
    kept = SH_COEFFICIENTS[min(int(degree), MAX_DEGREE)]
    return np.ascontiguousarray(values[: count * stored].reshape(count, stored, 3)[:, :kept])


def _value(prim: Any, name: str, large: Mapping[str, Array] = {}) -> str | Array | None:
    """Return an attribute: text, or numbers in one row; None where there is none, or anything else."""
    attribute = prim.attributes.get(name)
    value = None if attribute is None else attribute.default
    if value is None or isinstance(value, str):
        return value
    if attribute.GetInfo(_PLACE) in large:
        return large[attribute.GetInfo(_PLACE)]
    try:
        numbers = np.asarray(value)
        if type(value).__name__.startswith("Quat") and numbers.ndim == 2:
            numbers = numbers[:, _TO_WXYZ]
    except (TypeError, ValueError):
        return None
    return numbers.reshape(-1) if numbers.dtype.kind in "fiub" else None


def _text(prim: Any, name: str) -> str:
    value = _value(prim, name)
    return value if isinstance(value, str) else ""


def _numbers(prim: Any, name: str, default: Float64[Array, "..."]) -> Float64[Array, "..."]:
    """Return finite numbers of the default's shape, the default where there are none."""
    value = _value(prim, name)
    if value is None:
        return default
    if isinstance(value, str) or value.size != default.size or not np.isfinite(value).all():
        raise FormatError(f"prim '{prim.name}': expected {default.size} finite numbers as {name}")
    return value.astype(np.float64).reshape(default.shape)


def _number(prim: Any, name: str, default: float | int) -> float:
    return float(_numbers(prim, name, np.array(float(default))))


def _thing(prim: Any) -> Thing:
    embedding = _value(prim, "drsplat:embedding")
    return Thing(
        prim.GetInfo("displayName") or prim.name,
        _number(prim, "drsplat:score", 0),
        _numbers(prim, "drsplat:center", np.zeros(3)),
        _numbers(prim, "drsplat:axes", np.eye(3)),
        _numbers(prim, "drsplat:extent", np.zeros(3)),
        int(_number(prim, "drsplat:parent", -1)),
        embedding.astype(np.float32) if isinstance(embedding, np.ndarray) else None,
        int(_number(prim, "drsplat:number", -1)),
    )


def _annotation(prim: Any) -> Annotation:
    thing = _thing(prim)
    try:
        if "drsplat:extent" not in prim.attributes:
            return Annotation.at(prim.GetInfo("displayName"), thing.center)
        return Annotation.box(thing.name, thing.center, thing.axes, thing.extent)
    except InputError as error:
        raise FormatError(f"prim '{prim.name}': {error}") from None


def _without_large_arrays(content: memoryview) -> tuple[bytes, Arrays]:
    """Return a text whose large arrays are empty, and their numbers by what is said as `_PLACE` there."""
    pieces: list[bytes] = []
    arrays: Arrays = {}
    end = 0
    for match in _LARGE.finditer(content):
        name = f"array {len(arrays)}"
        arrays[name] = _numbers_in(content[slice(*match.span(3))], bytes(match[1]))
        stands_for = f'[] (\n{_PLACE} = "{name}"\n{"" if match[4] else ")"}'.encode()
        pieces += [bytes(content[end : match.end(2)]), stands_for]
        end = match.end()
    return b"".join([*pieces, bytes(content[end:])]), arrays


@np.errstate(over="ignore")
def _numbers_in(text: memoryview, kind: bytes) -> Array:
    """Return the numbers of an array's text in one row, a piece at a time; kind: its type, as of USD."""
    dtype = np.float32 if kind.startswith((b"float", b"half")) or kind[-1:] in (b"f", b"h") else np.float64
    parts, begin = [], 0
    while begin < len(text):
        piece = bytes(text[begin : begin + _CHUNK_BYTES])
        if begin + len(piece) < len(text):
            piece = piece[: piece.rfind(b",") + 1] or piece
        begin += len(piece)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", DeprecationWarning)
                numbers = np.fromstring(piece.translate(None, b"()").strip(b", \t\r\n"), np.float64, sep=",")
        except (DeprecationWarning, ValueError):
            raise FormatError(f"expected numbers with commas between them, got {piece[:40]!r}") from None
        parts.append(numbers.astype(dtype))
    return np.concatenate(parts)


def _refuse_deep_brackets(text: bytes) -> None:
    """Refuse brackets in brackets, at which the library's parser would run out of its stack. Raises: FormatError."""
    bare, depth = np.frombuffer(_QUOTED.sub(b"", text), np.uint8), 0
    for begin in range(0, len(bare), _CHUNK_BYTES):
        chunk = bare[begin : begin + _CHUNK_BYTES]
        depths = depth + np.cumsum(np.isin(chunk, _OPENING).astype(np.int64) - np.isin(chunk, _CLOSING))
        if depths.max() > MAX_NESTING:
            raise FormatError(f"expected brackets in brackets up to {MAX_NESTING} deep")
        depth = depths[-1]


def refuse_false_counts(view: memoryview) -> None:
    """Check the counts of a file. Raises: FormatError: one that its bytes have no room for, or a section elsewhere."""
    if len(view) < HEAD_BYTES:
        raise FormatError(f"the file ends after {len(view)} bytes")
    version, table = tuple(view[8:10]), _count_at(view, 16)
    if table + 8 > len(view) or _count_at(view, table) > (len(view) - table - 8) // ENTRY_BYTES:
        raise FormatError(f"no table of contents at byte {table:,} of {len(view):,}")
    for place in range(table + 8, table + 8 + ENTRY_BYTES * _count_at(view, table), ENTRY_BYTES):
        name, start, size = bytes(view[place : place + 16]).rstrip(b"\0"), *struct.unpack_from("<QQ", view, place + 16)
        counts = 2 if name in TWO_COUNTS and version >= FIRST_COMPRESSED_VERSION else 1
        if start + size > len(view) or size < 8 * counts:
            raise FormatError(f"section {name!r}: {size:,} bytes at byte {start:,} of {len(view):,}")
        most = max(_count_at(view, start + 8 * number) for number in range(counts))
        if most > MAX_INTEGERS_PER_BYTE * size:
            raise FormatError(f"section {name!r}: {size:,} bytes hold no {most:,} entries")


def _count_at(view: memoryview, place: int) -> int:
    return int(struct.unpack_from("<Q", view, place)[0])
