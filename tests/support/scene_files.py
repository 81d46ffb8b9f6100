"""Small scenes as bytes in each format, written without the package's own readers and writers."""

import gzip
import io
import json
import struct
import zipfile

import numpy as np
import zstandard
from PIL import Image

from drsplat.scene.gaussians import Gaussians
from twins.registering import sh_basis

C0 = 0.5 / np.sqrt(np.pi)
PLY_NAMES = {"f4": "float", "f8": "double", "u1": "uchar", "i4": "int", "u4": "uint", "i2": "short", "u2": "ushort"}


def random_gaussians(rng: np.random.Generator, n: int = 24, degree: int = 3) -> Gaussians:
    quats = rng.normal(size=(n, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    return Gaussians(
        rng.uniform(-3, 3, (n, 3)).astype(np.float32),
        quats.astype(np.float32),
        np.exp(rng.uniform(-6, -1, (n, 3))).astype(np.float32),
        rng.uniform(0.02, 0.98, n).astype(np.float32),
        rng.uniform(-0.9, 0.9, (n, (degree + 1) ** 2, 3)).astype(np.float32),
    )


def ply_columns(g: Gaussians) -> dict[str, np.ndarray]:
    """Pre-activation columns, spelled out coefficient by coefficient."""
    columns = {name: g.means[:, i] for i, name in enumerate("xyz")}
    k = g.sh.shape[1]
    for channel in range(3):
        columns[f"f_dc_{channel}"] = g.sh[:, 0, channel]
        for c in range(1, k):
            columns[f"f_rest_{channel * (k - 1) + c - 1}"] = g.sh[:, c, channel]
        columns[f"scale_{channel}"] = np.log(g.scales[:, channel])
    o = g.opacities.astype(np.float64)
    columns["opacity"] = np.log(o / (1 - o)).astype(np.float32)
    for i in range(4):
        columns[f"rot_{i}"] = g.quats[:, i] * np.float32(1.5)
    return columns


def commented(content: bytes, *comments: str) -> bytes:
    """A PLY with these comments in its header."""
    lines = "".join(f"comment {comment}\n" for comment in comments).encode()
    return content.replace(b"end_header\n", lines + b"end_header\n", 1)


def ply_bytes(columns: dict[str, np.ndarray], order: str = "<", before: bytes = b"", before_header: str = "") -> bytes:
    """PLY, binary ("<", ">") or ASCII ("a"), of the element vertex, behind others if given."""
    names = {"<": "binary_little_endian", ">": "binary_big_endian", "a": "ascii"}
    types = [(name, c.dtype.newbyteorder("<" if order == "a" else order)) for name, c in columns.items()]
    rows = np.rec.fromarrays(list(columns.values()), types)
    lines = [
        "ply",
        f"format {names[order]} 1.0",
        "comment made for a test",
        before_header,
        f"element vertex {len(rows)}",
    ]
    lines += [f"property {PLY_NAMES[c.dtype.str[1:]]} {name}" for name, c in columns.items()]
    head = "\n".join([line for line in lines if line] + ["end_header", ""]).encode() + before
    text = "".join(" ".join(map(repr, row)) + "\n" for row in rows.tolist())
    return head + (text.encode() if order == "a" else rows.tobytes())


def as_rows(*columns: np.ndarray) -> bytes:
    """Columns of any kinds of numbers, row by row."""
    return np.hstack([np.ascontiguousarray(column).view("u1") for column in columns]).tobytes()


def in_bytes(values: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(values), 0, 255).astype("u1")


def smallest_three(quats: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which number of each rotation is the largest, and the other three where that is positive."""
    largest = np.abs(quats).argmax(1)
    signed = quats * np.sign(np.take_along_axis(quats, largest[:, None], 1))
    return largest, signed[np.arange(4) != largest[:, None]].reshape(-1, 3).astype(np.float64)


def packed(unit: np.ndarray, *bits: int) -> np.ndarray:
    """Fractions in a word of each row, the first column in its highest bits."""
    words = np.zeros(len(unit), np.int64)
    for column, width in zip(unit.T.astype(np.float64), bits, strict=True):
        words = words << width | np.rint(column * (2**width - 1)).astype(np.int64)
    return words


def compressed_ply_bytes(g: Gaussians) -> bytes:
    """SuperSplat's layout."""
    chunks, vertices = [], []
    for start in range(0, len(g), 256):
        rows = slice(start, start + 256)
        values = g.means[rows], np.log(g.scales[rows]), g.sh[rows, 0] * C0 + 0.5
        bounds = [(v.min(0), v.max(0)) for v in values]
        chunks += [end for pair in bounds for end in pair]
        place, size, colour = (
            (v - low) / np.where(high > low, high - low, 1) for v, (low, high) in zip(values, bounds, strict=True)
        )
        largest, three = smallest_three(g.quats[rows])
        rotation = largest << 30 | packed(three / np.sqrt(2) + 0.5, 10, 10, 10)
        rgba = packed(np.column_stack([colour, g.opacities[rows]]), 8, 8, 8, 8)
        vertices.append(np.stack([packed(place, 11, 10, 11), rotation, packed(size, 11, 10, 11), rgba], 1))
    names = [f"{end}_{s}{a}" for s in ("", "scale_") for end in ("min", "max") for a in "xyz"]
    names += [f"{end}_{a}" for end in ("min", "max") for a in "rgb"]
    lines = ["ply", "format binary_little_endian 1.0", f"element chunk {-(-len(g) // 256)}"]
    lines += [f"property float {name}" for name in names] + [f"element vertex {len(g)}"]
    lines += [f"property uint packed_{what}" for what in ("position", "rotation", "scale", "color")]
    rest = g.sh[:, 1:].transpose(0, 2, 1).reshape(len(g), -1)
    if rest.size:
        lines += [f"element sh {len(g)}", *(f"property uchar f_rest_{i}" for i in range(rest.shape[1]))]
    sh = np.clip(np.trunc((rest / 8 + 0.5) * 256), 0, 255).astype("u1")
    head = "\n".join([*lines, "end_header", ""]).encode()
    return head + np.float32(chunks).tobytes() + np.concatenate(vertices).astype("<u4").tobytes() + sh.tobytes()


def colours_of(g: Gaussians) -> np.ndarray:
    """Red, green, blue and opacity in bytes."""
    return in_bytes(np.column_stack([g.sh[:, 0] * C0 + 0.5, g.opacities]) * 255)


def splat_bytes(g: Gaussians) -> bytes:
    return as_rows(g.means, g.scales, colours_of(g), in_bytes(g.quats * 128 + 128))


def ksplat_bytes(parts: list[Gaussians], level: int, bucket: int = 8) -> bytes:
    """A section for each part, rows in their order; of a part's last rows buckets of at most three."""
    further = [c for g in parts for c in g.sh[:, 1:].ravel().tolist()] or [0]
    head, bodies = bytearray(4096 + 1024 * len(parts)), []
    count = sum(map(len, parts))
    struct.pack_into("<4B4IH", head, 0, 0, 1, 0, 0, len(parts), len(parts), count, count, level)
    struct.pack_into("<5f", head, 24, 7, 8, 9, min(further), max(further))
    for i, g in enumerate(parts):
        at, n, number = 4096 + 1024 * i, len(g), "<f2" if level else "<f4"
        struct.pack_into("<2I", head, at, n, n)
        struct.pack_into("<H", head, at + 40, g.sh_degree)
        degrees = [g.sh[:, a * a : (a + 1) ** 2].transpose(0, 2, 1).reshape(n, -1) for a in range(1, g.sh_degree + 1)]
        rest = np.hstack([np.empty((n, 0)), *degrees])
        if level == 2:
            coded = in_bytes((rest - min(further)) / (max(further) - min(further)) * 255)
        else:
            coded = rest.astype(number)
        shape = g.scales.astype(number), g.quats.astype(number), colours_of(g), coded
        if not level:
            bodies.append(as_rows(g.means, *shape))
            continue
        full = n // bucket
        last = [min(3, n - k) for k in range(full * bucket, n, 3)]
        owner = np.repeat(np.arange(full + len(last)), [bucket] * full + last)
        centres = np.array([g.means[owner == k].mean(0) for k in range(full + len(last))], "<f4").reshape(-1, 3)
        offsets = g.means.astype(float) - centres[owner]
        side = 2 * float(np.abs(offsets).max(initial=1e-3))
        places = np.rint(offsets / (side / 2) * 32767 + 32767).astype("<u2")
        bodies.append(np.array(last, "<u4").tobytes() + centres.tobytes() + as_rows(places, *shape))
        struct.pack_into("<2IfH", head, at + 8, bucket, full + len(last), side, 12)
        struct.pack_into("<4I", head, at + 24, 32767, len(bodies[-1]), full, len(last))
    return bytes(head) + b"".join(bodies)


def spz_planes(g: Gaussians, version: int) -> list[bytes]:
    """Attribute planes of Gaussians whose axes are RUB already."""
    fixed = np.rint(g.means.astype(np.float64) * 4096).astype("<i4")
    positions = fixed.reshape(-1, 1).view("u1")[:, :3]  # 24 bits
    if version == 2:
        signed = g.quats * np.where(g.quats[:, :1] >= 0, 1, -1)
        rotations = in_bytes(signed[:, 1:].astype(np.float64) * 127.5 + 127.5)
    else:
        rotations, three = smallest_three(np.roll(g.quats, -1, axis=1))
        for column in three.T:
            magnitude = np.rint(np.abs(column) * np.sqrt(2) * 511).astype(int)
            rotations = rotations << 10 | (column < 0) << 9 | magnitude
        rotations = rotations.astype("<u4")
    levels = g.opacities * 255, g.sh[:, 0] * 0.15 * 255 + 127.5, (np.log(g.scales) + 10) * 16
    rest = in_bytes(g.sh[:, 1:] * 128 + 128)
    return [plane.tobytes() for plane in (positions, *map(in_bytes, levels), rotations, rest)]


def spz_bytes(g: Gaussians, version: int, flags: int = 0, extensions: bytes = b"") -> bytes:
    planes = spz_planes(g, version)
    head = struct.pack("<4sIIBBB", b"NGSP", version, len(g), g.sh_degree, 12, flags)
    if version < 4:
        return gzip.compress(head + b"\0" + b"".join(planes) + extensions, mtime=0)
    return head + v4_body([p for p in planes if p], extensions)


def v4_body(planes: list[bytes], extensions: bytes = b"") -> bytes:
    """All of a version 4 file behind its flags: stream count, offset, extensions, streams."""
    streams = [zstandard.ZstdCompressor().compress(p) for p in planes]
    contents = b"".join(struct.pack("<QQ", len(s), len(p)) for s, p in zip(streams, planes, strict=True))
    head = struct.pack("<BI12x", len(planes), 32 + len(extensions))
    return head + extensions + contents + b"".join(streams)


def turned(g: Gaussians, signs: tuple[int, int, int] = (1, -1, -1)) -> Gaussians:
    """The scene in axes of other signs: positions, rotations and SH as the geometry demands.

    The SH signs are not from a table: they are those of each basis function under the flip.
    """
    s = np.array(signs, np.float32)
    directions = np.random.default_rng(0).normal(size=(64, 3))
    ratio = sh_basis(directions * s) / sh_basis(directions)
    flips = np.median(ratio, axis=0)[: g.sh.shape[1], None].astype(np.float32)
    turn = np.array([1, s[1] * s[2], s[0] * s[2], s[0] * s[1]], np.float32)
    return Gaussians(g.means * s, g.quats * turn, g.scales, g.opacities, g.sh * flips, g.extra)


def webp_bytes(pixels: np.ndarray, lossless: bool = True) -> bytes:
    out = io.BytesIO()
    Image.fromarray(pixels.astype(np.uint8), "RGBA").save(out, "WEBP", lossless=lossless, exact=True)
    return out.getvalue()


def sog_plane(rows: np.ndarray, width: int = 8) -> bytes:
    """Rows of up to four bytes as pixels, row by row; what is left over is 255."""
    height = -(-max(len(rows), 1) // width) + 1
    pixels = np.full((height * width, 4), 255)
    pixels[: len(rows), : rows.shape[1]] = rows
    return webp_bytes(pixels.reshape(height, width, 4))


def sog_files(g: Gaussians, version: int = 2) -> dict[str, bytes]:
    """An unpacked SOG, from its specification; scales, colours and harmonics to 256 steps."""
    n, coefficients = len(g), g.sh.shape[1] - 1
    logs = np.sign(g.means) * np.log1p(np.abs(g.means.astype(np.float64)))
    low, high = logs.min(0), logs.max(0)
    steps = np.rint((logs - low) / np.where(high > low, high - low, 1) * 65535).astype(int)
    largest, three = smallest_three(g.quats)
    linear = {"scales": np.log(g.scales), "sh0": g.sh[:, 0], "shN": g.sh[:, 1:]}
    linear["opacity"] = np.log(g.opacities / (1 - g.opacities))
    ends = {name: (float(v.min(initial=9)), float(v.max(initial=-9))) for name, v in linear.items()}
    codes = {k: np.rint((v - ends[k][0]) / (ends[k][1] - ends[k][0]) * 255) for k, v in linear.items()}
    opacity = codes["opacity"] if version == 1 else np.rint(g.opacities * 255)
    planes = {
        "means_l": steps & 255,
        "means_u": steps >> 8,
        "quats": np.column_stack([np.rint((three * 2**0.5 + 1) * 127.5), 252 + largest]),
        "scales": codes["scales"],
        "sh0": np.column_stack([codes["sh0"], opacity]),
    }

    def coded(name: str, *channels: str) -> dict[str, object]:
        if version == 2:
            return {"codebook": np.linspace(*ends[name], 256).tolist()}
        spread = [[ends[one][k] for one in channels] if channels else ends[name][k] for k in (0, 1)]
        return dict(zip(("mins", "maxs"), spread, strict=True))

    meta: dict[str, object] = {"version": 2, "count": n} if version == 2 else {}
    meta |= {
        "means": {"shape": [n, 3], "mins": low.tolist(), "maxs": high.tolist()},
        "scales": coded("scales", "scales", "scales", "scales"),
        "quats": {},
        "sh0": coded("sh0", "sh0", "sh0", "sh0", "opacity"),
    }
    files = {}
    if coefficients:  # a palette in which every Gaussian has its own entry, in reverse
        palette = np.full((-(-n // 64) * 64, coefficients, 4), 255)
        palette[:n, :, :3] = codes["shN"][::-1]
        files["shN_centroids.webp"] = webp_bytes(palette.reshape(-1, 64 * coefficients, 4))
        labels = np.arange(n)[::-1]
        planes["shN_labels"] = np.column_stack([labels & 255, labels >> 8])
        counts = {"count": n, "bands": g.sh_degree} if version == 2 else {}
        meta["shN"] = coded("shN") | counts
    files |= {f"{name}.webp": sog_plane(plane) for name, plane in planes.items()}
    for name, described in meta.items():
        if isinstance(described, dict):
            described["files"] = sorted(file for file in files if file.startswith(name))
    return {"meta.json": json.dumps(meta).encode(), **files}


def zip_bytes(files: dict[str, bytes]) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return out.getvalue()
