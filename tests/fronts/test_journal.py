"""Journals: what is in one after any kill, and that nothing else is ever read from it."""

from pathlib import Path

import pytest

from drsplat.formats.embedding_record import Journal, changes_to
from refusing import malformed, refused

DOCUMENT, CURE = "0badcafe", "Make it anew."
CHANGES = [{"stem": "a", "finished": {"masks": 3}}, {"stem": "cam0/b", "finished": None}, {"stem": "\n\u00e4"}]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "some.jsonl"
    written(path, CHANGES)
    return path


def written(path: Path, changes: list[dict[str, object]], document: str = DOCUMENT) -> None:
    journal = Journal(path, document)
    for change in changes:
        journal.add(change)
    journal.close()


def read(path: Path, document: str = DOCUMENT) -> list[dict[str, object]]:
    changes = list(changes_to(path, document, CURE))
    return [{key: value for key, value in change.items() if key != "crc32"} for change in changes]


def test_changes_come_back_in_their_order(path):
    assert read(path) == CHANGES


def test_the_journal_of_another_document_is_not_read(path):
    assert read(path, "deadbeef") == []
    written(path, CHANGES[:1], "deadbeef")  # in place of the other
    assert read(path, "deadbeef") == CHANGES[:1]


def test_without_a_journal_nothing_has_changed(tmp_path):
    assert read(tmp_path / "none.jsonl") == []
    (tmp_path / "folder.jsonl").mkdir()
    with refused("expected a file"):
        read(tmp_path / "folder.jsonl")


def test_a_kill_at_any_byte_loses_the_line_that_was_being_written_and_no_other(path):
    content = path.read_bytes()
    for size in range(len(content) + 1):
        path.write_bytes(content[:size])
        lines = content[:size].count(b"\n")
        assert read(path) == CHANGES[: max(lines - 1, 0)]


def test_a_changed_byte_is_found_or_drops_the_last_line(path):
    content = path.read_bytes()
    for at in range(len(content) - 1):
        path.write_bytes(content[:at] + bytes([content[at] ^ 1 << at % 8]) + content[at + 1 :])
        with malformed(r"some\.jsonl: line \d"):
            read(path)
    path.write_bytes(content[:-1] + b" ")
    assert read(path) == CHANGES[:-1]


def test_damage_names_the_line_and_the_cure(path):
    path.write_bytes(path.read_bytes().replace(b"cam0", b"cam1"))
    with malformed(r"some\.jsonl: line 3: damaged or edited.*Make it anew\."):
        read(path)
    path.write_bytes(b"[]\n")
    with malformed(r"line 1: damaged or edited: expected an object"):
        read(path)
