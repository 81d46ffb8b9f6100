"""What a browser may say to the viewer. All else that viser understands never reaches it.

Its own reading takes any message of any shape: one sets any attribute of a control, another opens a tunnel through
a server elsewhere. So a message is read here into one of few shapes, within bounds, and written anew: what viser
reads is what was checked.
"""

from collections.abc import Callable, Mapping
from typing import Any

import msgspec

MOST_TEXT = 500  # characters that are typed
MOST_NAME = 255  # characters of a file's name, or of what viser calls its controls
MOST_MESSAGE = 1 << 20  # bytes; pictures come in parts of half of that
MOST_COUNT = 1 << 40
FAR = 1e9

CAMERA, CONTROL, SCENE_PRESS, NODE_PRESS, UPLOAD, PART, KEY = (
    "ViewerCameraMessage", "GuiUpdateMessage", "ScenePointerMessage", "SceneNodeClickMessage",
    "FileTransferStartUpload", "FileTransferPart", "CommandTriggerMessage",
)  # fmt: skip
Check = Callable[[Any], bool]
Message = dict[str, Any]


def read(data: bytes) -> Message | None:
    """The message in `data`; None where it is none of those below."""
    try:
        said = msgspec.msgpack.decode(data)
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError):
        return None
    kind = said.get("type") if isinstance(said, dict) else None
    shape = SHAPES.get(kind) if isinstance(kind, str) else None
    if shape is None or not all(check(said.get(name)) for name, check in shape.items()):
        return None
    return {"type": kind} | {name: said[name] for name in shape if name in said}


def written(message: Message) -> bytes:
    return msgspec.msgpack.encode(message)


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and abs(value) <= FAR  # NaN is not


def _is_count(value: Any) -> bool:
    return type(value) is int and 0 <= value <= MOST_COUNT


def _is_name(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= MOST_NAME


def _is_angle(value: Any) -> bool:
    return _is_number(value) and 0.01 <= value <= 3.1


def _is_pressed(value: Any) -> bool:
    """Return whether it is a new value, and nothing else of a control; lists are colours, places and spans."""
    return isinstance(value, dict) and value.keys() == {"value"} and _is_value(value["value"])


def _is_value(value: Any) -> bool:
    if isinstance(value, str):
        return len(value) <= MOST_TEXT
    return isinstance(value, bool) or _is_number(value) or _point(value) or _place(value)


def _list_of(count: int, check: Check) -> Check:
    return lambda value: isinstance(value, list) and len(value) == count and all(check(one) for one in value)


def _or_none(check: Check) -> Check:
    return lambda value: value is None or check(value)


_point, _place = _list_of(3, _is_number), _list_of(2, _is_number)
SHAPES: Mapping[str, Mapping[str, Check]] = {
    CAMERA: {
        "wxyz": _list_of(4, _is_number), "position": _point, "look_at": _point, "up_direction": _point,
        "fov": _is_angle, "near": _is_number, "far": _is_number,
        "image_height": _is_count, "image_width": _is_count,
    },
    CONTROL: {"uuid": _is_name, "updates": _is_pressed},
    KEY: {"uuid": _is_name},
    SCENE_PRESS: {
        "event_type": lambda value: value == "click", "ray_origin": _point, "ray_direction": _point,
        "screen_pos": _list_of(1, _place), "modifier": _or_none(_is_name),
    },
    NODE_PRESS: {
        "name": _is_name, "owner": _or_none(_is_name), "instance_index": _or_none(_is_count),
        "ray_origin": _point, "ray_direction": _point, "screen_pos": _place, "modifier": _or_none(_is_name),
    },
    UPLOAD: {
        "source_component_uuid": _is_name, "transfer_uuid": _is_name, "filename": _is_name, "mime_type": _is_name,
        "part_count": _is_count, "size_bytes": _is_count,
    },
    PART: {
        "source_component_uuid": _is_name, "transfer_uuid": _is_name, "part_index": _is_count,
        "content": lambda value: isinstance(value, bytes),
    },
}  # fmt: skip
"""Each kind of message: its fields, and whether a field is as it must be."""
