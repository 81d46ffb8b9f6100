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
    n = len(next(iter(columns.values())))
    names = {"<": "binary_little_endian", ">": "binary_big_endian", "a": "ascii"}
    lines = ["ply", f"format {names[order]} 1.0", "comment made for a test", *before_header.split("\n")]
    lines += [f"element vertex {n}"]
    lines += [f"property {PLY_NAMES[c.dtype.str[1:]]} {name}" for name, c in columns.items()]
    head = "\n".join([line for line in lines if line] + ["end_header", ""]).encode() + before
    if order == "a":
        rows = zip(*(c.tolist() for c in columns.values()), strict=True)
        return head + "".join(" ".join(map(repr, row)) + "\n" for row in rows).encode()
    row_format = order + "".join(c.dtype.char for c in columns.values())
    rows = zip(*(c.tolist() for c in columns.values()), strict=True)
    return head + b"".join(struct.pack(row_format, *row) for row in rows)


def compressed_ply_bytes(g: Gaussians) -> bytes:
    """SuperSplat's layout, one Gaussian at a time."""
    log_scales, colours = np.log(g.scales), g.sh[:, 0] * C0 + 0.5
    chunks, vertices = io.BytesIO(), io.BytesIO()
    for start in range(0, len(g), 256):
        rows = slice(start, start + 256)
        bounds = [(v[rows].min(0), v[rows].max(0)) for v in (g.means, log_scales, colours)]
        chunks.write(np.concatenate([end for pair in bounds for end in pair]).astype("<f4").tobytes())
        for i in range(*rows.indices(len(g))):
            unit = [
                (v[i] - low) / np.where(high > low, high - low, 1)
                for v, (low, high) in zip((g.means, log_scales, colours), bounds, strict=True)
            ]
            words = (_pack(unit[0], (11, 10, 11)), _pack_rotation(g.quats[i]), _pack(unit[1], (11, 10, 11)))
            rgba = _pack((*unit[2], g.opacities[i]), (8, 8, 8, 8))
            vertices.write(struct.pack("<4I", *words, rgba))
    axes, k = ("x", "y", "z"), g.sh.shape[1]
    chunk_names = [f"{end}_{s}{a}" for s in ("", "scale_") for end in ("min", "max") for a in axes]
    chunk_names += [f"{end}_{a}" for end in ("min", "max") for a in "rgb"]
    lines = ["ply", "format binary_little_endian 1.0", f"element chunk {-(-len(g) // 256)}"]
    lines += [f"property float {name}" for name in chunk_names] + [f"element vertex {len(g)}"]
    lines += [f"property uint packed_{what}" for what in ("position", "rotation", "scale", "color")]
    rest = g.sh[:, 1:].transpose(0, 2, 1).reshape(len(g), -1)
    if k > 1:
        lines += [f"element sh {len(g)}", *(f"property uchar f_rest_{i}" for i in range(3 * (k - 1)))]
    sh = np.clip(np.trunc((rest / 8 + 0.5) * 256), 0, 255).astype(np.uint8)
    head = "\n".join([*lines, "end_header", ""]).encode()
    return head + chunks.getvalue() + vertices.getvalue() + sh.tobytes()


def _pack(unit: np.ndarray | tuple, bits: tuple[int, ...]) -> int:
    word = 0
    for value, width in zip(unit, bits, strict=True):
        word = word << width | round(float(value) * (2**width - 1))
    return word


def _pack_rotation(quat: np.ndarray) -> int:
    largest = int(np.abs(quat).argmax())
    signed = quat * np.sign(quat[largest])
    return largest << 30 | _pack(np.delete(signed, largest) / np.sqrt(2) + 0.5, (10, 10, 10))


def splat_bytes(g: Gaussians) -> bytes:
    colour = np.clip(np.column_stack([g.sh[:, 0] * C0 + 0.5, g.opacities]) * 255, 0, 255).round()
    quats = np.clip(g.quats * 128 + 128, 0, 255).round()
    return b"".join(
        struct.pack("<6f4B4B", *g.means[i], *g.scales[i], *map(int, colour[i]), *map(int, quats[i]))
        for i in range(len(g))
    )


