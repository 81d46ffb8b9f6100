"""SOG: what the specification says comes back; what it cannot mean is refused before it unfolds."""

import io
import json
import struct
import tracemalloc
import zipfile
from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import drsplat as ds
from command_line import answer_of
from drsplat.formats.known import parse_gaussians
from refusing import malformed, refused
from scene_files import random_gaussians, sog_files, sog_plane, webp_bytes, zip_bytes

Files = dict[str, bytes]


def scene(degree: int = 3, n: int = 70) -> ds.Gaussians:
    return random_gaussians(np.random.default_rng(degree), n, degree)


def read(files: Files) -> ds.Gaussians:
    return parse_gaussians(memoryview(zip_bytes(files)))


def assert_close(found: ds.Gaussians, g: ds.Gaussians) -> None:
    """Half a step of each: of 1/65535, and of 1/255 of the range."""
    assert_allclose(found.means, g.means, atol=2e-4)
    assert_allclose(np.abs(np.einsum("ni,ni->n", found.quats, g.quats)), 1, atol=1e-4)
    assert_allclose(np.log(found.scales), np.log(g.scales), atol=5 / 255)
    assert_allclose(found.opacities, g.opacities, atol=0.006)
    assert_allclose(found.sh, g.sh, atol=1 / 255)


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("degree", range(4))
def test_a_scene_comes_back(version, degree):
    assert_close(read(sog_files(scene(degree), version)), scene(degree))


def test_a_folder_its_meta_and_an_archive_are_one_scene(tmp_path, capsys):
    files = sog_files(scene())
    (tmp_path / "room").mkdir()
    for name, content in files.items():
        (tmp_path / "room" / name).write_bytes(content)
    (tmp_path / "room.sog").write_bytes(zip_bytes(files))
    places = tmp_path / "room", tmp_path / "room" / "meta.json", tmp_path / "room.sog"
    prints = {ds.read_gaussians(place).fingerprint for place in places}
    assert len(prints) == 1
    for place in places:
        assert answer_of(capsys, "inspect", place)["kind"] == "scene"


def test_colours_of_what_is_transparent_are_kept():
    """An alpha of 0 is an opacity, no reason to lose the bytes beside it."""
    files = sog_files(scene(0))
    plane = np.arange(280).reshape(70, 4) % 251
    plane[:, 3] = 0
    found = read(files | {"sh0.webp": sog_plane(plane)})
    book = np.array(json.loads(files["meta.json"])["sh0"]["codebook"], np.float32)
    assert_array_equal(found.sh[:, 0], book[plane[:, :3]])
    assert (found.opacities == 0).all()


def changed(change: Callable[[dict], None], files: Files | None = None) -> Files:
    files = sog_files(scene()) if files is None else files
    meta = json.loads(files["meta.json"])
    change(meta)
    return files | {"meta.json": json.dumps(meta).encode()}


def put(*path: object) -> Callable[[dict], None]:
    *keys, last, value = path

    def change(meta: dict) -> None:
        for key in keys:
            meta = meta[key]
        meta[last] = value

    return change


HUGE = webp_bytes(np.zeros((4096, 4096, 4)))
QUATS = sog_plane(np.full((70, 4), 251))


