"""Responses of the HTTP service, made of replies."""

from typing import Annotated, Any

from fastapi import Path, Response

from .replies import Reply

FIELD_HEADER = "x-drsplat-field"
RETRY_STATUSES = (429, 503)
Scene = Annotated[str, Path(min_length=1, max_length=200, description="a name from /scenes")]


def sent(reply: Reply, headers: Any = None) -> Response:
    """Return a response with the field's fingerprint, and when to come again where that helps."""
    more = {"retry-after": "1"} if reply.status in RETRY_STATUSES else {}
    if reply.field:
        more[FIELD_HEADER] = reply.field
    return Response(reply.body, reply.status, {**(headers or {}), **more}, media_type=reply.media_type)
