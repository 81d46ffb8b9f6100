"""Registration and objects of tiles on a Ray cluster: the same bits, whoever is killed."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from test_tiles import _dies_once, _fails, inputs

import drsplat as ds
from drsplat.errors import InputError
from drsplat.field.objects import finding
from drsplat.field.tiles import finding as in_tiles
from drsplat.field.tiles.cutting import cut
from drsplat.field.tiles.launching import Ray
from drsplat.field.tiles.registering import register_tiles
from drsplat.formats.sources import blocks_of
from drsplat.formats.tiles import read_tiles
from places import IMPORTED
from toy_capture import write_toy_capture

ray = pytest.importorskip("ray", reason="needs ray")
pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]  # of Ray's own


@pytest.fixture(scope="module")
def toy(tmp_path_factory) -> Path:
    folder = write_toy_capture(tmp_path_factory.mktemp("toy"))
    cut(blocks_of([folder / "scene.ply"]), folder / "scene.tiles", 37)
    return folder


@pytest.fixture(scope="module")
def cluster() -> Iterator[Ray]:
    """Two workers on this machine."""
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    tests = IMPORTED
    paths = os.pathsep.join([tests, str(Path(ds.__file__).parent.parent), os.environ.get("PYTHONPATH", "")])
    try:
        ray.init(
            address="local", num_cpus=2, include_dashboard=False, log_to_driver=False, object_store_memory=80 << 20,
            runtime_env={"env_vars": {"PYTHONPATH": paths}},
        )  # fmt: skip
    except (ConnectionError, RuntimeError, OSError) as error:
        pytest.skip(f"no Ray cluster can be started here: {error}")
    yield Ray("local")
    ray.shutdown()


def test_a_field_made_on_a_cluster_has_the_same_bits(toy, cluster, tmp_path):
    tiles = read_tiles(toy / "scene.tiles")
    views, features = inputs(toy)
    told = []
    how = {"parts": tmp_path / "parts", "launcher": cluster, "threads": 1}
    made = register_tiles(tiles, views, features, **how, tell=told.append)
    assert told[0].views == 4
    at_once = ds.register(tiles.gaussians(), views, features)
    made.to_field().save(tmp_path / "a.field")
    at_once.to_field().save(tmp_path / "b.field")
    assert list((tmp_path / "parts").glob("made/*.centroids.safetensors"))  # the codebook is trained there
    for file in sorted((tmp_path / "a.field").iterdir()):
        assert file.read_bytes() == (tmp_path / "b.field" / file.name).read_bytes(), file.name


def test_objects_found_on_a_cluster_have_the_same_bits(toy, cluster, tmp_path, monkeypatch):
    monkeypatch.setattr(finding, "MAX_WEIGHTS", 0)
    monkeypatch.setattr(finding, "BLOCK_WEIGHTS", 200)
    tiles = read_tiles(toy / "scene.tiles")
    views, features = inputs(toy)
    field = ds.register(tiles.gaussians(), views, features).to_field()
    parts = tmp_path / "parts"
    found = in_tiles.find_objects(field, tiles, parts=str(parts), views=views, launcher=cluster, threads=1)
    whole = finding.find_objects(field, tiles.gaussians(), views=views)
    for name, array in whole.tensors().items():
        assert array.tobytes() == found.tensors()[name].tobytes(), name
    kinds = {file.name.split(".")[1] for file in (parts / "objects").glob("*.safetensors")}
    assert kinds >= {"totals", "nodes", "sharing", "bordering", "growing", "summing", "describing"}


def test_a_killed_worker_is_replaced(cluster, tmp_path):
    items = [tmp_path / str(number) for number in range(4)]
    for item in items[1:]:
        item.touch()
    assert sorted(cluster.results(_dies_once, items)) == ["0", "1", "2", "3"]


def test_an_error_of_a_task_is_that_of_the_run(cluster):
    with pytest.raises(InputError, match="bad 1"):
        list(cluster.results(_fails, [1]))


class Remembering:
    """Work that knows which process it is in and how much it has done there."""

    def __init__(self) -> None:
        self.done = 0

    def __call__(self, item: int) -> tuple[int, int, int]:
        self.done += 1
        return item, os.getpid(), self.done


def test_a_worker_keeps_what_the_work_holds_from_task_to_task(cluster):
    for _ in range(2):  # other work is other work
        results = sorted(cluster.results(Remembering(), list(range(12))))
        assert [item for item, _, _ in results] == list(range(12))
        for worker in {pid for _, pid, _ in results}:
            counts = sorted(done for _, pid, done in results if pid == worker)
            assert counts == list(range(1, len(counts) + 1))