@pytest.mark.parametrize(
    ("files", "said"),
    [
        (changed(put("version", 3)), "version 3"),
        (changed(put("version", True)), "version True"),
        (changed(put("count", 10**12)), "for 1000000000000 Gaussians"),
        (changed(put("count", -1)), "count of Gaussians, got -1"),
        (changed(put("count", 1)), "for 1 Gaussians"),
        (changed(put("count", 1.5)), "whole number"),
        (changed(put("means", "files", ["means_l.webp"])), "expected 2 files"),
        (changed(put("means", "mins", [0, 0])), "expected 3 numbers"),
        (changed(put("means", "maxs", [1e308, 0, 0])), "expected a finite number"),
        (changed(put("scales", "codebook", [0.0] * 255)), "256 numbers"),
        (changed(put("scales", "codebook", [float("nan")] * 256)), "finite"),
        (changed(put("quats", [])), "means, scales, quats and sh0"),
        (changed(put("quats", "files", ["../quats.webp"])), "beside meta"),
        (changed(put("quats", "files", ["/etc/passwd"])), "beside meta"),
        (changed(put("quats", "files", ["none.webp"])), "has no 'none.webp'"),
        (changed(put("shN", "bands", 4)), "1 to 3 bands"),
        (changed(put("shN", "bands", 2)), "for a palette of 70"),
        (changed(put("shN", "count", 65)), "names entry"),
        (changed(put("shN", "count", 129)), "for a palette of 129"),
        (changed(put("shN", "count", 10**9)), "65536 entries"),
        (sog_files(scene()) | {"quats.webp": QUATS}, "70 of 70 rows have rotations"),
        (sog_files(scene()) | {"quats.webp": b"RIFF"}, "is no WebP"),
        (sog_files(scene()) | {"quats.webp": HUGE}, "4096x4096 pixels for 70"),
        (sog_files(scene()) | {"meta.json": b"[" * 10**5}, "expected JSON"),
        (sog_files(scene()) | {"meta.json": b" " * (1 << 21)}, "decompression bomb"),
        (sog_files(scene()) | {str(k): b"" for k in range(5000)}, "5008 members"),
        (
            sog_files(scene()) | {"sh0.webp": webp_bytes(np.ones((10, 8, 4)) * 99, lossless=False)},
            "no lossless WebP",
        ),
    ],
)  # fmt: skip
def test_what_it_cannot_mean_is_refused(files, said):
    data = zip_bytes(files)
    tracemalloc.start()
    try:
        with malformed(said):
            parse_gaussians(memoryview(data))
        assert tracemalloc.get_traced_memory()[1] < (8 << 20) + 3 * len(data)
    finally:
        tracemalloc.stop()


def test_a_count_that_pictures_could_hold_but_nobody_stored():
    """All of one colour, sixteen million Gaussians fit into kilobytes."""
    files = {name: HUGE for name in sog_files(scene(0)) if name != "meta.json"}
    meta = changed(put("count", 4096 * 4096), sog_files(scene(0)))["meta.json"]
    with malformed("decompression bomb"):
        read({"meta.json": meta, **files})


def test_a_member_that_unfolds():
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in sog_files(scene()).items():
            archive.writestr(name, bytes(1 << 26) if name == "quats.webp" else content)
    with malformed("unfolds to more than"):
        parse_gaussians(memoryview(out.getvalue()))


def test_two_members_of_one_name_and_a_cut_archive():
    data = zip_bytes(sog_files(scene()))
    twice = data.replace(b"means_u.webp", b"means_l.webp")
    with malformed("each with its own"):
        parse_gaussians(memoryview(twice))
    with malformed("truncated"):
        parse_gaussians(memoryview(data[:-30]))
    end = data.rfind(b"PK\x05\x06")
    many = data[: end + 10] + struct.pack("<H", 60_000) + data[end + 12 :]
    with malformed("claims 60000 members"):
        parse_gaussians(memoryview(many))


def test_an_unpacked_scene_is_no_vocabulary(tmp_path):
    (tmp_path / "meta.json").write_bytes(sog_files(scene())["meta.json"])
    with malformed(r"meta\.json of an unpacked SOG, a scene"):
        ds.read_vocabulary(tmp_path / "meta.json")
    with malformed(r"no file 'means_l\.webp'"):
        ds.read_gaussians(tmp_path)
    (tmp_path / "means_l.webp").mkdir()
    with malformed(r"no file 'means_l\.webp'"):
        ds.read_gaussians(tmp_path / "meta.json")
    with refused("got an empty folder"):
        ds.read_gaussians(tmp_path / "means_l.webp")
