"""Running `drsplat` in a test, and what it printed."""

import json
from typing import Any

import pytest

from drsplat.cli import main

Capture = pytest.CaptureFixture[str]


def answer_of(capsys: Capture, *argv: object, code: int = 0) -> dict[str, Any]:
    """The JSON object that a command prints, which is all it prints on stdout."""
    capsys.readouterr()
    assert main([*map(str, argv), "--json"]) == code
    answer = json.loads(capsys.readouterr().out)
    assert isinstance(answer, dict)
    return answer


def text_of(capsys: Capture, *argv: object, code: int = 0) -> str:
    capsys.readouterr()
    assert main([*map(str, argv)]) == code
    return capsys.readouterr().out


def error_of(capsys: Capture, *argv: object, code: int = 1) -> str:
    """The one error on stderr; stdout stays empty."""
    capsys.readouterr()
    assert main([*map(str, argv)]) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("drsplat: error: ")
    return err
