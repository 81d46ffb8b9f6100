"""The household world (world/): things, looks, rooms, cameras, layouts. Only the last tests render."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image, ImageDraw
from scipy.ndimage import binary_fill_holes
from world import contours, layouts, looks, meshes, scan, textures
from world.cameras import is_free, views_of
from world.render import Shot
from world.rooms import Room, make_room, overlap
from world.things import CATALOGUE, make

import drsplat as ds
from drsplat.formats.lerf_ovs import fill_polygon, read_lerf_labels
from drsplat.formats.scannet import read_scannet_labels

SPLITS = (looks.TRAIN, looks.TEST)
# the longest side of each thing, in metres
LENGTHS = {
    "kitchen": (0.05, 0.45), "food": (0.05, 0.32), "toys": (0.06, 0.4), "decor": (0.08, 1.3), "furniture": (0.3, 2.1),
}  # fmt: skip


def room(seed: int = 1) -> Room:
    return make_room(looks.TEST, seed)


@pytest.mark.parametrize("split", SPLITS, ids=lambda split: split.name)
@pytest.mark.parametrize("kind", CATALOGUE)
def test_things_are_sound_stand_on_the_floor_have_their_size_and_wear_their_splits_textures(kind, split):
    """Of a closed surface that looks outwards the signed volume is positive; `ball`'s two skins are closed together."""
    least, most = LENGTHS[CATALOGUE[kind].__module__.rsplit(".", 1)[1]]
    bits = []
    for seed in (0, 1, 1):
        thing = make(kind, split, seed)
        low, high = thing.bounds
        assert_allclose([low[2], *(low + high)[:2]], 0, atol=1e-9)
        assert least < thing.size.max() < most
        assert thing.color in looks.COLORS
        solids = [part.mesh for part in thing.parts]
        textured = [part.look.texture for part in thing.parts if part.look.texture is not None]
        for mesh in [meshes.joined(*solids)] if kind == "ball" else solids:
            assert np.isfinite(mesh.uv).all()
            assert meshes.areas(mesh.vertices, mesh.faces).min() > 0
            assert meshes.volume(mesh) > 0
            assert is_closed(mesh)
        assert {part.look.material for part in thing.parts} <= {*looks.MATERIALS}
        assert {texture.family for texture in textured} <= {f for families in split.families.values() for f in families}
        arrays = [a for mesh in solids for a in (mesh.vertices, mesh.faces, mesh.uv)]
        bits.append(b"".join(array.tobytes() for array in (*arrays, *(texture.bitmap for texture in textured))))
    assert bits[0] != bits[1] == bits[2]


def is_closed(mesh: meshes.Mesh) -> bool:
    """Every directed edge has its opposite, once the points are welded."""
    welded = np.unique(np.round(mesh.vertices, 7), axis=0, return_inverse=True)[1].reshape(-1)
    faces = welded[mesh.faces]
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = edges[edges[:, 0] != edges[:, 1]]
    both = [np.unique(e, axis=0, return_counts=True) for e in (edges, edges[:, ::-1])]
    return all(np.array_equal(a, b) for a, b in zip(*both, strict=True))


def test_splits_share_neither_seeds_nor_textures():
    assert looks.TRAIN.last <= looks.TEST.first
    for use in looks.TRAIN.families:
        assert not set(looks.TRAIN.families[use]) & set(looks.TEST.families[use])
    named = [f for split in SPLITS for families in split.families.values() for f in families]
    assert sorted(named) == sorted(textures.PATTERNS)
    assert looks.TRAIN.rng(0).random() != looks.TEST.rng(0).random()
    with pytest.raises(ValueError, match=r"split 'train': expected a seed in 0\.\.999999"):
        looks.TRAIN.rng(1_000_000)


def test_names_of_colours_hold_their_shades_apart():
    """A shade is nearer to an anchor of its own name than to those of any other."""
    rng = default_rng(0)
    for word in looks.COLORS:
        for _ in range(40):
            shade = 255 * np.array(looks.color(rng, word).rgb)
            away = {w: np.linalg.norm(np.array(a) - shade, axis=1).min() for w, a in looks.COLORS.items()}
            assert min(away, key=lambda w: away[w]) == word


@pytest.mark.parametrize("seed", range(3))
def test_rooms_have_no_overlaps_and_nothing_floats(seed):
    """What stands on a ledge lies within its host. The same seed makes the same room."""
    made = room(seed)
    assert 8 <= len({o.thing.name for o in made.objects}) <= len(made.objects) <= 20
    hosts = [o for o in made.objects if o.thing.ledges]
    heights = [0.0, *(ledge.z for host in hosts for ledge in host.thing.ledges)]
    for k, one in enumerate(made.objects):
        assert (np.abs(one.footprint) <= np.array(made.size) / 2).all()
        height = one.position[2]
        assert min(abs(height - z) for z in heights) < 1e-9
        assert height == 0 or any(_within(one.footprint, host.footprint) for host in hosts)
        for other in made.objects[:k]:
            assert height != other.position[2] or not overlap(one.footprint, other.footprint, 0.0)
            if one.thing.name == other.thing.name and height > 0 < other.position[2]:
                assert one.thing.color != other.thing.color
    places, same, others = ([o.position for o in r.objects] for r in (made, room(seed), room(seed + 1)))
    assert places == same != others


