"""Files from strangers: only regular ones are opened, and what is small is not mapped."""

import os
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from drsplat import load_field, read_gaussians, read_views
from drsplat.base import contents
from drsplat.base.contents import file_bytes, pieces, release
from drsplat.errors import DrSplatError, FormatError, InputError
from drsplat.formats.json_files import read_json
from drsplat.formats.npy import map_npy
from drsplat.formats.tensors import map_tensors, write_tensors
from drsplat.scene.photos import photo_size


def test_small_files_are_read_and_large_ones_mapped(tmp_path, monkeypatch):
    path = tmp_path / "a.safetensors"
    tensors = {"x": np.arange(5000, dtype=np.float32)}
    write_tensors(path, tensors)
    read = map_tensors(path)[0]["x"]
    assert read.ctypes.data % 64 == 0
    os.truncate(path, 100)
    assert_array_equal(read, tensors["x"])  # a mapped one would end the process here
    write_tensors(path, tensors, overwrite=True)
    monkeypatch.setattr(contents, "MAX_READ_BYTES", 1000)
    mapped = map_tensors(path)[0]["x"]
    assert isinstance(mapped, np.memmap)
    assert_array_equal(mapped, read)
    for one in (read, mapped):
        assert not one.flags.writeable


def test_maps_pass_a_piece_at_a_time(tmp_path):
    path, numbers = tmp_path / "a", np.arange(3 << 20, dtype=np.int32)
    numbers.tofile(path)
    mapped = np.asarray(np.memmap(path, np.int32, "r"))[:-1]
    before, most = _mapped_bytes(), 0
    for at, piece in enumerate(pieces(mapped)):
        assert bytes(piece) == numbers[:-1].tobytes()[at << 20 : at + 1 << 20]
        most = max(most, _mapped_bytes() - before)
    assert most < 4 << 20  # of 12; where the system cannot tell, 0
    assert mapped.sum(dtype=np.int64) == numbers[:-1].sum(dtype=np.int64)
    release(mapped, numbers)
    assert _mapped_bytes() - before < 1 << 20
    assert_array_equal(mapped, numbers[:-1])


def _mapped_bytes() -> int:
    """Pages of files that this process has in memory."""
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.exists() else []
    return sum(int(line.split()[1]) << 10 for line in lines if line.startswith("RssFile"))


def test_a_file_that_shrinks_while_it_is_read(tmp_path, monkeypatch):
    path = tmp_path / "a"
    path.write_bytes(b"x" * 100)
    opened = contents.open_file

    def shrunk(*given):
        file = opened(*given)
        told = os.fstat(file.fileno())
        os.truncate(path, 10)
        monkeypatch.setattr(contents.os, "fstat", lambda _: told)
        return file

    monkeypatch.setattr(contents, "open_file", shrunk)
    with pytest.raises(FormatError, match="became shorter"):
        file_bytes(path)


def field_of(pipe: Path) -> object:
    folder = pipe.parent / "a.field"
    folder.mkdir()
    pipe.rename(folder / "field.json")
    return load_field(folder)


READERS = [
    file_bytes, map_tensors, map_npy, read_json, photo_size, field_of, read_gaussians, read_views,
]  # fmt: skip


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize("suffix", [".ply", ".splat", ".bin", ".txt"])
def test_pipes_are_refused_and_not_waited_for(read, suffix, tmp_path):
    path = tmp_path / f"cameras{suffix}"
    os.mkfifo(path)
    with pytest.raises(DrSplatError):
        read(path)


def test_folders_and_devices_are_no_files(tmp_path):
    for path in (tmp_path, Path("/dev/null")):
        with pytest.raises(InputError, match="expected a file"):
            file_bytes(path)
    with pytest.raises(InputError, match="no such file"):
        file_bytes(tmp_path / "none")


def test_what_is_no_photo_is_named_by_its_path(tmp_path):
    (tmp_path / "a.jpg").write_bytes(b"x")
    with pytest.raises(FormatError, match=r"a\.jpg: is no photo \(JPEG") as refused:
        photo_size(tmp_path / "a.jpg")
    assert "BufferedReader" not in str(refused.value)


@pytest.mark.parametrize("name", ["\ud800", "a\0b"])
def test_a_name_that_no_file_can_have_is_refused(name):
    with pytest.raises(InputError, match="no name that a file can have"):
        contents.open_file(name)
