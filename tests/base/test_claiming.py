"""One writer at a time: held by processes, not by files, and gone with them."""

import json
import os
import signal
import subprocess
import sys

import pytest

from command_line import error_of
from drsplat.base import system
from drsplat.formats.replacing import claimed_folder, claimed_output
from refusing import refused

HOLD = """
import sys, time
from drsplat.formats.replacing import claimed_folder, claimed_output
with (claimed_folder if sys.argv[1] == "folder" else claimed_output)(sys.argv[2]):
    print("held", flush=True)
    time.sleep(600)
"""
kinds = pytest.mark.parametrize(
    ("kind", "claim", "lock"), [("folder", claimed_folder, "out/.lock"), ("output", claimed_output, ".out.lock")]
)


@kinds
def test_another_process_is_refused_until_this_one_is_killed(kind, claim, lock, tmp_path):
    command = [sys.executable, "-c", HOLD, kind, str(tmp_path / "out")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout.readline() == "held\n"
        said = f"out is being written by process {holder.pid} on "
        with refused(said), claim(tmp_path / "out"):
            pass
        holder.send_signal(signal.SIGKILL)
    assert (tmp_path / lock).is_file()  # stale: it holds nobody up
    with claim(tmp_path / "out"):
        assert json.loads((tmp_path / lock).read_text())["pid"] == os.getpid()
    assert not (tmp_path / lock).exists()


@kinds
def test_what_a_killed_process_left_is_swept_though_nothing_is_written(kind, claim, lock, tmp_path):
    folder = tmp_path / "out" if kind == "folder" else tmp_path
    folder.mkdir(exist_ok=True)
    dead, living = folder / ".a.field.0123456789abcdef.tmp", folder / ".0123456789abcdee.tmp"
    dead.mkdir()
    with open(living, "xb") as file:
        system.lock(file.fileno())  # as who writes it holds it
        with claim(tmp_path / "out"):
            assert not dead.exists()
            assert living.exists()


@kinds
def test_it_is_let_go_of_when_the_block_ends_badly(kind, claim, lock, tmp_path):
    with pytest.raises(ZeroDivisionError), claim(tmp_path / "out"):
        raise ZeroDivisionError
    assert not (tmp_path / lock).exists()
    with claim(tmp_path / "out"), refused("is being written"), claim(tmp_path / "out"):
        pass


def test_a_lock_that_was_removed_is_not_held(tmp_path, monkeypatch):
    """Who waited for a file that its owner has unlinked would hold nothing."""
    from drsplat.base import system

    original, times = system.fcntl.flock, []

    def unlinked_meanwhile(file, how):
        original(file, how)
        times.append(how)
        if len(times) == 1:
            (tmp_path / ".out.lock").unlink()

    monkeypatch.setattr(system.fcntl, "flock", unlinked_meanwhile)
    with claimed_output(tmp_path / "out"):
        assert len(times) == 2
        assert (tmp_path / ".out.lock").is_file()


def test_what_cannot_be_claimed_is_said(tmp_path):
    with refused("there is no folder"), claimed_output(tmp_path / "a/b"):
        pass
    (tmp_path / "file").touch()
    with refused("is a file"), claimed_folder(tmp_path / "file"):
        pass
    (tmp_path / ".out.lock").write_bytes(b"\xff nonsense")
    with claimed_output(tmp_path / "out"), refused("is being written"), claimed_output(tmp_path / "out"):
        pass


@kinds
def test_a_lock_that_is_a_link_is_not_followed(kind, claim, lock, tmp_path):
    """It came with a capture from elsewhere, and led to a file of the user's, which was written over."""
    (tmp_path / lock).parent.mkdir(exist_ok=True)
    for kept in (tmp_path / "kept", tmp_path / "not there"):
        (tmp_path / lock).symlink_to(kept)
        if kept.name == "kept":
            kept.write_text("precious")
        with refused("is a link, a folder or a pipe"), claim(tmp_path / "out"):
            pass
        (tmp_path / lock).unlink()
    assert (tmp_path / "kept").read_text() == "precious"
    assert not (tmp_path / "not there").exists()


@kinds
@pytest.mark.parametrize("make", [os.mkdir, os.mkfifo])
def test_a_lock_that_is_no_file_is_named(make, kind, claim, lock, tmp_path):
    (tmp_path / lock).parent.mkdir(exist_ok=True)
    make(tmp_path / lock)
    with refused("is a link, a folder or a pipe"), claim(tmp_path / "out"):
        pass
    assert (tmp_path / lock).exists()


@pytest.mark.parametrize("said", [b'{"pid": 1e999, "host": "a"}', b"[" * 1000, b"\xff"])
def test_a_holder_that_says_nonsense_is_another_process(said, tmp_path):
    with claimed_output(tmp_path / "out"):
        (tmp_path / ".out.lock").write_bytes(said)
        expected = refused("is being written by another process")
        with expected, claimed_output(tmp_path / "out"):
            pass


@pytest.mark.parametrize(
    ("claim", "line"),
    [
        (claimed_output, "register scene.ply capture --features f"),
        (claimed_folder, "embed capture --segmenter graph --encoder drsplat-mini"),
    ],
)
def test_two_runs_do_not_share_an_output(claim, line, edited_room, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(edited_room)
    with claim(tmp_path / "out"):
        said = error_of(capsys, *line.split(), "--output", tmp_path / "out")
    assert f"out is being written by process {os.getpid()}" in said