def _within(inner: np.ndarray, outer: np.ndarray) -> bool:
    axes = np.stack([outer[1] - outer[0], outer[3] - outer[0]])
    share = (inner - outer[0]) @ axes.T / (axes**2).sum(1)
    return bool((share > -1e-9).all() and (share < 1 + 1e-9).all())


@given(st.floats(0, 360), st.floats(-3, 3), st.floats(-3, 3))
def test_squares_overlap_where_their_inner_circles_do_and_not_where_their_outer_ones_do_not(degrees, x, y):
    square = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    other = square @ meshes.turn("z", degrees)[:2, :2].T + [x, y]
    if not 2 <= np.hypot(x, y) <= 2 * np.sqrt(2):
        assert overlap(square, other, 0.0) == (np.hypot(x, y) < 2)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_cameras_stand_free_and_see_things(seed):
    made = room(seed)
    views = views_of(made, 20, (320, 240), looks.TEST.rng(seed, 300))
    assert len({view.name for view in views}) == 20
    centers = np.array([o.center for o in made.objects])
    for view in views:
        assert is_free(made, view.center, 0.1)
        pixels = (centers @ view.cam_from_world[:3, :3].T + view.cam_from_world[:3, 3]) @ view.K.T
        inside = (np.abs(pixels[:, :2] / pixels[:, 2:] - [160, 120]) < [160, 120]).all(1)
        assert (inside & (pixels[:, 2] > 0)).sum() >= 2


@given(st.integers(0, 10_000))
def test_polygons_fill_to_their_mask(seed):
    rng = default_rng(seed)
    canvas = Image.new("1", (60, 50))
    for x, y, w, h in rng.integers(0, 30, (rng.integers(1, 4), 4)).tolist():
        ImageDraw.Draw(canvas).ellipse((x, y, x + w + 4, y + h + 4), fill=1)
    mask = np.array(canvas)
    filled = np.any([fill_polygon(np.array(polygon), 60, 50) for polygon in contours.polygons(mask)], axis=0)
    assert not (mask & ~filled).any()
    assert not (filled & ~binary_fill_holes(mask)).any()


@pytest.mark.parametrize("turned", [False, True])
def test_a_strip_one_pixel_wide_has_three_corners_as_labels_need(turned):
    mask = np.zeros((20, 20), np.bool_)
    mask[4, 3:17] = True
    (corners,) = contours.polygons(mask.T if turned else mask)
    assert len(corners) == 3
    assert {tuple(corner[::-1] if turned else corner) for corner in corners} == {(3, 4), (16, 4)}


def painted_shots(made: Room, count: int = 6) -> list[Shot]:
    """Shots without a renderer: discs where the things' centres are, at their depth."""
    shots = []
    for view in views_of(made, count, (96, 72), default_rng(0)):
        ids, depth = (np.full((72, 96), len(made.objects), np.int32), np.full((72, 96), 5.0, np.float32))
        rows, columns = np.mgrid[0:72, 0:96]
        for k, placed in enumerate(made.objects):
            x, y, z = view.cam_from_world[:3, :3] @ placed.center + view.cam_from_world[:3, 3]
            if z > 0.2:
                u, v = view.K[0, 0] * x / z + 48, view.K[1, 1] * y / z + 36
                disc = (np.hypot(columns + 0.5 - u, rows + 0.5 - v) < 6) & (z < depth)
                ids[disc], depth[disc] = k, z
        image = ((ids[..., None] * [37, 91, 151]) % 256).astype(np.uint8)
        shots.append(Shot(view, image, ids, depth))
    return shots


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Room, list[Shot]]:
    folder, made = tmp_path_factory.mktemp("world") / "scene", room(1)
    shots, rng = painted_shots(made), default_rng(0)
    points = scan.from_depth(shots, 600, rng)
    layouts.write_truth(folder, made, shots, {"seed": 1})
    layouts.write_lerf(folder / "lerf_ovs", "s", made, shots, points)
    layouts.write_scannet(folder / "scannet", "s", made, points)
    return folder, made, shots


def test_the_lerf_layout_reads_back(written):
    folder, made, shots = written
    views = ds.read_views(folder / "lerf_ovs" / "s")
    assert [v.name for v in views] == [s.view.name for s in shots]
    for view, shot in zip(views, shots, strict=True):
        assert_allclose(view.cam_from_world, shot.view.cam_from_world, atol=1e-12)
        assert_allclose(view.K, shot.view.K)
        assert ds.load_image(view).shape == (72, 96, 3)
    assert len(ds.read_sparse_points(folder / "lerf_ovs" / "s").positions) == 600
    frames = read_lerf_labels(folder / "lerf_ovs/label/s")
    assert [frame.name for frame in frames] == [Path(s.view.name).stem for s in shots[::8]]
    for frame, shot in zip(frames, shots[::8], strict=True):
        for name in frame.categories:
            numbers = [k for k in range(len(made.objects)) if layouts.category(made, k) == name]
            truth, drawn = np.isin(shot.ids, numbers), frame.mask(name)
            assert (truth & drawn).sum() / (truth | drawn).sum() > 0.8


