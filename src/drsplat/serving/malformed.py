"""Answers to lines on stdin that are no JSON-RPC: the SDK drops them, so that their sender would wait for ever."""

import json
from collections.abc import AsyncIterator
from typing import Any

from mcp.shared.message import SessionMessage
from mcp_types import INVALID_REQUEST, PARSE_ERROR, ErrorData, JSONRPCError
from pydantic import ValidationError


class Answering:
    """The messages of a stream without the malformed ones, each of which is answered with an error.

    Args: messages: the SDK's stream of messages, and of exceptions in place of malformed ones. answers: its stream to
    the client.
    """

    def __init__(self, messages: Any, answers: Any) -> None:
        self._messages, self._answers = messages, answers

    def __aiter__(self) -> AsyncIterator[SessionMessage]:
        return self

    async def __anext__(self) -> SessionMessage:
        while isinstance(item := await anext(self._messages), Exception):
            if (error := error_for(item)) is not None:
                await self._answers.send(SessionMessage(error))
        message: SessionMessage = item
        return message

    async def aclose(self) -> None:
        await self._messages.aclose()


def error_for(fault: Exception) -> JSONRPCError | None:
    """Return what answers a line that the SDK could not read, or None for an empty line."""
    (first, *_) = fault.errors(include_url=False) if isinstance(fault, ValidationError) else ({"type": "", "msg": ""},)
    if first["type"] != "json_invalid":
        message = 'expected a JSON-RPC message: {"jsonrpc": "2.0", "id": ..., "method": ..., "params": {...}}'
        return _error(None, INVALID_REQUEST, message)
    line = str(first["input"])
    if not line.strip():
        return None
    return _error(_id_in(line), PARSE_ERROR, f"expected one JSON-RPC message a line; {first['msg']}")


def _error(request: str | int | None, code: int, message: str) -> JSONRPCError:
    return JSONRPCError(jsonrpc="2.0", id=request, error=ErrorData(code=code, message=message))


def _id_in(line: str) -> str | int | None:
    """Return the id of a request as Python's lenient reader finds it, or None. It takes halves of surrogate pairs."""
    try:
        message = json.loads(line)
    except (ValueError, RecursionError):
        return None
    found = message.get("id") if isinstance(message, dict) else None
    if isinstance(found, str):
        return found if found.isprintable() else None  # halves of surrogate pairs cannot be written
    return found if type(found) is int else None
