"""Damaged and hostile scene files: sound Gaussians or a precise error, and nothing else."""

import gc
import gzip
import struct
import tracemalloc
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import zstandard
from numpy.random import default_rng

import glb_files
import scene_files
from drsplat.errors import DrSplatError, DrSplatWarning, FormatError
from drsplat.formats.glb import names_in_glb
from drsplat.formats.known import parse_gaussians, write_scene
from drsplat.formats.scenes import read_gaussians
from drsplat.scene.gaussians import Gaussians
from drsplat.scene.labelled import LabelledScene, Thing
from mutations import mutants, quota, seeded
from refusing import malformed
from scene_files import random_gaussians

MUTANTS = quota(5_200)  # of each family


def seeds(family: str) -> list[tuple[bytes, str]]:
    """Good files of a family, with the suffix they are read under."""
    scenes = [random_gaussians(default_rng(d), 20 + 4 * d, d) for d in range(4)]
    match family:
        case "ply":
            columns = [scene_files.ply_columns(g) for g in scenes]
            columns[1] |= {"object_id": np.arange(24, dtype=np.int32), "nx": np.ones(24, np.float32)}
            lists = "element face 2\nproperty list uchar int vertex_indices"
            before = bytes([1, 0, 0, 0, 0, 1, 1, 0, 0, 0])
            files = [scene_files.ply_bytes(c, order) for c in columns[::3] for order in "<>"]
            files += [scene_files.ply_bytes(columns[1], "a")]
            files += [scene_files.ply_bytes(columns[1], "<", before, lists)]
            files += [scene_files.ply_bytes({name: own for name, own in columns[2].items() if name != "scale_2"})]
        case "compressed":
            files = [scene_files.compressed_ply_bytes(g) for g in scenes]
            files += [scene_files.compressed_ply_bytes(random_gaussians(default_rng(9), 257, 1))]
        case "splat":
            return [(scene_files.splat_bytes(g), ".splat") for g in scenes]
        case "ksplat":
            made = [([g], 0) for g in scenes[:3]] + [(scenes[:3], level) for level in (1, 2)]
            return [(scene_files.ksplat_bytes(parts, level), ".ksplat") for parts, level in made]
        case "sog":
            made = [scene_files.sog_files(g, v) for g in scenes[:2] for v in (1, 2)]
            return [(scene_files.zip_bytes(files), ".sog") for files in made]
        case "glb":
            files = [glb_files.glb_bytes(g) for g in scenes[::3]]
            files += [glb_files.small_glb_bytes(scenes[1])]
            files += [glb_files.spz_glb_bytes(g, scene_files.spz_bytes(g, 3)) for g in scenes[:2]]
            files += [labelled_glb(scenes[1])]
            return [(data, ".glb") for data in files]
        case _:
            files = [scene_files.spz_bytes(g, v) for g in scenes[::3] for v in (2, 3, 4)]
            extension = struct.pack("<III", 0xADBE0003, 4, 6)
            files += [scene_files.spz_bytes(scenes[1], v, 2, extension) for v in (3, 4)]
    return [(data, ".spz" if family == "spz" else ".ply") for data in files]


def labelled_glb(g: Gaussians) -> bytes:
    """With objects, a table of their names and nodes, as it is written."""
    thing = Thing("red mug", 0.5, np.zeros(3), np.eye(3), np.ones(3), 0)
    owners = (np.arange(len(g)) % 3 - 1).astype(np.int32)
    scene = LabelledScene(g, "room", (thing, thing), (thing,), owners, "mug", g.opacities, (thing,))
    with TemporaryDirectory() as folder:
        write_scene(Path(folder) / "scene.glb", scene)
        return (Path(folder) / "scene.glb").read_bytes()


def outcome(data: bytes, suffix: str) -> Gaussians | DrSplatError:
    try:
        return parse_gaussians(memoryview(data), suffix)
    except DrSplatError as error:
        return error


def assert_sound(g: Gaussians, size: int) -> None:
    assert len(g) * 8 <= (1 << 20) + 100 * size
    assert np.isfinite(g.means).all()
    assert np.isfinite(g.sh).all()
    assert ((g.scales > 0) & (g.scales < np.inf)).all()
    assert ((g.opacities >= 0) & (g.opacities <= 1)).all()
    assert (np.abs(np.linalg.norm(g.quats, axis=1) - 1) < 1e-5).all()


