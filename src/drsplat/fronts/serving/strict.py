"""Bodies of requests read as strictly as files: JSON that gives each name once, of text that can be written."""

from collections.abc import Callable, Coroutine
from json import JSONDecodeError
from typing import Any

from fastapi import Request, Response
from fastapi.routing import APIRoute
from starlette.exceptions import HTTPException

from ...formats.json_files import parsed


class StrictRequest(Request):
    """Request whose JSON is refused where a reader would have to guess."""

    async def json(self) -> Any:
        """Return the document of the body. Raises: JSONDecodeError: it is no JSON. HTTPException: as `parsed` says."""
        try:
            return parsed(await self.body())
        except JSONDecodeError:  # FastAPI says where
            raise
        except (ValueError, RecursionError) as error:
            raise HTTPException(422, f"body: {error}; expected JSON in UTF-8 that gives each name once") from None


class StrictRoute(APIRoute):
    """Route whose requests are strict."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        handler = super().get_route_handler()

        async def handled(request: Request) -> Response:
            return await handler(StrictRequest(request.scope, request.receive))

        return handled
