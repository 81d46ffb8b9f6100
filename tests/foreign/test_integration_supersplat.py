"""What people paste into the console of SuperSplat, run by Node.js beside a stand-in of what it keeps in its page."""

import json
import subprocess
from pathlib import Path

import pytest

from foreign_programs import NODE, needs_node

SCRIPT = Path(__file__).resolve().parents[2] / "integrations/supersplat/select_by_column.js"
STAND_IN = """
const columns = {object_id: Uint32Array.from([9, 4294967295, 3, 9]), relevancy: Float32Array.from([0.9, 0, 0.2, 0.6])};
const chosen = {splatData: {getProp: name => columns[name]}}, fired = [];
globalThis.window = {scene: {events: {invoke: name => name === "selection" && OPEN ? chosen : null,
                                      fire: (...given) => fired.push(given)}}};
"""


def selected(call: str, is_open: bool = True) -> list[object]:
    """Return what a call gives, and the mask that SuperSplat is sent, or the error."""
    shown = f"""
try {{ const count = window.{call}; console.log(JSON.stringify([count, fired[0][0], fired[0][1], [...fired[0][2]]])) }}
catch (error) {{ console.log(JSON.stringify([error.message])) }}"""
    text = STAND_IN.replace("OPEN", json.dumps(is_open)) + SCRIPT.read_text(encoding="utf-8") + shown
    done = subprocess.run([str(NODE), "-e", text], capture_output=True, text=True, check=True)
    return list(json.loads(done.stdout))


@needs_node
@pytest.mark.parametrize(
    ("call", "mask"),
    [
        ('selectByColumn("object_id", id => id === 9)', [255, 0, 0, 255]),
        ('selectByColumn("object_id", id => id === -1)', [0, 255, 0, 0]),
        ('selectByColumn("object_id", id => id >= 0)', [255, 0, 255, 255]),
        ('selectByColumn("relevancy", score => score > 0.5)', [255, 0, 0, 255]),
    ],
)
def test_a_column_becomes_a_selection(call, mask):
    assert selected(call) == [sum(map(bool, mask)), "select.mask", "set", mask]


@needs_node
def test_without_the_column_it_says_what_to_open():
    for call, is_open in (('selectByColumn("class_id", id => true)', True), ('selectByColumn("x", x => true)', False)):
        [error] = selected(call, is_open)
        assert "open a PLY that drsplat saved" in str(error)
