"""A value of a document becomes the kind of Python value that is expected, or an error that names the part."""

import json
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
import pytest

from drsplat import DrSplatError
from drsplat.base.arrays import Matrix3, Vector3
from drsplat.errors import FormatError
from drsplat.formats.json_files import as_document, as_fields, as_kind, read_json, write_json


class Place(NamedTuple):
    center: Vector3
    name: str = ""


@dataclass(frozen=True)
class Room:
    kind: Literal["room", "hall"]
    places: tuple[Place, ...] = ()
    areas: dict[str, float] = field(default_factory=dict)
    seen: int | None = None
    is_open: bool = False


ROOM = {
    "kind": "hall",
    "places": [{"center": [1, 2, 3], "more": 7}],
    "areas": {"floor": 2},
    "seen": 3.0,
    "is_open": True,
}


def test_an_object_becomes_what_describes_it():
    room = as_kind(ROOM, Room, "here")
    assert (room.kind, room.areas, room.seen, room.is_open) == ("hall", {"floor": 2.0}, 3, True)
    assert room.places[0].name == ""
    np.testing.assert_array_equal(room.places[0].center, [1.0, 2.0, 3.0])
    assert as_kind({"kind": "room"}, Room, "here") == Room("room")
    assert as_kind([[1, 0, 0], [0, 1, 0], [0, 0, 1]], Matrix3, "here").tolist() == np.eye(3).tolist()
    assert as_fields({"a": 1}, "here", a=float, b=str | None) == {"a": 1.0, "b": None}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ([], "here: expected an object with kind, got a list of 0"),
        ({"kind": 3}, "here: kind: expected 'room' or 'hall', got 3"),
        ({"kind": None}, "here: kind: expected 'room' or 'hall', got None"),
        ({"places": {}}, "here: places: expected a list, got a dict of 0"),
        ({"places": [3]}, "here: places: 0: expected an object with center, got 3"),
        ({"places": [{"center": [1, 2]}]}, "here: places: 0: center: expected 3 numbers, got a list of 2"),
        ({"places": [{"center": [1, 2, 3], "name": 3}]}, "here: places: 0: name: expected a text, got 3"),
        ({"areas": {"floor": True}}, "here: areas: 'floor': expected a number, got True"),
        ({"seen": 1.5}, "here: seen: expected a whole number, got 1.5"),
        ({"is_open": 1}, "here: is_open: expected true or false, got 1"),
    ],
)
def test_what_is_of_another_kind_is_named(change, said):
    with pytest.raises(FormatError) as error:
        as_kind(ROOM | change if isinstance(change, dict) else change, Room, "here")
    assert str(error.value) == said


@pytest.mark.parametrize(
    ("document", "said"),
    [
        (3, "expected 'ours' of version 2, got 3. Make it anew"),
        ({"format": "theirs"}, "expected 'ours' of version 2, got 'theirs'. Make it anew"),
        ({"format": "ours", "version": 1}, "expected 'ours' of version 2, got 1. Make it anew"),
    ],
)
def test_a_document_of_another_format_is_refused(tmp_path, document, said):
    with pytest.raises(DrSplatError) as error:
        as_document(document, "here", "ours", 2, "Make it anew")
    assert str(error.value) == f"here: {said}"
    path = tmp_path / "a.json"
    write_json(path, {"format": "ours", "version": 2})
    assert as_document(read_json(path), "here", "ours", 2) == json.loads(path.read_text())
