"""The plug-in for LichtFeld Studio against a running `drsplat serve`; the program itself is a stand-in here.

The stand-in has what the program's documents say of its module: panels, immediate widgets, scenes and tensors (plug-in
API 1, docs/plugins/api-reference.md and src/python/stubs/lichtfeld/scene.pyi of its repository).
"""

import importlib
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from urllib.request import urlopen

import numpy as np
import pytest

import drsplat as ds

pytest.importorskip("fastapi", reason="the extra drsplat[serve] is not installed")
pytest.importorskip("uvicorn", reason="the extra drsplat[serve] is not installed")
pytest.importorskip("prometheus_client", reason="the extra drsplat[serve] is not installed")

PLUGINS = Path(__file__).resolve().parents[2] / "integrations/lichtfeld"
WORDS = "red mug"


class Tensor:
    """As much of the program's tensors as the plug-in uses."""

    def __init__(self, values: np.ndarray) -> None:
        self.values = values

    @classmethod
    def from_numpy(cls, values: np.ndarray) -> "Tensor":
        return cls(values)

    def cpu(self) -> "Tensor":
        return self

    def numpy(self) -> np.ndarray:
        return self.values


class Scene:
    """A scene of visible nodes, whose Gaussians are merged in their order."""

    def __init__(self, *nodes: np.ndarray) -> None:
        self.nodes, self.mask, self.redrawn = nodes, None, 0

    def combined_model(self) -> Any:
        merged = np.concatenate(self.nodes)
        return SimpleNamespace(means_raw=Tensor(merged), num_points=len(merged))

    def get_visible_nodes(self) -> list[Any]:
        return [SimpleNamespace(gaussian_count=len(node)) for node in self.nodes]

    def set_selection_mask(self, mask: Tensor) -> None:
        self.mask = mask.numpy()

    def clear_selection(self) -> None:
        self.mask = None

    def notify_changed(self) -> None:
        self.redrawn += 1


class Ui:
    """Immediate widgets: texts are typed and buttons pressed once. message: the text that is shown."""

    def __init__(self, pressed: str = "", **typed: str) -> None:
        self.pressed, self.typed, self.message = pressed, typed, ""

    def input_text(self, label: str, value: str) -> tuple[bool, str]:
        typed = self.typed.get(label.split()[-1], value)
        return typed != value, typed

    def input_text_with_hint(self, label: str, _: str, value: str) -> tuple[bool, str]:
        return self.input_text(label, value)

    def button(self, label: str) -> bool:
        return label == self.pressed

    def text_wrapped(self, text: str) -> None:
        self.message = text


@pytest.fixture
def program(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The stand-in for the module `lichtfeld`, with the plug-in loaded into it as `plugin`."""
    module = ModuleType("lichtfeld")
    registered: list[type] = []
    spaces = SimpleNamespace(MAIN_PANEL_TAB="MAIN_PANEL_TAB")
    vars(module).update(
        ui=SimpleNamespace(Panel=type("Panel", (), {}), PanelSpace=spaces), Tensor=Tensor, scene=None,
        register_class=registered.append, unregister_class=registered.remove, registered=registered,
    )  # fmt: skip
    vars(module)["get_scene"] = lambda: vars(module)["scene"]
    monkeypatch.setitem(sys.modules, "lichtfeld", module)
    monkeypatch.syspath_prepend(str(PLUGINS))
    for name in [name for name in sys.modules if name.partition(".")[0] == "drsplat_search"]:
        monkeypatch.delitem(sys.modules, name)
    vars(module)["plugin"] = importlib.import_module("drsplat_search")
    return module


@pytest.fixture(scope="module")
def address(edited_room: Path) -> Iterator[str]:
    """Where a `drsplat serve` of the room answers."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "drsplat", "serve", str(edited_room), "--port", str(port), "--workers", "1"]
    server = subprocess.Popen([*command, "--threads", "1"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        for _ in range(600):
            try:
                urlopen(f"http://127.0.0.1:{port}/health").close()
                break
            except OSError:
                time.sleep(0.1)
        yield f"http://127.0.0.1:{port}"
    finally:
        server.terminate()
        server.wait(60)


@pytest.fixture
def gaussians(edited_room: Path) -> ds.Gaussians:
    return ds.read_gaussians(edited_room / "scene.ply")


def asked(program: Any, address: str, scene: Scene | None, words: str = WORDS) -> str:
    """Type words into the panel, press its button and draw until there is an answer; return what it says."""
    program.scene = scene
    program.plugin.on_load()
    panel = program.registered[-1]()
    ui = Ui("Select", serve=address, Words=words)
    panel.draw(ui)
    for _ in range(600):
        ui = Ui(serve=address, Words=words)
        panel.draw(ui)
        if not ui.message.endswith("..."):
            return ui.message
        time.sleep(0.1)
    raise AssertionError("no answer within a minute")


def test_words_select_the_rows_that_drsplat_selects(
    program: Any, address: str, gaussians: ds.Gaussians, edited_room: Path
) -> None:
    expected = ds.open_scene(edited_room).ask(WORDS).gaussian_ids
    assert 0 < len(expected) < len(gaussians)
    scene = Scene(gaussians.means)
    message = asked(program, address, scene)
    assert message == f"{WORDS}: {len(expected):,} of {len(gaussians):,} Gaussians"
    assert scene.mask is not None
    assert scene.mask.dtype == bool
    np.testing.assert_array_equal(np.flatnonzero(scene.mask), expected)
    assert scene.redrawn == 1


def test_a_scene_is_found_among_others_that_are_open(
    program: Any, address: str, gaussians: ds.Gaussians, edited_room: Path
) -> None:
    expected = ds.open_scene(edited_room).ask(WORDS).gaussian_ids
    scene = Scene(np.zeros((5, 3), np.float32), gaussians.means, np.ones((3, 3), np.float32))
    asked(program, address, scene)
    assert scene.mask is not None
    np.testing.assert_array_equal(np.flatnonzero(scene.mask), 5 + expected)


def test_another_order_or_place_is_refused(program: Any, address: str, gaussians: ds.Gaussians) -> None:
    moved = gaussians.means.copy()
    moved[3, 0] += 0.01
    for means in (gaussians.means[::-1], moved, gaussians.means[:-1]):
        scene = Scene(means)
        assert "are no scene that is served" in asked(program, address, scene)
        assert scene.mask is None


def test_refusals_are_shown(program: Any, address: str, gaussians: ds.Gaussians) -> None:
    scene = Scene(gaussians.means)
    assert asked(program, address, None) == "Open a scene first."
    assert "no drsplat serve answers at http://127.0.0.1:9" in asked(program, "http://127.0.0.1:9", scene)
    assert "expected http://HOST:PORT" in asked(program, "file:///etc/passwd", scene)
    assert "200 characters" in asked(program, address, scene, "x" * 201)
    assert scene.mask is None


def test_the_fingerprint_is_that_of_drsplat(program: Any, gaussians: ds.Gaussians) -> None:
    from dataclasses import replace

    asking = sys.modules["drsplat_search.asking"]
    both = {gaussians.fingerprint, replace(gaussians, antialiased=True).fingerprint}
    assert asking.fingerprints(gaussians.means) == both


def test_what_is_registered_goes_when_the_plugin_does(program: Any) -> None:
    program.plugin.on_load()
    [panel] = program.registered
    assert (panel.id, panel.space) == ("drsplat_search.panel", "MAIN_PANEL_TAB")
    program.plugin.on_unload()
    assert program.registered == []
