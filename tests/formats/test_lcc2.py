"""LCC2 of XGRIDS: the leaves of the tree are the scene, z up is turned to y down; indices that lie are refused."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import drsplat as ds
from command_line import Capture, answer_of
from drsplat.errors import FormatError
from drsplat.formats.sog import parse_sog
from drsplat.formats.spz import parse_spz
from drsplat.scene.gaussians import Gaussians, concatenated
from foreign_programs import needs_node, needs_packages, splat_transform
from mutations import bounded_allocations, mutants, quota, seeded
from scene_files import random_gaussians, sog_files, spz_bytes, zip_bytes

COUNTS = (30, 40, 50, 12, 25)  # two leaves in one chunk, a leaf, a coarser node, environment


def parts(degree: int = 1) -> list[Gaussians]:
    return [random_gaussians(np.random.default_rng(number), count, degree) for number, count in enumerate(COUNTS)]


def encoded(gaussians: Gaussians, suffix: str) -> bytes:
    return zip_bytes(sog_files(gaussians)) if suffix == ".sog" else spz_bytes(gaussians, 3)


def node(chunk: int, start: int, count: int, child: object = None) -> dict[str, Any]:
    own = {"data": {"3dgs": {"name": chunk, "start": start, "count": count}}}
    return own if child is None else own | {"child": child}


def index_of(suffix: str = ".sog") -> dict[str, Any]:
    leaves = [node(1, 0, 30), {"child": None, **node(1, 30, 40)}]
    root = {
        "splatFiles": [f"data/3dgs/{number}{suffix}" for number in range(4)],
        "data": {"env": {"name": 3}},
        "child": {"0": node(0, 0, 7, leaves), "1": node(0, 7, 5, {"0": node(2, 0, 50)})},
    }
    splats = [120, 12]
    return {"totalSplats": 132, "lodSplats": splats, "totalLevels": 2, "splatType": suffix, "root": root}


def write_lcc2(folder: Path, suffix: str = ".sog", index: object = None, has_environment: bool = True) -> Path:
    """Write what XGRIDS' programs do, as far as the index of `index_of` says."""
    first, second, third, coarse, environment = parts()
    (folder / "data" / "3dgs").mkdir(parents=True)
    chunks = [coarse, concatenated([first, second]), third, environment]
    for number, chunk in enumerate(chunks[: 4 if has_environment else 3]):
        (folder / "data" / "3dgs" / f"{number}{suffix}").write_bytes(encoded(chunk, suffix))
    path = folder / "scene.lcc2"
    path.write_text(json.dumps(index_of(suffix) if index is None else index))
    return path


@pytest.mark.parametrize("suffix", [".sog", ".spz"])
@pytest.mark.parametrize("environment", [True, False])
def test_the_leaves_are_the_scene_turned_upright(suffix: str, environment: bool, tmp_path: Path) -> None:
    """A point (x, y, z) with z up is (x, -z, y) with y down."""
    first, second, third, _, far = parts()
    read = ds.read_gaussians(write_lcc2(tmp_path, suffix, has_environment=environment))
    shown = [first, second, third, *([far] if environment else [])]
    decode = parse_sog if suffix == ".sog" else parse_spz
    expected = concatenated([decode(memoryview(encoded(part, suffix))) for part in shown])
    x, y, z = expected.means.T
    assert_allclose(read.means, np.column_stack([x, -z, y]), atol=2e-4)  # chunks have boxes of their own
    assert_array_equal(read.opacities, expected.opacities)
    assert_allclose(read.covariances()[:, 5], expected.covariances()[:, 3], rtol=0.05, atol=1e-4)


def test_a_region_without_a_finer_level_is_there(tmp_path: Path) -> None:
    leaves = [node(1, 0, 30), node(1, 30, 40)]
    path = write_lcc2(tmp_path, index=changed(child=[node(0, 0, 12, leaves), node(2, 0, 50)]))
    assert len(ds.read_gaussians(path)) == 120 + COUNTS[-1]


def test_older_names_are_read(tmp_path: Path) -> None:
    path = write_lcc2(tmp_path)
    newer = ds.read_gaussians(path)
    index = index_of()
    names = [f"/{name.removesuffix('.sog')}" for name in index["root"].pop("splatFiles")]
    old = {"total_splats": 132, "lod_3dgs_info": [12, 120], "lod_level": 2, "root": {"files": names, **index["root"]}}
    path.write_text(json.dumps(old))
    assert_array_equal(ds.read_gaussians(path).means, newer.means)


