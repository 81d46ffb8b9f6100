"""Slow acts of the live viewer work beside the session: it answers meanwhile, as it was before them."""

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from browsing import eventually
from clients import Viewer, a_viewer
from drsplat.fronts.viewing.edits import Edits
from drsplat.fronts.viewing.live import files
from drsplat.fronts.viewing.live.turns import Lanes
from drsplat.fronts.viewing.session import Session

PATIENCE_S = 60
KEYS = [{"eye": [0, -8, 0], "target": [0, 0, 0], "fov": 50}, {"eye": [2, -8, 0], "target": [0, 0, 0], "fov": 50}]


@pytest.fixture
def viewer() -> Iterator[Viewer]:
    with a_viewer() as one:
        yield one


class Gate:
    """A place in slow work: `come` is set when somebody stands there, who goes on when `go` is set."""

    def __init__(self) -> None:
        self.come, self.go = threading.Event(), threading.Event()

    def wait(self) -> None:
        self.come.set()
        assert self.go.wait(PATIENCE_S)


@contextmanager
def others() -> Iterator[ThreadPoolExecutor]:
    """Other pages, each with a thread of its own."""
    with ThreadPoolExecutor(4) as pool:
        yield pool


@pytest.fixture
def editing(monkeypatch: pytest.MonkeyPatch) -> Gate:
    """Edits that are computed, but wait before anybody gets them."""
    gate, add = Gate(), Edits.add

    def slow(self: Edits, edit: Any) -> None:
        add(self, edit)
        gate.wait()

    monkeypatch.setattr(Edits, "add", slow)
    return gate


def test_queries_and_splats_come_from_the_old_version_while_an_edit_is_computed(viewer, editing):
    viewer.ask("red mug")
    before = viewer.get("/view/splats").content
    with others() as pool:
        edit = pool.submit(viewer.do, "edit", change="remove")
        assert editing.come.wait(PATIENCE_S)
        state = viewer.ask("blue mug")
        assert state["results"][0]["text"] == "blue mug"
        assert state["edits"] == []
        assert viewer.get("/view/splats").content == before
        assert not edit.done()
        editing.go.set()
        after = edit.result(PATIENCE_S)
    assert [one["what"] for one in after["edits"]] == ["remove"]
    assert (after["mode"], after["results"][0]["text"]) == ("answer", "blue mug")  # what was asked meanwhile stays
    assert viewer.get("/view/splats").content != before


def test_edits_of_two_pages_are_both_done_one_after_the_other(viewer, editing):
    viewer.ask("red mug")
    with others() as pool:
        first = pool.submit(viewer.do, "edit", change="recolour", color="#2060ff")
        assert editing.come.wait(PATIENCE_S)
        second = pool.submit(viewer.do, "edit", change="remove")
        viewer.do("annotate", text="here", at="selection")
        editing.go.set()
        listed = [[one["what"] for one in page.result(PATIENCE_S)["edits"]] for page in (first, second)]
    assert listed == [["recolour"], ["recolour", "remove"]]
    state = viewer.state()
    assert len(state["annotations"]) == 1  # made while the first one was computed
    assert viewer.do("undo")["edits"][1]["done"] is False


def test_a_film_is_drawn_of_what_was_shown_when_it_was_asked_for(viewer, monkeypatch):
    gate, drawn = Gate(), list[tuple[str, int]]()

    def slow(session: Session, view: Any) -> np.ndarray:
        drawn.append((str(session.mode), session.edits.listed.done))
        gate.wait()
        return np.zeros((48, 64, 3), np.uint8)

    monkeypatch.setattr(files, "FILM_SIZE_PIXELS", (64, 48))
    monkeypatch.setattr(files, "picture_of", slow)
    body = {"keys": KEYS, "seconds": 0.25, "format": ".gif", "job": "mine"}
    with others() as pool:
        film = pool.submit(viewer.post, "/view/film", body)
        assert gate.come.wait(PATIENCE_S)
        viewer.ask("red mug")
        assert len(viewer.do("edit", change="remove")["edits"]) == 1
        assert viewer.get("/view/film-progress", job="mine").json() == {"done": 0, "count": 6}
        assert not film.done()
        gate.go.set()
        assert film.result(PATIENCE_S).status_code == 200
    assert drawn == [("as it is", 0)] * 6
    assert viewer.get("/view/film-progress", job="mine").json() == {"done": 0, "count": 0}


def test_a_page_is_of_the_edits_on_show_also_where_they_are_kept_nowhere(viewer, monkeypatch):
    gate, export, counts = Gate(), files.export_session, list[int]()

    def slow(path: Path, session: Session, *more: Any, **named: Any) -> Any:
        gate.wait()
        page = export(path, session, *more, **named)
        counts.append(page.num_edits)
        return page

    monkeypatch.setattr(files, "export_session", slow)
    viewer.ask("red mug")
    viewer.do("edit", change="remove")
    with others() as pool:
        page = pool.submit(viewer.post, "/view/page", {})
        assert gate.come.wait(PATIENCE_S)
        assert viewer.do("undo")["can_redo"]
        gate.go.set()
        assert page.result(PATIENCE_S).status_code == 200
    assert counts == [1]


def test_names_are_found_beside_the_session(viewer, monkeypatch):
    gate = Gate()
    monkeypatch.setattr("drsplat.fronts.viewing.stage.suggestions", lambda *_: gate.wait() or ["red mug"])
    preparing = viewer.lanes.change(viewer.shared.prepare)
    assert gate.come.wait(PATIENCE_S)
    assert viewer.header()["words"] == []
    gate.go.set()
    preparing.result(PATIENCE_S)
    assert viewer.header()["words"] == ["red mug"]


def test_what_fails_in_each_step_goes_to_whoever_waits():
    lanes = Lanes()

    def failing() -> Any:
        return lambda: 1 / 0

    with pytest.raises(ZeroDivisionError):
        lanes.change(failing).result(PATIENCE_S)
    with pytest.raises(ZeroDivisionError):
        lanes.change(failing()).result(PATIENCE_S)
    assert lanes.change(lambda: lambda: 7).result(PATIENCE_S) == 7  # the threads are alive
    eventually(lambda: lanes.quick.waiting == lanes.changes.waiting == 0)
    lanes.stop()
