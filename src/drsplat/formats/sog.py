"""PlayCanvas' SOG (SuperSplat's WebP format), versions 1 and 2: planes of bytes as lossless WebP pictures.

Pixel i, row by row, is Gaussian i. means_l and means_u are the low and high bytes of 16-bit steps between mins
and maxs of sign(x) ln(1 + |x|). quats holds three components of [-1, 1] / sqrt 2 and, as 252 + its index
(w, x, y, z), the largest. Version 2 looks up the logarithms of scales, the colours and the further harmonics in
codebooks of 256; its alpha is the opacity. Version 1, which states no version, has steps of 255 between
mins and maxs instead, and the logit of the opacity. Harmonics beyond the first are those of a palette: 64
entries a row, a pixel for each coefficient (of the three channels); labels are 16 bits in red and green. A `model`
"antialiased" says how opacities are drawn, "2dgs" that Gaussians are surfels. What drsplat writes beside, objects and
relevancy, comes back in `extra`.

Axes are those of the PLY that it was made from, as splat-transform reads and writes it.

Source: developer.playcanvas.com, "The SOG Format"; splat-transform's readers for version 1.

The files of a SOG: a folder beside its meta.json, or a ZIP of them; and what a lossless WebP says of its size.

Nothing is unfolded before its size is known and plausible: names are bare, an archive has few members, none
of them is larger than the archive (WebP does not shrink any more), and a picture is decoded once its header
has the size that was asked for.

Source: PKWARE APPNOTE.TXT 6.3 (ZIP); RFC 9649 (WebP).
"""

import io
import struct
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from ..base.arrays import Array, Arrays, Float32, FloatRows, Harmonics, Quats, UInt8, Vector3
from ..base.contents import file_bytes, open_file
from ..errors import FormatError
from ..scene.gaussians import Gaussians, flat
from .activation import checked, exp, from_smallest_three, sigmoid
from .json_files import as_count, as_kind, as_number, as_object, as_vector, document_in, excerpt
from .labels import Labels, parse_labels
from .spz import refuse_implausible

META = "meta.json"
MAX_META_BYTES = 1 << 20
MAX_MEMBERS = 64
MAX_DIRECTORY_BYTES = 1 << 16
ZIP_MAGIC = b"PK\x03\x04"
_END = struct.Struct("<4s4H2IH")  # of the central directory
_MAX_COMMENT_BYTES = 1 << 16

Member = Callable[[str], bytes]
"""The bytes of a file by its name."""


def folder_member(folder: Path) -> Member:
    """Return a reader of the files beside meta.json. It raises FormatError: a name that leads elsewhere."""

    def read(name: str) -> bytes:
        path = folder / _bare(name)
        if not path.is_file():
            raise FormatError(f"{folder}: there is no file '{name}', which {META} names")
        limit = MAX_META_BYTES if name == META else path.stat().st_size
        with open_file(path) as file:
            content = file.read(limit + 1)
        if len(content) > limit:
            raise FormatError(f"{path}: more than {limit} bytes")
        return content

    return read


def beside(document: Path, name: object) -> Path:
    """Return the path of a file that a document names relative to its own folder.

    Raises: FormatError: the name leads out of the folder, or is none.
    """
    path = (
        PurePosixPath(name) if isinstance(name, str) and "\\" not in name and "\0" not in name else PurePosixPath("/")
    )
    if path.is_absolute() or ".." in path.parts or not path.name:
        raise FormatError(f"{document}: expected the path of a file in this folder, got {excerpt(name)}")
    return document.parent / path


def zip_member(buffer: memoryview) -> Member:
    """Return the members at the root of a ZIP.

    Raises: FormatError, also when called: a damaged archive, too many members or two of one name; one
    that is missing, encrypted or larger than the archive.
    """
    _refuse_large_directory(buffer)
    import zipfile

    try:
        archive = zipfile.ZipFile(io.BytesIO(buffer))
        found = archive.infolist()
    except Exception as error:  # of damaged archives it raises anything
        raise FormatError(f"SOG archive is damaged: {error}") from None
    members = {info.filename: info for info in found}
    if len(found) > MAX_MEMBERS or len(members) < len(found):
        raise FormatError(
            f"SOG archive of {len(found)} members with {len(members)} names: expected at most "
            f"{MAX_MEMBERS}, each with its own"
        )

    def read(name: str) -> bytes:
        info = members.get(_bare(name))
        if info is None:
            raise FormatError(f"SOG archive has no '{name}' at its root")
        limit = MAX_META_BYTES if name == META else len(buffer)
        try:
            with archive.open(info) as file:
                content = file.read(limit + 1)
        except Exception as error:  # as above
            raise FormatError(f"SOG archive is damaged at '{name}': {error}") from None
        if len(content) > limit:
            raise FormatError(f"'{name}' unfolds to more than {limit} bytes: a decompression bomb")
        return content

    return read