def test_the_scannet_layout_reads_back(written):
    folder, made, _ = written
    place = folder / "scannet" / "s"
    ids = json.loads((place / "s_vh_clean_2.0.010000.segs.json").read_text())["segIndices"]
    names = [o.thing.name for o in made.objects] + [s.name for s in made.structures]
    labels = read_scannet_labels(place / "s_vh_clean_2.labels.ply").labels
    assert [layouts.NYU40.get(names[k], 40) for k in ids] == labels.tolist()
    groups = json.loads((place / "s.aggregation.json").read_text())["segGroups"]
    assert {g["label"] for g in groups} == {names[k] for k in ids}


def test_the_truth_is_whole(written):
    folder, made, shots = written
    objects = json.loads((folder / "truth.json").read_text())["objects"]
    assert [o["id"] for o in objects] == list(range(len(made.objects)))
    assert {"name", "color", "material", "center", "box"} <= set(objects[0])
    for shot in shots:
        stem = Path(shot.view.name).stem
        with Image.open(folder / "ids" / f"{stem}.png") as picture:
            assert_array_equal(np.array(picture).astype(int) - 1, shot.ids)
        assert_array_equal(np.load(folder / "depth" / f"{stem}.npz")["depth"], shot.depth)


def test_points_of_surfaces_lie_on_them_and_are_seen():
    rng = default_rng(0)
    points = scan.on_mesh(meshes.box((1, 1, 1)), 0.1, rng) - [0, 0, 0.5]
    assert abs(len(points) - 600) <= 1
    assert_allclose(np.abs(points).max(1), 0.5, atol=1e-9)
    made = room(1)
    seen = scan.from_depth(painted_shots(made, 2), 100, rng)
    assert set(seen.ids.tolist()) <= set(range(len(made.objects) + 1))


def test_the_wheel_is_told_to_leave_the_world_out():
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())
    assert project["tool"]["scikit-build"]["wheel"]["packages"] == ["src/drsplat"]


# With the renderer


@pytest.fixture(scope="module")
def shots() -> tuple[Room, list[Shot]]:
    pytest.importorskip("mitsuba", reason="pip install mitsuba==3.9.1 to render the world")
    from world.render import shoot

    made = room(2)
    views = views_of(made, 8, (160, 120), looks.TEST.rng(2, 300))
    return made, list(shoot(made, [views[0], views[2], views[6]], 4, 0))


def test_photos_are_lit_and_every_ray_ends_somewhere_sensible(shots):
    made, taken = shots
    for shot in taken:
        assert 60 < shot.image.mean() < 210
        assert set(np.unique(shot.ids)) <= set(range(-1, len(made.objects) + len(made.structures)))
        assert ((shot.depth > 0) == (shot.ids >= 0)).all()
        assert shot.depth.max() < 10


def test_unprojected_pixels_lie_in_the_box_of_their_thing(shots):
    """Poses, intrinsics, depth and ids in one law: it fails for any other camera convention."""
    made, taken = shots
    cloud = scan.from_depth(taken, 6000, default_rng(0))
    met = 0
    for k, placed in enumerate(made.objects):
        low, high = placed.thing.bounds
        world = cloud.positions[cloud.ids == k] - np.array(placed.position)
        local = world @ meshes.turn("z", placed.degrees)
        assert (local > low - 2e-3).all()
        assert (local < high + 2e-3).all()
        met += len(local) > 0
    assert met >= 6


def test_the_photo_agrees_with_the_ids(shots):
    """The sensor's own picture: within a plain thing colours vary less than across the photo, and
    far less than under the mask mirrored."""
    for shot in shots[1]:

        def spread(ids: np.ndarray, image: np.ndarray = shot.image) -> float:
            parts = [image[ids == k].astype(float) for k in np.unique(ids)]
            return sum(((p - p.mean(0)) ** 2).sum() for p in parts)

        assert spread(shot.ids) < 0.85 * min(spread(shot.ids[:, ::-1]), spread(shot.ids[::-1]))


def test_crops_are_deterministic_and_show_their_thing():
    pytest.importorskip("mitsuba", reason="pip install mitsuba==3.9.1 to render the world")
    from world.crops import crops

    first, again = (list(crops(looks.TEST, 0, 4, side=48, spp=2)) for _ in range(2))
    for a, b in zip(first, again, strict=True):
        assert a.name == b.name
        assert_array_equal(a.mask, b.mask)
        assert np.abs(a.image.astype(int) - b.image).max() <= 1
        assert a.mask.mean() > 0.02