@pytest.mark.slow
@pytest.mark.parametrize("family", ["ply", "compressed", "splat", "spz", "sog", "ksplat", "glb"])
@pytest.mark.usefixtures("bounded_memory")
def test_mutants(family) -> None:
    rng = seeded(1, *family.encode())
    originals = seeds(family)
    read = refused = 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DrSplatWarning)
        for data, suffix in originals:
            assert isinstance(outcome(data, suffix), Gaussians)
            for mutant in mutants(data, rng, MUTANTS // len(originals)):
                result = outcome(mutant, suffix)
                if isinstance(result, Gaussians):
                    assert_sound(result, len(mutant))
                    read += 1
                else:
                    assert isinstance(result, FormatError)
                    refused += 1
    assert read + refused >= 5_000
    assert min(read, refused) > 250


def test_planes_of_spz_4_under_sound_streams(bounded_memory):
    """Damage below the compression: any bytes are some scene, or rows that are refused."""
    rng = default_rng(3)
    g = random_gaussians(rng, 16, 1)
    for _ in range(150):
        planes = [rng.bytes(len(p)) for p in scene_files.spz_planes(g, 4)]
        data = struct.pack("<4sIIBBB", b"NGSP", 4, 16, 1, 12, 0) + scene_files.v4_body(planes)
        result = outcome(data, ".spz")
        assert isinstance(result, Gaussians)
        assert_sound(result, len(data))


def gzip_bomb(count: int) -> bytes:
    """An SPZ 3 of `count` equal Gaussians: honest about its size, and 1000 times smaller."""
    return gzip.compress(struct.pack("<4sIIBBBx", b"NGSP", 3, count, 0, 12, 0) + bytes(20 * count))


def zstd_bomb(count: int, with_size: bool) -> bytes:
    sizes = (9, 1, 3, 3, 4)
    compressor = zstandard.ZstdCompressor(write_content_size=with_size)
    streams = [compressor.compress(bytes(size * count)) for size in sizes]
    head = struct.pack("<4sIIBBBBI12x", b"NGSP", 4, count, 0, 12, 0, 5, 32)
    pairs = zip(streams, sizes, strict=True)
    table = b"".join(struct.pack("<QQ", len(s), size * count) for s, size in pairs)
    return head + table + b"".join(streams)


def lying_zstd(count: int) -> bytes:
    """A header of `count` Gaussians over streams that hold far more."""
    data = bytearray(zstd_bomb(2_000_000, with_size=False))
    data[8:12] = struct.pack("<I", count)
    for i, size in enumerate((9, 1, 3, 3, 4)):
        data[40 + 16 * i : 48 + 16 * i] = struct.pack("<Q", size * count)
    return bytes(data)


def claiming_ply(count: int) -> bytes:
    data = scene_files.ply_bytes(scene_files.ply_columns(random_gaussians(default_rng(0), 4)))
    return data.replace(b"element vertex 4", b"element vertex %d" % count)


def list_ply(length: int) -> bytes:
    header = "element face 1000000000000\nproperty list uint double vertex_indices"
    columns = scene_files.ply_columns(random_gaussians(default_rng(0), 4))
    return scene_files.ply_bytes(columns, "<", struct.pack("<I", length), header)


@pytest.mark.slow
@pytest.mark.parametrize(
    "data",
    [
        pytest.param(gzip_bomb(2_000_000), id="gzip"),
        pytest.param(gzip_bomb(2_000_000)[:-9], id="gzip-truncated"),
        pytest.param(zstd_bomb(2_000_000, True), id="zstd"),
        pytest.param(zstd_bomb(2_000_000, False), id="zstd-without-size"),
        pytest.param(lying_zstd(1000), id="zstd-larger-than-told"),
        pytest.param(claiming_ply(10**17), id="ply-count"),
        pytest.param(claiming_ply(10**9), id="ply-count-gigabytes"),
        pytest.param(claiming_ply(2**63), id="ply-count-overflow"),
        pytest.param(claiming_ply(10**9).replace(b"binary_little_endian", b"ascii"), id="ply-ascii-count"),
        pytest.param(list_ply(2**32 - 1), id="ply-list-length"),
        pytest.param(list_ply(0), id="ply-list-count"),
        pytest.param(b"ply\nformat ascii 1.0\n" + b"comment a\n" * 400_000, id="ply-endless-header"),
    ],
)
def test_bombs_are_refused_before_they_unfold(data):
    gc.collect()
    tracemalloc.start()
    try:
        with pytest.raises(FormatError):
            parse_gaussians(memoryview(data))
        assert tracemalloc.get_traced_memory()[1] < 4 << 20
    finally:
        tracemalloc.stop()


def test_error_names_the_file_and_leaves_it_closed(tmp_path):
    path = tmp_path / "scene.ply"
    path.write_bytes(claiming_ply(5))
    with malformed(r"scene\.ply: PLY is truncated.*5 rows of 'vertex'"):
        read_gaussians(path)


def test_mutants_are_reproducible_and_differ():
    data = seeds("ply")[0][0]
    first, second = (list(mutants(data, default_rng(5), 300)) for _ in range(2))
    assert first == second
    assert len(set(first)) > 250
    assert sum(mutant != data for mutant in first) > 280


@pytest.mark.slow
def test_errors_within_a_table_leave_nothing_that_cannot_be_collected():
    """An SPZ 4 refused at its second stream, many times, with the errors kept in cycles."""
    scene = random_gaussians(default_rng(0), 20, 1)
    damaged = bytearray(scene_files.spz_bytes(scene, 4))
    table = struct.unpack_from("<I", damaged, 16)[0]
    struct.pack_into("<Q", damaged, table + 24, 1)  # the size that the second stream promises
    for _ in range(200):
        holder = {}
        try:
            parse_gaussians(memoryview(bytes(damaged)), ".spz")
        except FormatError as error:
            holder["error"], holder["self"] = error, holder
    gc.collect()
    assert isinstance(holder["error"], FormatError)


@pytest.mark.slow
def test_damaged_tables_of_names(tmp_path, bounded_memory):
    data, rng, path = labelled_glb(random_gaussians(default_rng(0), 20, 0)), seeded(7), tmp_path / "a.glb"
    read = refused = 0
    for mutant in mutants(data, rng, quota(1500)):
        path.write_bytes(mutant)
        try:
            assert all(isinstance(name, str) for _, name in names_in_glb(path))
            read += 1
        except FormatError:
            refused += 1
    assert min(read, refused) > 100
