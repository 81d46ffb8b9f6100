"""The errors that most tests expect, with what they have to say."""

import pytest

from drsplat.errors import FormatError, InputError


def refused(said: str, error: type[Exception] = InputError) -> "pytest.RaisesExc[Exception]":
    """Expect what a caller gave to be refused in these words (a regular expression)."""
    return pytest.raises(error, match=said)


def malformed(said: str) -> "pytest.RaisesExc[Exception]":
    """Expect a file to be refused in these words (a regular expression)."""
    return refused(said, FormatError)
