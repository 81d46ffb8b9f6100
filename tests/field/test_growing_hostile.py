"""Files of growth from strangers: read, refused or used, never believed."""

import json
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import load, save

from drsplat import load_field
from drsplat.errors import DrSplatError
from drsplat.field.codes import PQ, Mixture
from drsplat.field.growing import add_views, remove_views
from fields import unchecked, without_checksums
from growing_fields import at_once, features, files_of, scene, views
from mutations import quota, seeded, survivors
from refusing import malformed

NAMES = tuple(view.name for view in views())
MUTANTS = quota(150)
ABOUT = {"isa": "avx2", "level": None, "code": {"kind": "codebook"}, "removed": []}


@lru_cache
def files(mixture: bool) -> dict[str, bytes]:
    """Of a field whose growth has no checksums."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.field"
        at_once(NAMES[:5], Mixture(2) if mixture else PQ(4)).save(path)
        without_checksums(path / "growth.safetensors")
        return files_of(path)


@pytest.fixture(autouse=True)
def no_checksums(monkeypatch) -> None:
    unchecked(monkeypatch)


def write(folder: Path, mixture: bool) -> Path:
    path = folder / "a.field"
    path.mkdir(exist_ok=True)
    for name, content in files(mixture).items():
        (path / name).write_bytes(content)
    return path


@pytest.mark.slow
@pytest.mark.parametrize("mixture", [False, True])
def test_mutants_are_refused_or_used(mixture, tmp_path):
    def use(file):
        field = load_field(file.parent)
        grown = add_views(field, scene(), views()[5:6], features()).field
        assert len(remove_views(grown, scene(), NAMES[:2]).field) > 0

    file = write(tmp_path, mixture) / "growth.safetensors"
    assert 0 < survivors(file, use, seeded(11 + mixture), MUTANTS) < MUTANTS


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("growth", None, "growth: expected an object"),
        ("growth", ABOUT | {"code": {"kind": "mixture", "atoms": -1}}, "code: expected counts of 1 or more"),
        ("growth", ABOUT | {"code": {"kind": "other"}}, "code: expected 'pq', 'mixture', 'auto' or 'codebook'"),
        ("growth", ABOUT | {"isa": 3}, "isa: expected a text"),
        ("growth", ABOUT | {"level": []}, "level: expected a text"),
        ("growth", ABOUT | {"removed": [1]}, "removed: 0: expected a text"),
    ],
)
def test_manifests_that_do_not_say_how_it_was_made(name, value, said, tmp_path):
    path = write(tmp_path, True)
    manifest = json.loads((path / "field.json").read_text())
    (path / "field.json").write_text(json.dumps(manifest | {name: value}))
    field = load_field(path)
    assert field.scores(np.ones(8, np.float32)).shape == (len(field),)  # a search does not ask
    with malformed(said):
        _ = field.growth


def with_tensors(path: Path, change: Callable[[dict[str, np.ndarray]], object], **about: str) -> None:
    """Change the arrays and the metadata of a growth's file, which has no checksums."""
    file = path / "growth.safetensors"
    tensors = load(file.read_bytes())
    with safe_open(file, "numpy") as opened:
        metadata = opened.metadata() | about
    change(tensors)
    file.write_bytes(save(tensors, metadata))


@pytest.mark.parametrize(
    ("name", "changed", "said"),
    [
        ("rest_ids", lambda ids: ids[::-1], "rest_ids: expected ascending"),
        ("rest_ids", lambda ids: np.append(ids[:-1], np.uint32(10**6)), "further rows of a scene of"),
        ("rest_data", lambda data: -data, "rest: expected finite weights of 0 or more"),
        ("rest_data", lambda data: np.full_like(data, np.inf), "rest: expected finite weights of 0 or more"),
        ("rest_indices", lambda columns: columns - columns.max() - 1, "rest: expected finite weights"),
        ("rest_indices", lambda columns: columns + 10_000, "rest: column"),
        ("rest_indptr", lambda starts: starts + 1, "row starts do not fit"),
        ("rest_indptr", lambda starts: np.append(starts[:1], starts[:-1]), "row starts do not fit"),
        ("rest_indptr", lambda starts: starts[[0, -1]], "rest: expected .* rows, got 1"),
        ("scene_members", lambda members: members + 10_000, "scene_members: expected numbers among"),
        ("scene_centres", lambda centres: centres * np.nan, "scene_centres: expected finite numbers"),
        ("scene_places", lambda places: places[1:], "scene atoms, of which the code has others"),
    ],
)
def test_arrays_that_do_not_fit_each_other(name, changed, said, tmp_path):
    path = write(tmp_path, True)
    with_tensors(path, lambda tensors: tensors.update({name: np.ascontiguousarray(changed(tensors[name]))}))
    with pytest.raises(DrSplatError, match=said):
        _ = load_field(path).growth


@pytest.mark.parametrize("names", ["", "{}", "[1]", "[" * 100_000])
def test_names_of_views_that_are_none(names, tmp_path):
    path = write(tmp_path, True)
    with_tensors(path, lambda _: None, learnt_from=names)
    with malformed(r"growth|learnt_from"):
        _ = load_field(path).growth


def test_a_missing_or_foreign_file_is_told(tmp_path):
    path = write(tmp_path, True)
    (path / "growth.safetensors").unlink()
    with malformed(r"there is no growth\.safetensors"):
        load_field(path)
    (path / "growth.safetensors").write_bytes(files(False)["growth.safetensors"])
    with pytest.raises(DrSplatError, match="was written with another field"):
        _ = load_field(path).growth