def ksplat_bytes(parts: list[Gaussians], level: int, bucket: int = 8) -> bytes:
    """A section for each part, rows in their order; of a part's last rows buckets of at most three."""
    further = [c for g in parts for c in g.sh[:, 1:].ravel().tolist()] or [0]
    bounds = min(further), max(further)
    head = bytearray(4096 + 1024 * len(parts))
    count = sum(map(len, parts))
    struct.pack_into("<4B4IH", head, 0, 0, 1, 0, 0, len(parts), len(parts), count, count, level)
    struct.pack_into("<5f", head, 24, 7, 8, 9, *bounds)
    bodies = []
    for i, g in enumerate(parts):
        full = len(g) // bucket if level else 0
        rest = [min(3, len(g) - k) for k in range(full * bucket, len(g), 3)] if level else []
        sizes = [bucket] * full + rest
        starts = np.cumsum([0, *sizes])[:-1]
        centres = [g.means[a : a + k].mean(0).astype("<f4") for a, k in zip(starts, sizes, strict=True)]
        of_row = [centre for centre, k in zip(centres, sizes, strict=True) for _ in range(k)]
        offsets = g.means - np.array(of_row).reshape(-1, 3) if level else np.zeros((1, 3))
        side = 2 * float(np.abs(offsets).max(initial=1e-3))
        rows = [_ksplat_row(g, j, level, (of_row[j], side) if level else None, bounds) for j in range(len(g))]
        body = b"".join(struct.pack("<I", k) for k in rest) + b"".join(c.tobytes() for c in centres)
        bodies.append(body + b"".join(rows))
        at = 4096 + 1024 * i
        struct.pack_into("<2I", head, at, len(g), len(g))
        struct.pack_into("<H", head, at + 40, g.sh_degree)
        if level:
            struct.pack_into("<2IfH", head, at + 8, bucket, len(sizes), side, 12)
            struct.pack_into("<4I", head, at + 24, 32767, len(bodies[-1]), full, len(rest))
    return bytes(head) + b"".join(bodies)


def _ksplat_row(
    g: Gaussians, i: int, level: int, place: tuple[np.ndarray, float] | None, bounds: tuple[float, float]
) -> bytes:
    number = "e" if level else "f"
    if place is None:
        where = struct.pack("<3f", *g.means[i])
    else:
        centre, side = place
        steps = (g.means[i].astype(np.float64) - centre) / (side / 2) * 32767
        where = struct.pack("<3H", *(round(float(s)) + 32767 for s in steps))
    shape = struct.pack(f"<7{number}", *g.scales[i], *g.quats[i])
    colour = np.clip(np.append(g.sh[i, 0] * C0 + 0.5, g.opacities[i]) * 255, 0, 255).round()
    ends = [(a * a, (a + 1) * (a + 1)) for a in range(1, g.sh_degree + 1)]
    rest = [float(g.sh[i, k, rgb]) for a, b in ends for rgb in range(3) for k in range(a, b)]
    if level == 2:
        low, high = bounds
        coded = bytes(round((c - low) / (high - low) * 255) for c in rest)
    else:
        coded = struct.pack(f"<{len(rest)}{number}", *rest)
    return where + shape + bytes(map(int, colour)) + coded


def spz_planes(g: Gaussians, version: int) -> list[bytes]:
    """Attribute planes of Gaussians whose axes are RUB already."""
    fixed = (g.means.astype(np.float64) * 4096).round().astype(int).ravel().tolist()
    positions = b"".join(value.to_bytes(3, "little", signed=True) for value in fixed)
    planes = [g.opacities * 255, g.sh[:, 0] * 0.15 * 255 + 127.5, (np.log(g.scales) + 10) * 16]
    coded = [np.clip(p.round(), 0, 255).astype(np.uint8).tobytes() for p in planes]
    rotation = _first_three if version == 2 else _smallest_three
    rest = np.clip((g.sh[:, 1:] * 128 + 128).round(), 0, 255).astype(np.uint8).tobytes()
    return [positions, *coded, b"".join(rotation(q) for q in g.quats), rest]