def test_it_is_inspected(tmp_path: Path, capsys: Capture) -> None:
    facts = answer_of(capsys, "inspect", write_lcc2(tmp_path))
    assert (facts["kind"], facts["num_gaussians"]) == ("scene", 145)


@pytest.mark.oracle
@needs_node
@needs_packages("@playcanvas/splat-transform")
@pytest.mark.parametrize("suffix", [".sog", ".spz"])
def test_splat_transform_reads_it_as_we_do(suffix: str, tmp_path: Path) -> None:
    """It leaves the environment out, which comes last here."""
    path = write_lcc2(tmp_path, suffix)
    splat_transform("-O", 0, path, tmp_path / "theirs.ply")
    ours, theirs = ds.read_gaussians(path), ds.read_gaussians(tmp_path / "theirs.ply")
    ours = ours.subset(np.arange(120))
    assert len(theirs) == 120
    assert_allclose(ours.means, theirs.means, atol=1e-5)
    for name in ("scales", "opacities", "sh"):
        assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-5, atol=1e-5)
    assert_allclose(np.abs(np.einsum("ij,ij->i", ours.quats, theirs.quats)), 1, atol=1e-5)


def changed(**root: object) -> dict[str, Any]:
    index = index_of()
    return index | {"root": index["root"] | root}


DEEP: dict[str, Any] = node(1, 0, 70)
for _ in range(70):
    DEEP = {"child": [DEEP]}


@pytest.mark.parametrize(
    ("index", "said"),
    [
        ([], "with a root"),
        ({"root": 3}, "with a root"),
        (changed(splatFiles="a.sog"), "list of names"),
        (changed(splatFiles=["../a.sog"] * 4), "in this folder"),
        (changed(splatFiles=["/etc/passwd"] * 4), "in this folder"),
        (changed(splatFiles=["data"] * 4), "no chunk 'data'"),
        (changed(splatFiles=["data/3dgs/9.sog"] * 4), "no chunk"),
        (index_of() | {"splatType": ".ply"}, "expected .sog or .spz"),
        (index_of() | {"splatType": []}, "expected .sog or .spz"),
        (changed(child=3), "list or an object"),
        (changed(child=[3]), "expected nodes"),
        (changed(child=[DEEP]), "64 deep"),
        (changed(child=[]), "no leaf"),
        (changed(child=[{"data": {}}]), "no leaf"),
        (changed(child=[node(9, 0, 5)]), "chunk 9, there are 4"),
        (changed(child=[node(-1, 0, 5)]), "0 or more"),
        (changed(child=[node(1, 0, 71)]), "70 Gaussians, the tree says 71"),
        (changed(child=[{"data": {"3dgs": 4}}]), "expected a number"),
        (changed(data={"env": {"name": "x"}}), "expected a number"),
    ],
)
def test_indices_that_lie(index: object, said: str, tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=said):
        ds.read_gaussians(write_lcc2(tmp_path, index=index))


@pytest.mark.slow
def test_damaged_files_are_refused_or_read(tmp_path: Path) -> None:
    path, rng = write_lcc2(tmp_path), seeded(51)
    chunk = path.parent / "data" / "3dgs" / "2.sog"
    read = refused = 0
    with bounded_allocations(64 << 20):
        for file, count in ((path, quota(400)), (chunk, quota(100))):
            good = file.read_bytes()
            for damaged in mutants(good, rng, count):
                file.write_bytes(damaged)
                try:
                    assert np.isfinite(ds.read_gaussians(path).means).all()
                    read += 1
                except FormatError:
                    refused += 1
            file.write_bytes(good)
    assert min(read, refused) > 20


def test_chunks_of_fewer_harmonics_are_filled_up(tmp_path: Path) -> None:
    path = write_lcc2(tmp_path)
    bare = replace(parts()[2], sh=parts()[2].sh[:, :1])
    (path.parent / "data" / "3dgs" / "2.sog").write_bytes(encoded(bare, ".sog"))
    read = ds.read_gaussians(path)
    assert read.sh_degree == 1
    assert not read.sh[70:120, 1:].any()
