"""3DGS PLY as INRIA's trainer, nerfstudio, gsplat and SuperSplat write it.

The file holds values before their activation: `scale_0..2` are logarithms, `opacity` a logit, `rot_0..3` (w, x, y, z)
not normalised, `f_dc_0..2` the constant SH coefficient and `f_rest_*` the others channel by channel (all of red, then
green, then blue). Axes are the training frame's. Properties are found by name, in any order and of any scalar type.

A comment of the header says whether opacities are of Gaussians that are drawn antialiased, in one of two spellings
(`drawn_as_marked`); without one they are not. A file without `scale_2`, or with the comment "SplatRenderMode: 2dgs",
is of surfels, which are read as Gaussians next to no thickness. Files of other exporters are read as they are meant:
colours in place of harmonics, half floats in integers of two bytes, values that are activated already.

Source: Kerbl et al., "3D Gaussian Splatting" (2023); the PLY properties of its published models, and of those of Huang
et al., "2D Gaussian Splatting" (2024).

SuperSplat's compressed PLY: 16 bytes per Gaussian, quantised within chunks of 256.

Element `chunk` holds the bounds of positions, log scales and (since SuperSplat 2) colours of 256
consecutive rows of `vertex`, which packs position and scale as 11-10-11 bits, rotation as 2 bits
for the largest component and 10 for each other, colour and opacity as 8 bits each. An optional
element `sh` has one byte per further SH coefficient. Axes and SH order are those of a 3DGS PLY;
rows have been sorted along a Morton curve, so they are not the rows of the PLY it was made from.

Source: PlayCanvas, "Compressed PLY format" (SuperSplat user manual).
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..base.arrays import Arrays, Float32, FloatRows, Shaped, UnsignedIds, Vector3, Vectors
from ..base.contents import AnyPath
from ..errors import FormatError, InputError, warn
from ..scene.gaussians import SH_C0, SH_COEFFICIENTS, Gaussians, filled, flat, local_origin
from .activation import checked, exp, from_smallest_three, logit, refuse_packed_name, refuse_unreadable, sigmoid
from .ply import Header, Records, gather, read_elements, write_vertices

MEANS = ("x", "y", "z")
NORMALS = ("nx", "ny", "nz")
DC = ("f_dc_0", "f_dc_1", "f_dc_2")
SCALES = ("scale_0", "scale_1", "scale_2")
THICKNESS_PROPERTY = SCALES[2]  # surfels lack it
MOVES = "trbf_center"  # of SpacetimeGaussians
RGB = ("red", "green", "blue")  # in place of DC, as `ns-export gaussian-splat --ply-color-mode rgb` writes
QUATS = ("rot_0", "rot_1", "rot_2", "rot_3")
ANTIALIASED, SURFELS = "SplatRenderMode: mip", "SplatRenderMode: 2dgs"  # as Brush writes it
DRAWN_ANTIALIASED = ("splatrendermode: mip", "antialiased 1")
MARKED = ("splatrendermode: ", "antialiased ")
DISPLAYED = ("srgb", "rec709", "bt709", "gamma", "none")  # beginnings of spaces that photos have
JUDGED_ROWS, MIN_JUDGED_ROWS = 100_000, 20
MIN_RANGE = 0.05  # of activated values, which are never all the same
MAX_SMALL_SHARE = 0.3  # of large scales, of the small ones: logarithms that are all positive are more alike
EDITED, HEADER_BEGIN_BYTES = "edited by drsplat", 256
REQUIRED = (*MEANS, *DC, "opacity", *SCALES, *QUATS)


def parse_gaussian_ply(buffer: memoryview, header: Header) -> Gaussians:
    """Return the Gaussians of the element `vertex`.

    Further scalar properties are kept in `extra` with their types; so are normals, unless all are
    zero (trainers write zeros there for want of anything to say).

    Raises: FormatError: no 3DGS PLY, truncated, or rows that are no Gaussians.
    """
    rows = gaussian_rows(buffer, header)
    return drawn_as_marked(gaussians_of(rows, activated_columns(rows)), header)


def drawn_as_marked(gaussians: Gaussians, header: Header) -> Gaussians:
    """Return Gaussians that are antialiased, or surfels, as the last comment says that speaks of it.

    Brush writes `SplatRenderMode: default`, `mip` or `2dgs`, Postshot `antialiased 0` or `1`; case does not count.
    Those of a file without `scale_2` are surfels already, whatever a comment says.
    """
    comments = [" ".join(comment.lower().split()) for comment in header.comments]
    mark = next((comment for comment in reversed(comments) if comment.startswith(MARKED)), "")
    if gaussians.surfels:
        return gaussians
    return (
        gaussians.flattened() if mark == SURFELS.lower() else replace(gaussians, antialiased=mark in DRAWN_ANTIALIASED)
    )


def gaussian_rows(buffer: memoryview, header: Header) -> Records:
    """Return the rows of `vertex` as they are in the file; of a binary one, a view of `buffer`.

    Raises: FormatError: no 3DGS PLY, or truncated.
    """
    names = header.elements["vertex"].names() if "vertex" in header.elements else []
    has_colours = set(RGB) <= set(names)
    missing = [name for name in REQUIRED if name not in names and not (has_colours and name in DC)]
    if missing and missing != [THICKNESS_PROPERTY]:
        raise FormatError(
            f"vertex has {', '.join(names[:12]) or 'nothing'}, and no {', '.join(missing)}: no 3DGS PLY, but points or "
            "a mesh. `drsplat train` makes Gaussians of their photos"
        )
    if MOVES in names:
        raise FormatError(
            f"vertex has {MOVES}: SpacetimeGaussians, which move by formulas that are not read: write the scene "
            "as numbered PLY files (frame0000.ply), one for each time"
        )
    _refuse_linear_light(buffer, header)
    rows = read_elements(buffer, header, {"vertex"})["vertex"]
    return _halves_as_floats(rows, {*REQUIRED, *_rest_names(names)})


def _halves_as_floats(rows: Records, known: set[str]) -> Records:
    """Return rows whose integers of two bytes are half floats, as exporters write them for want of a type in PLY.

    Raises: FormatError: other integers in place of fractions.
    """
    fields = {name: rows.dtype[name] for name in rows.dtype.names or ()}
    whole = [name for name, code in fields.items() if name in known and code.kind in "iu"]
    narrow = [name for name in whole if fields[name].itemsize == 2]
    if whole != narrow:
        others = [name for name in whole if name not in narrow]
        raise FormatError(
            f"vertex has whole numbers ({fields[others[0]].name}) as {', '.join(others[:6])}, where Gaussians have "
            "fractions: quantised, by a rule that PLY does not tell. Export it with the type float"
        )
    halves = [(name, code.str[0] + "f2" if name in narrow else code.str) for name, code in fields.items()]
    return rows.view(np.dtype(halves)) if narrow else rows


def _refuse_linear_light(buffer: memoryview, header: Header) -> None:
    """Refuse colours of linear light, which an element (SHARP) or a comment `color_space` says."""
    named = [re.sub(r"[:=]", " ", line.lower().replace("_", "")).split() for line in header.comments]
    said = [words[1] for words in named if len(words) > 1 and words[0].endswith("colorspace")]
    element = header.elements.get("color_space")
    if element is not None and element.count and not element.has_lists and element.properties:
        value = read_elements(buffer, header, {"color_space"})["color_space"][0][0]
        said.append("srgb" if value == 0 else f"number {value}, linear light")
    other = next((space for space in said if not space.startswith(DISPLAYED)), None)
    if other is not None:
        raise FormatError(
            f"its color_space is {other!a:.40}: colours of linear light blend otherwise than those of photos, and "
            "would be far too dark. Export it in sRGB"
        )


def activated_columns(rows: Records) -> frozenset[str]:
    """Return which of "opacity", "scale" and "f_dc" hold values after their activation, in place of those before it.

    Opacities that all lie in 0 to 1 were no logits: no Gaussian would be fainter than 0.5 or more solid than 0.73.
    Scales that are all positive were no logarithms where the smallest are many times smaller than the largest, or where
    most Gaussians would be larger than a tenth of the scene. Harmonics that fill 0 to 1, with no others, are colours.

    Warns: DrSplatWarning: what is read so.
    """
    some = np.ascontiguousarray(rows[:: max(1, len(rows) // JUDGED_ROWS)])
    if len(some) < MIN_JUDGED_ROWS:
        return frozenset()
    found, names = [], some.dtype.names or ()
    opacities, scales = gather(some, ["opacity"]), gather(some, [name for name in SCALES if name in names])
    if opacities.min() >= 0 and opacities.max() <= 1 and np.ptp(opacities) > MIN_RANGE:
        found.append("opacity")
    tenth = 0.1 * float(np.ptp(np.quantile(gather(some, MEANS), (0.05, 0.95), axis=0), axis=0).max())
    small, large = np.quantile(scales, (0.05, 0.95))
    middle = np.float64(np.median(scales.max(1)))
    if scales.min() > 0 and (small < MAX_SMALL_SHARE * large or middle < tenth < np.exp(middle)):
        found.append("scale")
    if set(DC) <= set(names) and not _rest_names(list(names)):
        colours = gather(some, DC)
        if 0 <= colours.min() < MIN_RANGE and 1 - MIN_RANGE < colours.max() <= 1:
            found.append("f_dc")
    if found:
        text = f"{', '.join(found)}: values that are activated already, in place of logits, logarithms and harmonics"
        warn(f"{text}; they are read as such. Export the file again if it looks wrong", 4)
    return frozenset(found)


def gaussians_of(rows: Records, activated: frozenset[str] = frozenset()) -> Gaussians:
    """Return some rows of `vertex`. activated: of `activated_columns`. Raises: FormatError: they are no Gaussians."""
    rest = _rest_names(list(rows.dtype.names or ()))
    means, origin = _means(rows)
    opacities = gather(rows, ["opacity"])[:, 0]
    harmonics = DC if set(DC) <= set(rows.dtype.names or ()) else RGB
    # harmonics; the constant ones may be colours, whole numbers of any width or fractions
    names = [*harmonics, *rest]
    sh = gather(rows, names).reshape(len(rows), len(names) // 3, 3)
    if harmonics == RGB or "f_dc" in activated:
        code = rows.dtype[names[0]]
        most = np.iinfo(code).max if code.kind in "iu" else 255 if sh[:, 0].max(initial=0) > 1 else 1
        sh[:, 0] = (sh[:, 0] / np.float32(most) - np.float32(0.5)) / np.float32(SH_C0)
    gaussians = checked(
        means,
        gather(rows, QUATS),
        _scales(rows, "scale" in activated),
        opacities if "opacity" in activated else sigmoid(opacities),
        sh,
        extra_columns(rows, {*REQUIRED, *rest, *harmonics}),
    )
    return replace(gaussians, origin=origin)


def _scales(rows: Records, activated: bool) -> Vectors:
    names = [name for name in SCALES if name in (rows.dtype.names or ())]
    scales = gather(rows, names) if activated else exp(gather(rows, names))
    return scales if len(names) == len(SCALES) else flat(scales)


def _means(rows: Records) -> tuple[Vectors, Vector3]:
    """Return the positions and what they are counted from: doubles far from zero would lose as float32."""
    if not any(rows.dtype[name].base == np.float64 for name in MEANS):
        return gather(rows, MEANS), np.zeros(3)
    positions = np.stack([rows[name] for name in MEANS], 1).astype(np.float64)
    origin = local_origin(positions)
    return (positions - origin).astype(np.float32), origin


def _rest_names(names: list[str], element: str = "vertex") -> list[str]:
    """Return the names of the varying harmonics in the memory order of Gaussians.sh: channels innermost."""
    count = sum(name.startswith("f_rest_") for name in names)
    per_channel = count // 3
    rest = [f"f_rest_{channel * per_channel + c}" for c in range(per_channel) for channel in range(3)]
    if count % 3 or 1 + per_channel not in SH_COEFFICIENTS or not set(rest) <= set(names):
        raise FormatError(
            f"{element} has {count} f_rest properties; expected f_rest_0 onwards, 0, 9, 24 or 45 of them (SH degree "
            "0-3)"
        )
    return rest


def extra_columns(rows: Records, known: set[str]) -> Arrays:
    """Return copies, in native byte order, of the columns that are not `known`."""
    names = [name for name in rows.dtype.names or () if name not in known]
    extra = {name: rows[name].astype(rows.dtype[name].newbyteorder("=")) for name in names}
    if not any(extra[name].any() for name in NORMALS if name in extra):
        extra = {name: column for name, column in extra.items() if name not in NORMALS}
    return extra


def vertex_columns(gaussians: Gaussians) -> Arrays:
    """Return pre-activation columns in the published order, normals among them, without other extras.

    Normals are those of `extra`, or zero, as trainers write them: viewers of 3DGS read rows of a fixed length.

    Positions are those of the world: float64 where float32 would lose some of them, else float32. Surfels have no third
    scale, as 2DGS writes them.

    Raises: InputError: values that could not be read back.
    """
    refuse_unreadable(gaussians)
    widths = SCALES[:2] if gaussians.surfels else SCALES
    rest = [gaussians.sh[:, c, channel] for channel in range(3) for c in range(1, gaussians.sh.shape[1])]
    log_scales = np.log(gaussians.scales)
    return {
        **dict(zip(MEANS, gaussians.narrow_positions.T, strict=True)),
        **{name: np.asarray(gaussians.extra.get(name, np.zeros(len(gaussians))), np.float32) for name in NORMALS},
        **dict(zip(DC, gaussians.sh[:, 0].T, strict=True)),
        **{f"f_rest_{i}": column for i, column in enumerate(rest)},
        "opacity": logit(gaussians.opacities),
        **dict(zip(widths, log_scales.T, strict=False)),
        **dict(zip(QUATS, gaussians.quats.T, strict=True)),
    }


def write_gaussians(
    path: AnyPath,
    gaussians: Gaussians,
    columns: Mapping[str, Shaped[np.ndarray, " n"]] = {},
    overwrite: bool = False,
    sh_degree: int | None = None,
    *,
    is_edited: bool = False,
) -> None:
    """Write a 3DGS PLY, `gaussians.extra` and `columns` as further scalar properties, atomically.

    Without further properties the file is what the viewer of 3DGS (SIBR) reads, rows of 62 floats, when it has
    harmonics of degree 3. sh_degree: fills them up to this degree with zeros, which look the same.

    SuperSplat shows and splat-transform filters any such property (`-V relevancy,gt,0.5`). A column
    takes the place of an extra of the same name. Positions are stored exactly, so the fingerprint
    stays: as float32, or as double where they are counted from an origin. The rest passes through a logarithm and back.
    is_edited: says so in the header, see `was_edited`. Antialiased Gaussians and surfels have the comment of Brush.

    Raises: InputError: `path` exists and not `overwrite`, a suffix other than .ply, a column of
    another length, type or name than a PLY can hold, or of a property that the format itself uses; a
    `sh_degree` below that of the Gaussians or above 3.

    >>> relevancy = scene.ask("red mug").dense
    >>> ds.write_gaussians("answer.ply", scene.gaussians, {"relevancy": relevancy})
    """
    refuse_packed_name(path)
    if Path(path).suffix.lower() != ".ply":
        raise InputError(f"scenes are written as PLY: give {Path(path).name} the suffix .ply")
    properties = vertex_columns(gaussians if sh_degree is None else _filled(gaussians, sh_degree))
    own = {name: column for name, column in gaussians.extra.items() if name not in NORMALS}
    further = {**own, **columns}
    for name, column in further.items():
        if name in properties or name.startswith("f_rest_"):
            raise InputError(f"column '{name}' would replace a property of the Gaussians: call it something else")
        if column.shape != (len(gaussians),):
            raise InputError(f"column '{name}': expected shape ({len(gaussians)},), got {column.shape}")
    mark = SURFELS if gaussians.surfels else ANTIALIASED if gaussians.antialiased else ""
    comments = [comment for comment in (EDITED if is_edited else "", mark) if comment]
    write_vertices(path, {**properties, **further}, overwrite, comments)


def was_edited(path: Path) -> bool:
    """Return whether a file is a PLY that was written as edited, beside which the scene itself may lie."""
    with path.open("rb") as file:
        return f"\ncomment {EDITED}\n".encode() in file.read(HEADER_BEGIN_BYTES)


def _filled(gaussians: Gaussians, sh_degree: int) -> Gaussians:
    """Fill in zeros for the harmonics up to a degree."""
    if not gaussians.sh_degree <= sh_degree < len(SH_COEFFICIENTS):
        raise InputError(f"sh_degree: expected {gaussians.sh_degree}, which the Gaussians have, to 3; got {sh_degree}")
    return replace(gaussians, sh=filled(gaussians.sh, SH_COEFFICIENTS[sh_degree]))


CHUNK_ROWS = 256
BLOCK_CHUNKS = 64  # that are unpacked at once
PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
POSITION_BOUNDS = ("min_x", "min_y", "min_z", "max_x", "max_y", "max_z")
SCALE_BOUNDS = ("min_scale_x", "min_scale_y", "min_scale_z", "max_scale_x", "max_scale_y", "max_scale_z")
COLOUR_BOUNDS = ("min_r", "min_g", "min_b", "max_r", "max_g", "max_b")


def is_compressed(header: Header) -> bool:
    """Return True if the header is that of a compressed PLY: a `vertex` with a packed position."""
    return "vertex" in header.elements and "packed_position" in header.elements["vertex"].names()


def parse_compressed_ply(buffer: memoryview, header: Header) -> Gaussians:
    """Return the Gaussians of a compressed PLY; further properties of `vertex` are kept in `extra`.

    Raises: FormatError: properties missing, elements whose counts do not fit, or rows that are no Gaussians.
    """
    _require(header, "vertex", PACKED, "u4")
    _require(header, "chunk", (*POSITION_BOUNDS, *SCALE_BOUNDS), "f4")
    rest = _packed_rest_names(header)
    tables = read_elements(buffer, header, {"chunk", "vertex", *(["sh"] if rest else [])})
    vertex, chunk = tables["vertex"], tables["chunk"]
    if len(chunk) != -(-len(vertex) // CHUNK_ROWS):
        raise FormatError(f"{len(vertex)} packed Gaussians need a chunk per {CHUNK_ROWS}, got {len(chunk)} chunks")
    position, rotation, scale, colours = (vertex[name].astype(np.uint32) for name in PACKED)
    means, log_scales, colour = _unpack(position, 11, 10, 11), _unpack(scale, 11, 10, 11), _unpack(colours, 8, 8, 8, 8)
    _within_chunks(means, gather(chunk, POSITION_BOUNDS))
    _within_chunks(log_scales, gather(chunk, SCALE_BOUNDS))
    if set(COLOUR_BOUNDS) <= set(chunk.dtype.names or ()):
        _within_chunks(colour[:, :3], gather(chunk, COLOUR_BOUNDS))
    sh = np.empty((len(vertex), 1 + len(rest) // 3, 3), np.float32)
    sh[:, 0] = (colour[:, :3] - 0.5) / SH_C0
    if rest:
        # Turn bytes into [-4, 4]: 0 and 255 are the ends of it, all others the middle of their step
        steps = (np.arange(256, dtype=np.float32) + np.float32(0.5)) / 32 - 4
        steps[[0, 255]] = -4, 4
        for place, name in enumerate(rest):
            sh[:, 1 + place // 3, place % 3] = steps[tables["sh"][name]]
    three = (_unpack(rotation, 10, 10, 10) - np.float32(0.5)) * np.float32(np.sqrt(2))
    quats = from_smallest_three(three, rotation >> np.uint32(30))
    extra = extra_columns(vertex, set(PACKED))
    return drawn_as_marked(checked(means, quats, exp(log_scales), colour[:, 3].copy(), sh, extra), header)


def _require(header: Header, element: str, names: tuple[str, ...], code: str) -> None:
    found = {p.name: p.code for p in header.elements[element].properties} if element in header.elements else {}
    wrong = [name for name in names if found.get(name) != code]
    if wrong:
        raise FormatError(f"compressed PLY: '{element}' must have {', '.join(wrong)} of type {code}")


def _packed_rest_names(header: Header) -> list[str]:
    """Return the properties of the further harmonics, in coefficient-major order."""
    if "sh" not in header.elements:
        return []
    element = header.elements["sh"]
    names = _rest_names(element.names(), "compressed PLY: 'sh'")
    if not names or len(names) < len(element.properties):
        raise FormatError("compressed PLY: 'sh' must have the properties f_rest_0 onwards, 9, 24 or 45 of them")
    _require(header, "sh", tuple(names), "u1")
    count = header.elements["vertex"].count
    if element.count != count:
        raise FormatError(f"compressed PLY: {element.count} rows of 'sh' for {count} Gaussians")
    return names


def _unpack(packed: UnsignedIds, *bits: int) -> FloatRows:
    """Return bit fields, the highest first, as fractions of their range."""
    result = np.empty((len(packed), len(bits)), np.float32)
    for column, width in enumerate(bits):
        field = packed >> np.uint32(sum(bits[column + 1 :])) & np.uint32((1 << width) - 1)
        np.divide(field, (1 << width) - 1, out=result[:, column], casting="unsafe")
    return result


def _within_chunks(fractions: Vectors, bounds: Float32[np.ndarray, "c 6"]) -> None:
    """Replace each fraction by the point it marks between the bounds of its row's chunk."""
    for start in range(0, len(bounds), BLOCK_CHUNKS):
        block = fractions[start * CHUNK_ROWS : (start + BLOCK_CHUNKS) * CHUNK_ROWS]
        of_rows = np.repeat(bounds[start : start + BLOCK_CHUNKS], CHUNK_ROWS, axis=0)[: len(block)]
        block[:] = of_rows[:, :3] * (1 - block) + of_rows[:, 3:] * block
