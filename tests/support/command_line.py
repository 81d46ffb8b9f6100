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


class Line:
    """A command line that a test begins alike each time: called, it gives the JSON object of what is added."""

    def __init__(self, capsys: Capture, *begin: object) -> None:
        self.capsys, self.begin = capsys, begin

    def __call__(self, *argv: object, code: int = 0) -> dict[str, Any]:
        return answer_of(self.capsys, *self.begin, *argv, code=code)

    def text(self, *argv: object) -> str:
        return text_of(self.capsys, *self.begin, *argv)

    def error(self, *argv: object, code: int = 1) -> str:
        return error_of(self.capsys, *self.begin, *argv, code=code)

    def notes(self, *argv: object) -> str:
        """What a command that goes well says on stderr."""
        self.capsys.readouterr()
        assert main([*map(str, (*self.begin, *argv))]) == 0
        return self.capsys.readouterr().err

    def plus(self, *argv: object) -> "Line":
        return Line(self.capsys, *self.begin, *argv)
