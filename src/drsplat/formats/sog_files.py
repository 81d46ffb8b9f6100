"""The files of a SOG: a folder beside its meta.json, or a ZIP of them; and what a lossless WebP says of its size.

Nothing is unfolded before its size is known and plausible: names are bare, an archive has few members, none
of them is larger than the archive (WebP does not shrink any more), and a picture is decoded once its header
has the size that was asked for.

Source: PKWARE APPNOTE.TXT 6.3 (ZIP); RFC 9649 (WebP).
"""

import io
import struct
from collections.abc import Callable
from pathlib import Path, PurePosixPath

import numpy as np

from ..base.arrays import UInt8
from ..base.contents import open_file
from ..errors import FormatError
from .json_files import excerpt

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


def webp_pixels(data: bytes, name: str) -> UInt8[np.ndarray, "h w 4"]:
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
