"""Valid files of other programs are read as they are meant, or refused with the reason: see `strange_files`."""

import pytest

from strange_files import CASES


@pytest.mark.parametrize("one", CASES, ids=lambda one: f"{one.kind}: {one.name}")
def test_a_file_is_read_as_it_is_meant_or_refused_with_the_reason(one, tmp_path):
    if one.name.startswith("USD"):
        pytest.importorskip("pxr")
    outcome = one.outcome(tmp_path)
    assert one.is_right(outcome), outcome


def test_errors_say_what_was_given_what_it_was_taken_for_and_what_to_do_in_that_order():
    """`expected` of an error has these three behind its class, and `is_right` asks for them in their order."""
    errors = [one for one in CASES if one.expected.startswith(("FormatError", "InputError"))]
    assert len(errors) > 40
    assert [one.name for one in errors if one.expected.count(" ... ") < 3] == []
    assert not errors[0].is_right(" ".join(reversed(errors[0].expected.split(" ... "))))