def _bare(name: str) -> str:
    if set(name) & set("/\\:\0") or name in ("", ".", ".."):
        raise FormatError(f"expected the name of a file beside {META}, got {excerpt(name)}")
    return name


def _refuse_large_directory(buffer: memoryview) -> None:
    """Refuse a directory whose entries, which are all read at once, have too many bytes."""
    tail = bytes(buffer[-(_END.size + _MAX_COMMENT_BYTES) :])
    at = tail.rfind(b"PK\x05\x06")
    if at < 0 or at + _END.size > len(tail):
        raise FormatError("SOG archive is truncated: a ZIP ends with its directory")
    _, _, _, _, count, size, start, _ = _END.unpack_from(tail, at)
    if count > MAX_MEMBERS or size > MAX_DIRECTORY_BYTES or start + size > len(buffer):
        raise FormatError(
            f"SOG archive claims {count} members in a directory of {size} bytes at {start}: expected "
            f"at most {MAX_MEMBERS} in {MAX_DIRECTORY_BYTES}, within its {len(buffer)} bytes"
        )


def webp_size(data: bytes, name: str) -> tuple[int, int]:
    """Return the width and height that a lossless WebP declares.

    Raises: FormatError: no WebP; a lossy or animated one, whose numbers are not what was stored.
    """
    if data[:4] != b"RIFF" or data[8:12] != b"WEBP":
        raise FormatError(f"'{name}' is no WebP: it begins with {data[:12]!r}")
    at, canvas = 12, None
    while at + 18 <= len(data):
        kind, size = data[at : at + 4], struct.unpack_from("<I", data, at + 4)[0]
        body = at + 8
        if kind == b"VP8X":
            canvas = tuple(int.from_bytes(data[body + k : body + k + 3], "little") + 1 for k in (4, 7))
        elif kind == b"VP8L" and data[body] == 0x2F:
            bits = struct.unpack_from("<I", data, body + 1)[0]
            width, height = (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
            if canvas not in (None, (width, height)):
                raise FormatError(f"'{name}' is {width}x{height} pixels on a canvas of {canvas}")
            return width, height
        elif kind in (b"VP8 ", b"ANIM", b"ANMF", b"VP8L"):
            raise FormatError(
                f"'{name}' is no lossless WebP of one picture: its values are not those that were "
                "stored; export the scene again"
            )
        at = body + size + size % 2
    raise FormatError(f"'{name}' is a WebP without a picture")


def webp_pixels(data: bytes, name: str) -> UInt8[Array, "h w 4"]:
    """Return RGBA as stored; only once `webp_size` has been judged.

    Raises: FormatError: it cannot be decoded, or is not of the size that it declares.
    """
    from PIL import Image

    size = webp_size(data, name)
    try:
        with Image.open(io.BytesIO(data), formats=("WEBP",)) as picture:
            same = picture.size == size and getattr(picture, "n_frames", 1) == 1
            pixels = np.asarray(picture.convert("RGBA")) if same else None
    except Exception as error:  # decoders of damaged files raise anything
        raise FormatError(f"'{name}' cannot be decoded: {error}") from None
    if pixels is None:
        raise FormatError(f"'{name}' is not the one picture of {size} that it declares")
    return pixels


REST_COEFFICIENTS = (0, 3, 8, 15)  # of each channel without the constant one, by degree
PALETTE_ROW_ENTRIES = 64
MAX_PALETTE_ENTRIES = 1 << 16
MAX_SPARE_ROWS = 8  # writers round both sides of a picture up to fours
_FIRST_TAG = 252
ANTIALIASED, SURFELS = "antialiased", "2dgs"  # the `model` of meta.json
OWN = "drsplat"  # key of meta.json: what drsplat writes beside, see `sog_writing`
Bytes = UInt8[np.ndarray, "n 4"]


def read_unpacked_sog(meta: Path) -> Gaussians:
    """Read a SOG whose files lie beside its meta.json. Raises: FormatError: as `parse_sog`."""
    return _Sog(folder_member(meta.parent)).gaussians()


def parse_sog(buffer: memoryview) -> Gaussians:
    """Read a bundled SOG (.sog), a ZIP.

    Raises: FormatError: a damaged archive, file or picture; counts that the pictures cannot hold, or
    pictures that are far larger than the count; a version that is not known; rows that are no Gaussians.
    """
    return _Sog(zip_member(buffer)).gaussians()


def read_sog_labels(path: Path) -> Labels:
    """Return the names and boxes of a SOG's objects: of its file, or of its meta.json.

    Raises: FormatError: a damaged archive, or labels that are none.
    """
    if path.name == META:
        return _Sog(folder_member(path.parent)).labels()
    return _Sog(zip_member(file_bytes(path).data)).labels()


class _Sog:
    def __init__(self, member: Member) -> None:
        self.member = member
        found = document_in(member(META), META)
        if not is_sog_meta(found):
            raise FormatError(f"{META}: expected that of a SOG, with means, scales, quats and sh0")
        self.meta = as_object(found, META)
        self.own = _part(self.meta, OWN) if OWN in self.meta else {}
        version = self.meta.get("version")
        if version not in (None, 2) or isinstance(version, bool):
            raise FormatError(f"SOG version {excerpt(version)}; 1 and 2 can be read: export it again")
        if version is None:
            shape = _part(self.meta, "means").get("shape")
            count = shape[0] if isinstance(shape, list) and shape else None
        else:
            count = self.meta.get("count")
        self.legacy, self.count = version is None, as_count(count, f"{META}: count")
        if self.count < 0:
            raise FormatError(f"{META}: expected a count of Gaussians, got {self.count}")

    def gaussians(self) -> Gaussians:
        low, high = (self._plane("means", place)[:, :3].astype(np.uint16) for place in (0, 1))
        logs = self._between("means", low | high << 8, 65535).astype(np.float64)
        means = (np.sign(logs) * np.expm1(np.abs(logs))).astype(np.float32)
        quats = self._quats()
        scales = exp(self._values("scales", self._plane("scales")[:, :3]))
        colours, model = self._plane("sh0"), self.meta.get("model")
        scales = flat(scales[:, :2]) if model == SURFELS else scales
        if self.legacy:
            values = self._between("sh0", colours, 255)
            sh, opacities = values[:, None, :3], sigmoid(values[:, 3])
        else:
            sh, opacities = self._values("sh0", colours[:, None, :3]), colours[:, 3] / np.float32(255)
        if "shN" in self.meta:
            sh = np.concatenate([sh, self._further()], axis=1)
        gaussians = checked(means, quats, scales, opacities, sh, self._columns(), model == ANTIALIASED)
        origin = as_kind(self.own.get("origin"), Vector3 | None, f"{META}: origin")
        return gaussians if origin is None else replace(gaussians, origin=origin)

    def _columns(self) -> Arrays:
        """Return the object of each Gaussian, -1 for none, and its relevancy, as far as they are there."""
        own = self.own
        columns: Arrays = {}
        if "object_id" in own:
            low, middle, high = self._plane("object_id", meta=own)[:, :3].T.astype(np.int32)
            columns["object_id"] = (low | middle << 8 | high << 16) - 1
        if "relevancy" in own:
            low, high = self._plane("relevancy", meta=own)[:, :2].T.astype(np.uint16)
            least, most = (as_number(own["relevancy"].get(end), f"{META}: relevancy: {end}") for end in ("min", "max"))
            columns["relevancy"] = (least + (most - least) * ((low | high << 8) / 65535)).astype(np.float32)
        return columns

    def labels(self) -> Labels:
        """Return the names and boxes of objects that drsplat wrote beside; none in files of other programs."""
        name = as_kind(self.own.get("labels"), str | None, f"{META}: {OWN}: labels")
        return Labels() if name is None else parse_labels(self.member(name), name)

    def _plane(self, part: str, place: int = 0, meta: Mapping[str, Any] | None = None) -> Bytes:
        """Return the pixels of the Gaussians, from a picture that holds them and hardly more."""
        name = _file(self.meta if meta is None else meta, part, place)
        data = self.member(name)
        width, height = webp_size(data, name)
        needed = -(-self.count // width) * width
        if not self.count <= width * height <= needed + MAX_SPARE_ROWS * width:
            raise FormatError(f"'{name}' is {width}x{height} pixels for {self.count} Gaussians")
        # The low bytes of positions are noise in any scene; other planes may well be all of one colour.
        noise = len(self.member(_file(self.meta, "means", 0)))
        refuse_implausible(4 * width * height, max(noise, len(data)))
        return webp_pixels(data, name).reshape(-1, 4)[: self.count]

    def _between(self, part: str, steps: Array, most: int) -> FloatRows:
        """Return `most` steps from mins to maxs."""
        mins, maxs = (
            as_vector(_part(self.meta, part).get(end), steps.shape[1], f"{META}: {part}: {end}")
            for end in ("mins", "maxs")
        )
        values: Array = mins + (maxs - mins) * (steps / most)
        return values.astype(np.float32)

    def _values(self, part: str, codes: Array) -> Float32[Array, "*n"]:
        """Look values up in a codebook; those of version 1 are steps."""
        if self.legacy:
            return self._between(part, codes, 255)
        book = as_vector(_part(self.meta, part).get("codebook"), 256, f"{META}: {part}: codebook")
        return book.astype(np.float32)[codes]

    def _quats(self) -> Quats:
        plane = self._plane("quats")
        bad = np.flatnonzero(plane[:, 3] < _FIRST_TAG)
        if len(bad):
            raise FormatError(
                f"{len(bad)} of {self.count} rows have rotations without their largest component; the "
                f"first is row {bad[0]}"
            )
        three = (plane[:, :3] / np.float32(127.5) - 1) * np.float32(0.5**0.5)
        return from_smallest_three(three.astype(np.float32), plane[:, 3] - np.uint8(_FIRST_TAG))

    def _further(self) -> Harmonics:
        name = _file(self.meta, "shN", 0)
        data = self.member(name)
        width, height = webp_size(data, name)
        size, coefficients = self._palette_shape(width, height)
        if (
            width != PALETTE_ROW_ENTRIES * coefficients
            or not size <= PALETTE_ROW_ENTRIES * height <= MAX_PALETTE_ENTRIES
        ):
            raise FormatError(f"'{name}' is {width}x{height} pixels for a palette of {size}")
        pixels = webp_pixels(data, name)[..., :3].reshape(-1, coefficients, 3)[:size]
        if self.legacy:
            part = _part(self.meta, "shN")
            low, high = (as_number(part.get(end), f"{META}: shN: {end}") for end in ("mins", "maxs"))
            palette = (low + (high - low) * (pixels / np.float64(255))).astype(np.float32)
        else:
            palette = self._values("shN", pixels)
        labels = self._plane("shN", 1)[:, :2].astype(np.uint16)
        chosen = labels[:, 0] | labels[:, 1] << 8
        if self.count and chosen.max() >= size:
            raise FormatError(f"row {int(chosen.argmax())} names entry {chosen.max()} of a palette of {size}")
        return palette[chosen]

    def _palette_shape(self, width: int, height: int) -> tuple[int, int]:
        """Return the entries and coefficients of each; version 1 says neither but by the picture's size."""
        if self.legacy:
            coefficients = width // PALETTE_ROW_ENTRIES
            return PALETTE_ROW_ENTRIES * height, coefficients if coefficients in REST_COEFFICIENTS[1:] else 0
        part = _part(self.meta, "shN")
        bands = as_count(part.get("bands"), f"{META}: shN: bands")
        if not 1 <= bands <= 3:
            raise FormatError(f"{META}: shN: expected 1 to 3 bands, got {excerpt(bands)}")
        size = as_count(part.get("count"), f"{META}: shN: count")
        if not 1 <= size <= MAX_PALETTE_ENTRIES:
            raise FormatError(f"{META}: shN: expected 1 to {MAX_PALETTE_ENTRIES} entries, got {size}")
        return size, REST_COEFFICIENTS[bands]


def is_sog_meta(document: object) -> bool:
    """Return True if this is what a SOG's meta.json holds."""
    return isinstance(document, dict) and all(
        isinstance(document.get(part), dict) for part in ("means", "scales", "quats", "sh0")
    )


def _part(meta: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    return as_object(meta.get(name), f"{META}: {name}")


def _file(meta: Mapping[str, Any], part: str, place: int) -> str:
    files = as_kind(_part(meta, part).get("files"), list[str], f"{META}: {part}: files")
    if place >= len(files):
        raise FormatError(f"{META}: {part}: expected {place + 1} files, got {len(files)}")
    return str(files[place])