def _first_three(quat: np.ndarray) -> bytes:
    _, *xyz = quat * (1 if quat[0] >= 0 else -1)
    return bytes(round(float(c) * 127.5 + 127.5) for c in xyz)


def _smallest_three(quat: np.ndarray) -> bytes:
    xyzw = np.roll(quat, -1)
    largest = int(np.abs(xyzw).argmax())
    xyzw = xyzw * np.sign(xyzw[largest])
    word = largest
    for i in range(4):
        if i != largest:
            magnitude = round(abs(float(xyzw[i])) * np.sqrt(2) * 511)
            word = word << 10 | int(xyzw[i] < 0) << 9 | magnitude
    return struct.pack("<I", word)


def spz_bytes(g: Gaussians, version: int, flags: int = 0, extensions: bytes = b"") -> bytes:
    degree = g.sh_degree
    planes = spz_planes(g, version)
    head = struct.pack("<4sIIBBB", b"NGSP", version, len(g), degree, 12, flags)
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
    largest = np.abs(g.quats).argmax(1)
    signs = np.sign(g.quats[np.arange(n), largest])[:, None]
    others = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])[largest]
    three = np.take_along_axis(g.quats * signs, others, 1)
    turned = np.rint((three * 2**0.5 + 1) * 127.5)
    linear = {
        "scales": np.log(g.scales),
        "sh0": g.sh[:, 0],
        "shN": g.sh[:, 1:],
        "opacity": np.log(g.opacities / (1 - g.opacities)),
    }
    ends = {name: (v.min(initial=9), v.max(initial=-9)) for name, v in linear.items()}
    codes = {k: np.rint((v - ends[k][0]) / (ends[k][1] - ends[k][0]) * 255) for k, v in linear.items()}
    opacity = codes["opacity"] if version == 1 else np.rint(g.opacities * 255)
    files = {
        "means_l.webp": sog_plane(steps & 255),
        "means_u.webp": sog_plane(steps >> 8),
        "quats.webp": sog_plane(np.column_stack([turned, 252 + largest])),
        "scales.webp": sog_plane(codes["scales"]),
        "sh0.webp": sog_plane(np.column_stack([codes["sh0"], opacity])),
    }

    def coded(name: str, size: int) -> dict[str, object]:
        a, b = (float(end) for end in ends[name])
        if version == 2:
            return {"codebook": [a + (b - a) * k / 255 for k in range(256)]}
        last = [float(end) for end in ends["opacity"]] if size == 4 else ()
        spread = [[end] * min(size, 3) + list(last[k : k + 1]) for k, end in enumerate((a, b))]
        return dict(zip(("mins", "maxs"), (spread if size else (a, b)), strict=True))

    meta: dict[str, object] = {
        "means": {
            "shape": [n, 3],
            "mins": low.tolist(),
            "maxs": high.tolist(),
            "files": ["means_l.webp", "means_u.webp"],
        },
        "scales": {**coded("scales", 3), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {**coded("sh0", 4), "files": ["sh0.webp"]},
    }
    if version == 2:
        meta |= {"version": 2, "count": n}
    if coefficients:  # a palette in which every Gaussian has its own entry, in reverse
        rows = -(-n // 64)
        palette = np.zeros((rows, 64 * coefficients, 4))
        palette[..., 3] = 255
        for i in range(n):
            row, column = divmod(n - 1 - i, 64)
            for c in range(coefficients):
                palette[row, column * coefficients + c, :3] = codes["shN"][i, c]
        labels = np.arange(n)[::-1]
        files["shN_centroids.webp"] = webp_bytes(palette)
        files["shN_labels.webp"] = sog_plane(np.column_stack([labels & 255, labels >> 8]))
        bands = {3: 1, 8: 2, 15: 3}[coefficients]
        meta["shN"] = {
            **coded("shN", 0),
            "files": ["shN_centroids.webp", "shN_labels.webp"],
            **({"count": n, "bands": bands} if version == 2 else {}),
        }
    return {"meta.json": json.dumps(meta).encode(), **files}


def zip_bytes(files: dict[str, bytes]) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return out.getvalue()
