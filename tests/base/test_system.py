"""One module asks which system this is; files are written also where those that are open have no new name."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import drsplat
from drsplat.base import system
from drsplat.base.system import peak_memory_bytes
from drsplat.formats.replacing import claimed_output, replacing, together
from drsplat.fronts.serving.listening import require
from refusing import refused

SOURCE = Path(drsplat.__file__).parent
MODULES = {"fcntl", "resource", "pwd", "grp", "termios", "tty", "pty", "msvcrt", "winreg", "posix", "nt"}
NAMES = {"getuid", "geteuid", "getgid", "fork", "killpg", "O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC", "O_DIRECTORY"}


def asked_for(path: Path) -> set[str]:
    """Of MODULES and NAMES, what a file uses."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names} & MODULES
        elif isinstance(node, ast.ImportFrom):
            found |= {node.module or ""} & MODULES
        elif isinstance(node, ast.Attribute):
            found |= {node.attr} & NAMES
    return found


@pytest.mark.slow
def test_one_module_asks_which_system_it_is():
    asking = {path.relative_to(SOURCE).as_posix() for path in SOURCE.rglob("*.py") if asked_for(path)}
    assert asking == {"base/system.py"}


def test_peak_memory_counts_bytes():
    before = peak_memory_bytes()
    block = np.ones(80_000_000, np.uint8)
    assert peak_memory_bytes() >= before
    assert peak_memory_bytes() > block.nbytes
    assert peak_memory_bytes() < 1 << 40


WORKERS = """
import time
from drsplat.field.tiles.launching import Processes
for _ in Processes(2).results(time.sleep, [0, 0, 600]):
    print("working", flush=True)
"""


def test_workers_end_with_a_killed_parent():
    """One is at work then, and one waits for some. They have its stdout, which ends with the last of them."""
    with subprocess.Popen([sys.executable, "-c", WORKERS], stdout=subprocess.PIPE, text=True) as parent:
        assert [parent.stdout.readline() for _ in range(2)] == ["working\n"] * 2
        parent.kill()
        assert parent.communicate(timeout=120)[0] == ""


def test_a_process_whose_parent_has_ended_before_it_began_to_look_ends():
    code = "import time; from drsplat.base.system import end_with; end_with(0); time.sleep(600)"
    assert subprocess.run([sys.executable, "-c", code], timeout=120, check=False).returncode == 1


@pytest.fixture
def windows(monkeypatch) -> list[tuple[int, int]]:
    """Its rules, as far as they can be had here: other locks, and no new name for an open file."""
    taken = []

    class Locks:
        LK_NBLCK = 2

        @staticmethod
        def locking(descriptor, how, length):
            if taken:
                raise PermissionError
            taken.append((how, length))

    monkeypatch.setitem(sys.modules, "msvcrt", Locks)
    monkeypatch.setattr(system, "fcntl", None)
    monkeypatch.setattr(system, "RENAMES_OPEN_FILES", False)
    return taken


def open_files(folder: Path) -> list[str]:
    """Of this process, under a folder."""
    if not Path("/proc/self/fd").is_dir():
        pytest.skip("no /proc to see open files in")
    return [
        name for name in map(str, (link.resolve() for link in Path("/proc/self/fd").iterdir())) if str(folder) in name
    ]


def test_a_file_is_closed_before_it_takes_its_name_there(windows, tmp_path, monkeypatch):
    seen = []
    replace = drsplat.formats.replacing.os.replace
    monkeypatch.setattr(
        drsplat.formats.replacing.os, "replace", lambda *names: (seen.append(open_files(tmp_path)), replace(*names))
    )
    with replacing(tmp_path / "a") as file:
        file.write(b"one")
    with together(), replacing(tmp_path / "b") as file:
        file.write(b"two")
    assert [(tmp_path / name).read_bytes() for name in "ab"] == [b"one", b"two"]
    assert seen == [[], []]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]


def test_one_writer_at_a_time_there(windows, tmp_path):
    with claimed_output(tmp_path / "out"):
        assert windows == [(2, 1)]
        assert json.loads((tmp_path / ".out.lock").read_text())["pid"] > 0
        with refused("is being written by process"), claimed_output(tmp_path / "out"):
            pass
    assert not list(tmp_path.iterdir())


def test_services_say_that_they_cannot_run_there(monkeypatch):
    monkeypatch.setattr(system, "WINDOWS", True)
    with refused("WSL"):
        require("serve")
