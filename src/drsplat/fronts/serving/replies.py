"""Replies to a client: bytes with a status, and a reason in JSON for each refusal, in words for whoever asked.

Pictures as bytes, and bytes as pictures.
"""

import base64
import binascii
import io
import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from PIL import Image

from ...base.arrays import Pixels
from ...errors import DrSplatError, FormatError, InputError, MissingExtraError
from ...formats.live_views import FullError, TakenNameError
from ...formats.replacing import ClaimedError, NoRoom
from ...scene.photos import decoded_picture
from .scene_folder import SceneFaultError, UnknownSceneError


def png(pixels: Pixels) -> bytes:
    return _written(pixels, "PNG", compress_level=3)


def jpeg(pixels: Pixels) -> bytes:
    return _written(pixels, "JPEG", quality=90)


def _written(pixels: Pixels, form: str, **options: int) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, form, **options)
    return buffer.getvalue()


def decoded(data: bytes, most_pixels: int) -> Pixels:
    """Return RGB of a picture's bytes, upright, on black where it is transparent.

    Raises: InputError: no picture, damaged, or of more pixels, judged by its header before it is decoded.
    """
    try:
        return decoded_picture(io.BytesIO(data), most_pixels)
    except FormatError as error:
        raise InputError(f"the image {error}") from error


def from_base64(text: str, name: str) -> bytes:
    """Return the bytes of a text in base64. name: of the field that it is of. Raises: InputError: it is no base64."""
    try:
        return base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError) as error:
        raise InputError(f"{name}: expected base64: {error}") from None


BUG = "this is a fault of the service, not of the request; its log has the details"
NO_JSON = "expected JSON and the header Content-Type: application/json (curl: -H 'content-type: application/json')"
JSON, PNG, JPEG, PLY = "application/json", "image/png", "image/jpeg", "application/octet-stream"
GLB = "model/gltf-binary"
MAX_FAULTS, MAX_CHARACTERS = 5, 1000


class BusyError(DrSplatError):
    """More requests wait than may."""


class LostError(DrSplatError):
    """The process that computed an answer ended before it had one."""


_STATUSES: dict[type[DrSplatError], int] = {
    UnknownSceneError: 404, SceneFaultError: 503, BusyError: 503, LostError: 503, MissingExtraError: 503,
    FullError: 429, TakenNameError: 409, ClaimedError: 503, NoRoom: 507,
}  # fmt: skip


class Reply(NamedTuple):
    """field: fingerprint of the field that answered, "" where none did."""

    body: bytes
    media_type: str = JSON
    status: int = 200
    field: str = ""


def is_json(content_type: str) -> bool:
    """Return whether a content type is JSON, which pages of other sites cannot send without a preflight request."""
    kind = content_type.partition(";")[0].strip().lower()
    return kind.startswith("application/") and kind.endswith(("/json", "+json"))


def problem(status: int, error: str, kind: str) -> Reply:
    """Return why there is no answer. Texts may hold halves of surrogate pairs, which are no UTF-8."""
    said = error.encode("utf-8", "replace").decode()
    return Reply(json.dumps({"error": said, "kind": kind}).encode(), status=status)


def refusal(error: DrSplatError, message: str) -> Reply:
    return problem(_STATUSES.get(type(error), 422), message, type(error).__name__)


def packed(reply: Reply) -> bytes:
    """Pack a reply for its way from the process that computed it: a line about it, and the body."""
    body, *about = reply
    return json.dumps(about).encode() + b"\n" + body


def unpacked(message: bytes) -> Reply:
    about, _, body = message.partition(b"\n")
    return Reply(body, *json.loads(about))


def faults_of(errors: Sequence[Mapping[str, Any]]) -> str:
    """Return where each fault that pydantic found is, and what was expected there; no values, which may be large."""
    faults = [f"{'.'.join(map(str, fault['loc']))}: {fault['msg']}" for fault in errors]
    return "; ".join(faults[:MAX_FAULTS])[:MAX_CHARACTERS]
