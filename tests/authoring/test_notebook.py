"""What a notebook shows of scenes and answers, and what other libraries take of them."""

import sys
from html.parser import HTMLParser
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import drsplat as ds
from drsplat.authoring.exchange.clouds import COLUMNS, from_splats, to_boxes, to_frame, to_point_cloud, to_splats
from drsplat.errors import MissingExtraError
from drsplat.field.objects.choosing import Tree
from drsplat.field.objects.describing import describe
from refusing import malformed, refused
from toy_capture import PER_THING, write_toy_capture


@pytest.fixture(scope="module")
def registration(tmp_path_factory) -> ds.Registration:
    folder = write_toy_capture(tmp_path_factory.mktemp("notebook"))
    features = ds.read_features(folder / "capture/language_features", encoder=ds.WordEncoder().identity)
    return folder, ds.register(ds.read_gaussians(folder / "scene.ply"), ds.read_views(folder / "capture"), features)


@pytest.fixture(scope="module")
def scene(registration) -> ds.Scene:
    folder, registered = registration
    field, gaussians = registered.to_field(), ds.read_gaussians(folder / "scene.ply")
    node_of = (field.gaussian_ids // PER_THING).astype(np.int32)
    tree = Tree(node_of, np.full(2, -1, np.int32), np.ones(2, np.uint8), np.ones(2, np.float32))
    return ds.Scene(field.with_objects(describe(field, gaussians, tree)), gaussians, ds.read_views(folder / "capture"))


class Tags(HTMLParser):
    """Open tags; texts of cells."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open, self.cells, self.pictures = [], [], 0
        self.feed(text)

    def handle_starttag(self, tag, attrs) -> None:
        self.pictures += tag == "img"
        self.open += [tag] if tag != "img" else []

    def handle_endtag(self, tag) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data) -> None:
        self.cells.append(data)


def shown(thing: object) -> Tags:
    tags = Tags(thing._repr_html_())
    assert tags.open == []
    return tags


def test_a_notebook_shows_small_tables(scene, registration):
    assert "none" in shown(registration[1]).cells  # left out
    assert f"{len(scene.field):,} of {len(scene.gaussians):,}" in shown(scene.field).cells
    objects = shown(scene.field.objects)
    assert "agreement" in objects.cells
    assert objects.cells.count("1.00") >= 2
    assert shown(scene).pictures == 1


def test_an_answer_is_shown_with_its_picture(scene):
    answer = scene.ask("red mug")
    assert shown(answer).pictures == 1
    picture = answer.show()
    assert picture.mode == "RGB"
    assert_array_equal(np.asarray(picture), scene.picture(shown=answer, max_side=640))
    nothing = answer.cut_at(2.0)
    assert shown(nothing).pictures == 0


def test_an_answer_of_a_field_alone_has_no_picture(scene):
    answer = ds.Answer.of(scene.field, np.zeros(len(scene.field), np.float32), 0.5)
    assert shown(answer).pictures == 0
    with refused("ask a scene"):
        answer.show()
    assert shown(ds.Scene(scene.field).ask("red mug")).pictures == 0


def test_names_of_strangers_are_no_html(scene):
    named = ds.Scene(scene.field, scene.gaussians, name="<script>x</script>")
    assert "<script>" not in named._repr_html_()


def test_gsplat_dictionaries_and_back(scene):
    torch = pytest.importorskip("torch", reason="torch is not installed")
    splats = to_splats(scene.gaussians)
    assert list(splats) == ["means", "quats", "scales", "opacities", "sh0", "shN"]
    assert splats["shN"].shape == (len(scene.gaussians), scene.gaussians.sh.shape[1] - 1, 3)
    back = from_splats({name: torch.nn.Parameter(value) for name, value in splats.items()})
    for name in ("means", "quats", "scales", "opacities", "sh"):
        assert_allclose(getattr(back, name), getattr(scene.gaussians, name), rtol=1e-5, atol=1e-6)
    del splats["sh0"]
    with malformed("no sh0"):
        from_splats(splats)


def test_a_table_for_pandas(scene):
    pytest.importorskip("pandas", reason="pandas is not installed")
    matches = scene.locate("red mug")
    frame = to_frame(matches)
    assert list(frame.columns) == COLUMNS
    assert_allclose(frame[["x", "y", "z"]].to_numpy(), [match.center for match in matches])
    assert len(to_frame([])) == 0


@pytest.fixture
def open3d(monkeypatch):
    """Its three names that are used, where it is not installed: it is as large as everything else together."""
    made = SimpleNamespace(
        geometry=SimpleNamespace(PointCloud=SimpleNamespace, OrientedBoundingBox=lambda *parts: parts),
        utility=SimpleNamespace(Vector3dVector=lambda values: np.array(values)),
    )
    monkeypatch.setitem(sys.modules, "open3d", made)


def test_point_clouds_and_boxes_for_open3d(scene, open3d):
    ids = scene.ask("red mug").gaussian_ids
    cloud = to_point_cloud(scene.gaussians, ids)
    assert_allclose(cloud.points, scene.gaussians.positions[ids])
    assert cloud.colors.shape == (len(ids), 3)
    assert ((cloud.colors >= 0) & (cloud.colors <= 1)).all()
    (center, rotation, extent), *_ = to_boxes(scene.locate("red mug"))
    assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) > 0
    inside = np.abs((scene.gaussians.positions[ids] - center) @ rotation) <= extent / 2 * 1.2
    assert inside.mean() > 0.8
    with refused("one per point"):
        to_point_cloud(scene.gaussians, colors=np.zeros((1, 3), np.float32))


@pytest.mark.parametrize(("name", "act"), [("open3d", to_boxes), ("pandas", to_frame)])
def test_what_is_not_installed_is_said(name, act, monkeypatch):
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(MissingExtraError, match="pip install"):
        act([])
