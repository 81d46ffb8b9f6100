"""Answers to lines on stdin that are no JSON-RPC: the SDK drops them, so that their sender would wait for ever."""

import json
from collections.abc import AsyncIterator
from typing import Any

from mcp.shared.message import SessionMessage
from mcp_types import INVALID_REQUEST, PARSE_ERROR, ErrorData, JSONRPCError, JSONRPCNotification
from pydantic import ValidationError

NOTIFICATIONS = "notifications/"  # how the methods of all notifications of the protocol begin


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
        while True:
            item: SessionMessage | Exception = await anext(self._messages)
            if isinstance(item, SessionMessage) and not _lacks_an_id(item.message):
                return item
            error = error_for(item) if isinstance(item, Exception) else _invalid_request(None)
            if error is not None:
                await self._answers.send(SessionMessage(error))

    async def aclose(self) -> None:
        await self._messages.aclose()


def error_for(fault: Exception) -> JSONRPCError | None:
    """Return what answers a line that the SDK could not read, or None for an empty line."""
    faults = fault.errors(include_url=False) if isinstance(fault, ValidationError) else []
    line = next((str(one["input"]) for one in faults if one["type"] == "json_invalid"), None)
    if line is None:
        # the fields that an answer has and a request lacks are missing in the whole message
        whole = next((one["input"] for one in faults if one["type"] == "missing"), None)
        return _invalid_request(_id_of(whole))
    if not line.strip():
        return None
    return _error(_id_in(line), PARSE_ERROR, f"expected one JSON-RPC message a line; {faults[0]['msg']}")


def _lacks_an_id(message: Any) -> bool:
    """Return whether a message asks for something under no id that an answer could name.

    The SDK takes it for a notification, which nothing answers: an id of null, 1.5 or a list is dropped.
    """
    return isinstance(message, JSONRPCNotification) and not message.method.startswith(NOTIFICATIONS)


def _invalid_request(request: str | int | None) -> JSONRPCError:
    expected = '{"jsonrpc": "2.0", "id": ..., "method": ..., "params": {...}}, the id a text or a whole number'
    return _error(request, INVALID_REQUEST, f"expected a JSON-RPC message: {expected}")


def _error(request: str | int | None, code: int, message: str) -> JSONRPCError:
    return JSONRPCError(jsonrpc="2.0", id=request, error=ErrorData(code=code, message=message))


def _id_in(line: str) -> str | int | None:
    """Return the id of a request as Python's lenient reader finds it, or None. It takes halves of surrogate pairs."""
    try:
        return _id_of(json.loads(line))
    except (ValueError, RecursionError):
        return None


def _id_of(message: object) -> str | int | None:
    """Return the id of a message, or None where there is none that can be written."""
    found = message.get("id") if isinstance(message, dict) else None
    if isinstance(found, str):
        return found if found.isprintable() else None  # halves of surrogate pairs cannot be written
    return found if type(found) is int else None
