"""The HTTP service without a network, and a worker's replies without a process.

Tests import it before the services, by its name: it skips them where the extra drsplat[serve] is not installed.
"""

import asyncio
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("fastapi", reason="the extra drsplat[serve] is not installed")
pytest.importorskip("prometheus_client", reason="the extra drsplat[serve] is not installed")
pytest.importorskip("httpx", reason="httpx, which the tests ask with, is not installed")

import httpx

from drsplat.fronts.serving.app import Settings, create_app
from drsplat.fronts.serving.live import Adder
from drsplat.fronts.serving.replies import Reply
from drsplat.fronts.serving.scene_folder import SceneFolder
from drsplat.fronts.serving.worker import Workplace, reply_to

KEY = "0123456789abcdef-key"


class Service:
    """The application, asked without a network."""

    def __init__(self, folder: Path, **settings: Any) -> None:
        self.app = create_app(Settings(str(folder), **settings))

    def close(self) -> None:
        self.app.state.adding.close()
        self.app.state.bench.close()

    def __call__(self, method: str, path: str, **given: Any) -> Any:
        return self.all([(method, path, given)])[0]

    def post(self, act: str, asked: Any, scene: str = "room") -> Any:
        return self("POST", f"/scenes/{scene}/{act}", json=asked)

    def all(self, calls: list[tuple[str, str, dict[str, Any]]]) -> list[Any]:
        """Several at once."""

        async def asked() -> list[Any]:
            transport = httpx.ASGITransport(self.app)
            async with httpx.AsyncClient(transport=transport, base_url="http://here") as client:
                waiting = [client.request(method, path, **given) for method, path, given in calls]
                return list(await asyncio.gather(*waiting))

        return asyncio.run(asked())


def told(answer: Any) -> dict[str, Any]:
    assert answer.status_code == 200, answer.text
    body: dict[str, Any] = answer.json()
    return body


def reason(answer: Any, status: int) -> str:
    assert answer.status_code == status, answer.text
    body = answer.json()
    assert set(body) == {"error", "kind"}
    return str(body["error"])


def reply_of(scenes: SceneFolder | Path, act: str, asked: dict[str, Any], name: str = "") -> Reply:
    """What a worker replies to an act about a scene, or the only one."""
    folder = scenes if isinstance(scenes, SceneFolder) else SceneFolder(scenes)
    place = Workplace(str(folder.folder))
    return reply_to(folder, place, act, name or folder.only() or "", asked, Adder(folder))
