"""Valid files of other programs are read as they are meant, or refused with the reason: see `strange_files`."""

from pathlib import Path

import pytest

from strange_files import CASES, Case


@pytest.mark.parametrize("one", CASES, ids=lambda one: f"{one.kind}: {one.name}")
def test_a_file_is_read_as_it_is_meant_or_refused_with_the_reason(one: Case, tmp_path: Path) -> None:
    outcome = one.outcome(tmp_path)
    assert one.is_right(outcome), outcome
