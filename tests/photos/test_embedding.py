"""Photos to LangSplat's features: streamed, resumable, and in a form that others read and write."""

import errno
import json
import os
import signal
import subprocess
import sys
import time
import tracemalloc
import warnings
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

import drsplat as ds
from captures_to_train import ring
from command_line import answer_of, error_of
from drsplat import cli
from drsplat.drawing.pictures import as_pixels, write_picture
from drsplat.errors import DrSplatWarning, MismatchError, MissingExtraError
from drsplat.formats.embedding_record import COMPACT, EmbeddingRecord, read_record
from drsplat.formats.langsplat import LEVELS, read_features
from drsplat.formats.replacing import NoRoom
from drsplat.formats.tensors import sealed
from drsplat.photos.embedding.embed import embed as embed_compactly
from drsplat.scene.gaussians import SH_C0
from drsplat.scene.masks.crops import crop
from drsplat.scene.views import View
from fake_models import DIM, ColorSegmenter, LargeSegmenter, ThumbnailEncoder
from places import SUPPORT
from refusing import malformed, refused
from scenes import random_gaussians
from written_captures import model_of, write_colmap_text

TESTS = SUPPORT
embed = partial(embed_compactly, form="langsplat")  # test_compact_features.py has the other form


def a_view(folder: Path, name: str, width: int = 24, height: int = 18, seed: int = 0) -> View:
    """With a photo of coloured blocks."""
    colors = np.random.default_rng([seed, *name.encode()]).choice([0, 255], (3, 4, 3))
    blocks = Image.fromarray(colors.astype(np.uint8))
    path = folder / "images" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    blocks.resize((width, height), Image.Resampling.NEAREST).save(path)
    intrinsics = np.array([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1.0]])
    return View(name, intrinsics, np.eye(4), width, height, path)


@pytest.fixture
def views(tmp_path) -> list[View]:
    return [a_view(tmp_path, name) for name in ("a.png", "b.png", "cam0/b.png")]


@pytest.fixture
def out(tmp_path) -> Path:
    return tmp_path / "out"


@pytest.fixture
def embedded(views, out) -> Path:
    """The folder that the views are embedded in."""
    embed_quietly(views, out)
    return out


def times_of(folder: Path) -> dict[str, int]:
    """Of writing, of each file."""
    return {
        path.relative_to(folder).as_posix(): path.stat().st_mtime_ns
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def embed_quietly(*arguments, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return embed(*arguments, ColorSegmenter(), ThumbnailEncoder(), **options)


# What is written


def langsplat_reader(folder: Path, stem: str, level: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Mask and embedding of each mask, after the description of LangSplat's files alone: maps
    (4, H, W), -1 for none, ids are rows counted on from default through s, m and l; unit rows."""
    maps, rows = np.load(folder / f"{stem}_s.npy"), np.load(folder / f"{stem}_f.npy")
    assert maps.shape[0] == 4
    assert rows.dtype in (np.float16, np.float32)
    assert_allclose(np.linalg.norm(rows.astype(float), axis=1), 1, atol=1e-3)
    ids = [np.unique(of_level[of_level >= 0]) for of_level in maps]
    assert_array_equal(np.concatenate(ids), np.arange(len(rows)))
    return [(maps[level] == row, rows[int(row)]) for row in ids[level]]


def test_files_load_in_a_reader_of_the_description_alone(views, out, embedded):
    for view in views:
        image = ds.load_image(view)
        masks = ColorSegmenter().segment(image)
        for number, level in enumerate(LEVELS):
            found = langsplat_reader(out, view.name.removesuffix(".png"), number)
            parts = [i for i in range(len(masks[level])) if masks[level].parts[i].any()]
            assert len(found) == len(parts) > 0
            for i, (mask, row) in zip(parts, found, strict=True):
                assert_array_equal(mask, masks[level].full(i))
                seen = crop(image, masks[level].parts[i], masks[level].boxes[i])
                assert_allclose(row, ThumbnailEncoder().encode_images([seen])[0], 1e-5)


def test_our_reader_reads_what_a_writer_like_langsplat_wrote_and_embed_leaves_it(views, tmp_path):
    folder = tmp_path / "theirs"
    folder.mkdir()
    rng = np.random.default_rng(0)
    offset, maps = 0, []
    for count in (3, 4, 2, 5):
        of_level = rng.integers(-1, count, (18, 24)).astype(np.float32)
        maps.append(np.where(of_level >= 0, of_level + offset, -1))
        offset += count
    rows = rng.normal(size=(offset, DIM))
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    np.save(folder / "a_s.npy", np.stack(maps).astype(np.float32))
    np.save(folder / "a_f.npy", rows.astype(np.float16))
    features = read_features(folder, "large")["a.png"]
    assert_array_equal(features.file_rows, np.arange(9, 14))
    assert_allclose(features.embeddings, rows[9:], atol=2e-3)
    before = times_of(folder)
    with refused(r"not made here.*pass overwrite.*: a$"):
        embed_quietly(views, folder)
    assert times_of(folder) == before
    assert read_record(folder) is None
    assert embed_quietly(views, folder, overwrite=True).redone == 1
    assert langsplat_reader(folder, "a", 3)


def test_report_counts(views, out):
    segmenter, encoder = ColorSegmenter(), ThumbnailEncoder()
    report = embed(views, out, segmenter, encoder)
    stored = [langsplat_reader(out, "b", level) for level in range(4)]
    assert (report.photos, report.reused, report.redone) == (3, 0, 0)
    assert report.empty_masks >= 3  # one of `default` for each photo, and upper halves
    assert segmenter.asked == 3
    assert encoder.asked == sum(report.masks.values()) >= sum(map(len, stored))
    again = embed(views, out, segmenter, encoder)
    assert again == replace(report, reused=3)
    assert encoder.asked == sum(report.masks.values())


def test_one_level_serves_all_four(views, out):
    report = embed(views, out, LargeSegmenter(), ThumbnailEncoder())
    assert set(report.masks) == {"large"}
    maps = np.load(out / "a_s.npy")
    assert maps.shape == (4, 18, 24)
    assert all(np.array_equal(of_level, maps[0]) for of_level in maps)
    assert len(np.load(out / "a_f.npy")) == maps.max() + 1


def test_tall_photos_are_scaled_as_langsplat_does(tmp_path, out):
    views = [a_view(tmp_path, "tall.png", 20, 50), a_view(tmp_path, "wide.png", 50, 20)]
    embed_quietly(views, out, max_height=24)
    assert np.load(out / "tall_s.npy").shape == (4, 24, 9)  # int(20 / (50 / 24))
    assert np.load(out / "wide_s.npy").shape == (4, 20, 50)
    embed_quietly(views, tmp_path / "whole", max_height=None)
    assert np.load(tmp_path / "whole/tall_s.npy").shape == (4, 50, 20)
    with refused("max_height"):
        embed_quietly(views, tmp_path / "none", max_height=0)


def test_maps_lie_on_the_photo_as_stored(tmp_path, out):
    """`register` undoes the lens on the maps: here it must still be in them."""
    view = replace(a_view(tmp_path, "a.png"), distortion=(0.3, 0.1, 0.0, 0.0))
    assert not np.array_equal(ds.load_image(view), ds.load_image(replace(view, distortion=None)))
    embed_quietly([view], out)
    embed_quietly([replace(view, distortion=None)], tmp_path / "straight")
    for name in ("a_s.npy", "a_f.npy"):
        assert (out / name).read_bytes() == (tmp_path / "straight" / name).read_bytes()


def test_a_photo_without_masks_has_files_without_rows(tmp_path, out):
    views = [a_view(tmp_path, name) for name in ("a.png", "b.png")]
    Image.new("RGB", (24, 18)).save(views[0].image_path)
    embed_quietly(views, out)
    features = read_features(out, encoder=ThumbnailEncoder().identity)
    assert features["a"].embeddings.shape == (0, DIM)
    assert len(features["b"].embeddings) > 0
    registered = ds.register(random_gaussians(200), views, features)
    assert len(registered.masks) == len(features["b"].embeddings)


def test_photos_without_any_mask_are_told_of(tmp_path, out):
    view = a_view(tmp_path, "a.png")
    Image.new("RGB", (24, 18)).save(view.image_path)
    with pytest.warns(DrSplatWarning, match="no mask was found in any of 1 photos"):
        report = embed([view], out, ColorSegmenter(), ThumbnailEncoder())
    assert (report.masks, report.empty_masks) == ({}, 1)


# What is refused


def test_photos_that_are_none(views, out):
    bare = [replace(view, image_path=None) for view in views]
    with refused("none of 3 views has a photo"):
        embed_quietly(bare, out)
    with pytest.warns(DrSplatWarning, match=r"1 of 3 views have no photo to embed: a\.png"):
        report = embed([bare[0], *views[1:]], out, ColorSegmenter(), ThumbnailEncoder())
    assert report.photos == 2
    views[0].image_path.write_bytes(b"no photo")
    with malformed(r"a\.png"):
        embed_quietly(views, out)


def test_photos_that_would_share_a_file(tmp_path, out):
    views = [a_view(tmp_path, "a.png"), a_view(tmp_path, "a.jpg")]
    with refused(r"'a\.jpg' and 'a\.png' would share the features 'a'"):
        embed_quietly(views, out)


@pytest.mark.parametrize("rows", [np.full((1, DIM), np.nan), np.ones((1, DIM)), np.ones((2, DIM))])
def test_embeddings_that_are_none_are_not_stored(views, rows, out):
    encoder = ThumbnailEncoder()
    encoder.encode_images = lambda images: np.repeat(rows, len(images), 0).astype(np.float32)
    with refused(r"a\.png: the encoder thumbnails gave"):
        embed(views, out, ColorSegmenter(), encoder)
    assert not list(out.glob("*.npy"))


@pytest.mark.parametrize(
    "text",
    [
        "[]",
        "{",
        "{}",
        '{"format": "drsplat embedding 9", "settings": {}, "photos": {}}',
        '{"format": "drsplat embedding 1", "settings": 1, "photos": {}}',
    ],
)
def test_a_damaged_record_is_refused(views, text, out, embedded):
    (out / "embedding.json").write_text(text)
    for read in (lambda: embed_quietly(views, out), lambda: read_record(out)):
        with malformed(r"embedding\.json"):
            read()
    assert embed_quietly(views, out, overwrite=True).redone == 3


def test_identities_must_fit_in_json(views, out):
    with refused("identity"):
        embed(views, out, ColorSegmenter(model=object()), ThumbnailEncoder())


# Resuming


def test_a_second_run_touches_nothing(views, out, embedded):
    before = times_of(out)
    assert set(before) == {"embedding.json"} | {
        f"{stem}{ending}" for stem in ("a", "b", "cam0/b") for ending in ("_f.npy", "_s.npy")
    }
    assert embed_quietly(views, out).reused == 3
    assert times_of(out) == before


class LookingEncoder(ThumbnailEncoder):
    """Embeds masks by where they lie in the image, as encoders of patches do; would fail on crops."""

    def encode_masks(self, image, masks):
        rows = np.zeros((len(masks), DIM), np.float32)
        rows[np.arange(len(masks)), [(7 * x0 + 3 * y0) % DIM for x0, y0, _, _ in masks.boxes]] = 1
        return rows

    def encode_images(self, images):
        raise AssertionError(images)


def test_an_encoder_that_looks_at_whole_photos_gets_no_crops(views, out):
    embed(views, out, ColorSegmenter(), LookingEncoder())
    features = read_features(out, "large")
    for name in ("a.png", "b.png"):
        embeddings, ids = features[name].embeddings, features[name].mask_ids
        for number in np.unique(ids[ids >= 0]):
            y, x = np.argwhere(ids == number).min(0)
            assert embeddings[number].argmax() == (7 * x + 3 * y) % DIM


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda: {"segmenter": ColorSegmenter(shades=3)}, "segmenter.settings.shades: 2 -> 3"),
        (lambda: {"segmenter": ColorSegmenter(grid=[1, 2])}, r"segmenter.settings.grid: null -> \[1, 2\]"),
        (lambda: {"encoder": ThumbnailEncoder("other")}, 'encoder.name: "thumbnails" -> "other"'),
        (lambda: {"encoder": ThumbnailEncoder(dim=8)}, "encoder.dim: 16 -> 8"),
        (lambda: {"max_height": 720}, "max_height: 1080 -> 720"),
    ],
)
def test_a_changed_setting_redoes_everything_and_says_so(views, change, said, out, embedded):
    before = times_of(out)
    options = {"segmenter": ColorSegmenter(), "encoder": ThumbnailEncoder()} | change()
    with pytest.warns(DrSplatWarning, match=f"all photos are embedded again: {said}"):
        report = embed(views, out, **options)
    assert (report.reused, report.redone, len(report.changes)) == (0, 3, 1)
    after = times_of(out)
    assert after.keys() == before.keys()
    assert all(after[name] > before[name] for name in before)
    assert embed(views, out, **options).reused == 3


def test_a_changed_photo_is_embedded_again(views, tmp_path, out, embedded):
    before = times_of(out)
    stat = views[0].image_path.stat()
    a_view(tmp_path, "a.png", seed=1)
    os.utime(views[0].image_path, ns=(stat.st_atime_ns, stat.st_mtime_ns))  # by content, not time
    report = embed_quietly(views, out)
    assert (report.reused, report.redone) == (2, 1)
    changed = {name for name, when in times_of(out).items() if when != before[name]}
    assert changed == {"embedding.json", "a_f.npy", "a_s.npy"}
    langsplat_reader(out, "a", 3)


def test_the_same_photo_on_another_raster_is_embedded_again(views, out, embedded):
    report = embed_quietly([views[0].resized(12, 9), *views[1:]], out)
    assert (report.reused, report.redone) == (2, 1)
    assert np.load(out / "a_s.npy").shape == (4, 9, 12)


@pytest.mark.parametrize("damage", ["other rows", "no rows", "no maps", "short maps", "entry"])
def test_files_that_are_not_as_recorded_are_made_again(views, damage, out, embedded):
    rows, maps = out / "a_f.npy", out / "a_s.npy"
    before = rows.read_bytes(), maps.read_bytes()
    record = out / "embedding.json"
    match damage:
        case "other rows":
            np.save(rows, np.load(rows)[::-1])
        case "no rows":
            rows.unlink()
        case "no maps":
            maps.unlink()
        case "short maps":
            maps.write_bytes(before[1][:-1])
        case "entry":
            document = json.loads(record.read_text().replace('"empty_masks"', '"empty"', 1))
            record.write_text(json.dumps(sealed(document)))
    assert embed_quietly(views, out).reused == 2
    assert (rows.read_bytes(), maps.read_bytes()) == before


@pytest.mark.parametrize(
    ("form", "endings"), [("compact", [".features.safetensors"]), ("langsplat", ["_f.npy", "_s.npy"])]
)
def test_features_of_another_photo_are_refused(views, form, endings, out):
    """Each file is whole, and under the name of the other: its masks would be laid on the wrong photo."""
    embed(views, out, ColorSegmenter(), ThumbnailEncoder(), form=form)
    whole = read_features(out)["a"].embeddings
    for ending in endings:
        first, second = out / f"a{ending}", out / f"b{ending}"
        content = first.read_bytes()
        first.write_bytes(second.read_bytes())
        second.write_bytes(content)
    with malformed(r"out/a: its features are not those that drsplat embed made of this photo"):
        _ = read_features(out)["a"]
    (out / "embedding.json").unlink()  # what the message says to who put them there
    assert not np.array_equal(read_features(out)["a"].embeddings, whole)


def test_old_files_stay_until_the_new_ones_are_there(views, out):
    """Stopped after a setting has changed: what is not made anew yet is whole, but does not count."""
    embed_quietly(views, out)
    before = {path: path.read_bytes() for path in out.rglob("*.npy")}

    class Fails(ThumbnailEncoder):
        def encode_images(self, images):
            if self.asked:
                raise KeyboardInterrupt
            return super().encode_images(images)

    with pytest.warns(DrSplatWarning, match="max_height"), pytest.raises(KeyboardInterrupt):
        embed(views, out, ColorSegmenter(), Fails(), max_height=9)
    kept = [path for path, content in before.items() if path.read_bytes() == content]
    assert {path.name for path in kept} == {"b_f.npy", "b_s.npy"}
    assert len(kept) == 4
    with pytest.raises(MismatchError, match="2 photos have features that are not of the settings"):
        read_record(out).whole()
    report = embed(views, out, ColorSegmenter(), ThumbnailEncoder(), max_height=9)
    assert (report.reused, report.redone, report.changes) == (1, 2, ())
    assert read_features(out).encoder == ThumbnailEncoder().identity


def test_files_left_from_other_settings_are_named(views, out, embedded):
    with (
        pytest.warns(DrSplatWarning, match="max_height"),
        pytest.warns(DrSplatWarning, match=r"still has files of 2 photos.*: a, b$"),
    ):
        embed(views[2:], out, ColorSegmenter(), ThumbnailEncoder(), max_height=9)


def test_no_reader_ever_sees_new_rows_with_old_maps(views, tmp_path, monkeypatch, out):
    """Stopped between the two files of a photo that is made again: it is not listed."""
    embed_quietly(views, out)
    a_view(tmp_path, "a.png", seed=1)
    stopped = np.save

    def save(file, array, **options):
        if array.ndim == 3:
            raise KeyboardInterrupt
        stopped(file, array, **options)

    monkeypatch.setattr(np, "save", save)
    with pytest.raises(KeyboardInterrupt):
        embed_quietly(views, out)
    monkeypatch.undo()
    assert set(read_features(out)) == {"b", "cam0/b"}
    assert embed_quietly(views, out).reused == 2
    langsplat_reader(out, "a", 3)


def test_the_record_is_written_as_often_for_many_photos_as_for_few(views, tmp_path, monkeypatch, out):
    """Each time it holds all photos: after each of them, the seconds grow with the square of the photos."""
    written = []
    write = EmbeddingRecord.write
    monkeypatch.setattr(EmbeddingRecord, "write", lambda self: (written.append(len(self.finished)), write(self))[1])
    embed_quietly(views, out)
    assert written == [0, 0, 3]
    written.clear()
    for view in views:
        a_view(tmp_path, view.name, seed=1)
    assert embed_quietly(views, out).redone == 3
    assert written == [3, 3]
    written.clear()
    assert embed_quietly(views, out).reused == 3
    assert written == []


def test_a_full_disk_keeps_what_was_noted(views, tmp_path, monkeypatch, out):
    """Neither a line of the journal nor the document finds room after the first photo."""
    real, calls = os.fsync, []

    def fsync(descriptor):
        calls.append(descriptor)
        if len(calls) > full:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(descriptor)

    full = 10**6
    monkeypatch.setattr(os, "fsync", fsync)
    embed_quietly(views[:1], tmp_path / "one")
    full = len(calls) - 2  # all but the document at the end
    calls.clear()
    with pytest.raises(NoRoom, match="there is no room left"):
        embed_quietly(views, out)
    monkeypatch.undo()
    assert set(read_record(out).finished) == {"a"}
    assert embed_quietly(views, out).reused == 1
    assert not (out / "embedding.jsonl").exists()


def wait_for(folder: Path, ending: str, count: int, process: subprocess.Popen[bytes]) -> None:
    while len(list(folder.glob(f"*{ending}"))) < count:
        assert process.poll() is None
        time.sleep(0.01)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["langsplat", "compact"])
def test_a_kill_loses_at_most_one_photo(form, tmp_path, out):
    views = [replace(view, image_path=None) for view in ring(8)]
    write_model_folder(tmp_path, views)
    for index, view in enumerate(views):
        a_view(tmp_path, view.name, view.width, view.height, seed=index)
    ending = {"langsplat": "_s.npy", "compact": COMPACT}[form]
    command = [sys.executable, TESTS / "fake_models.py", str(tmp_path), str(out), form]
    process = subprocess.Popen(command)
    wait_for(out, ending, 3, process)
    process.send_signal(signal.SIGKILL)
    process.wait()
    killed = times_of(out)
    assert (out / "embedding.jsonl").is_file()
    finished = len(read_record(out).finished)
    listed = len(list(out.glob(f"*{ending}")))
    assert 3 <= listed <= 7
    assert listed - finished <= 1
    assert subprocess.run(command).returncode == 0
    done = times_of(out)
    kept = [n for n in done if n != "embedding.json" and done[n] == killed.get(n)]
    assert len(kept) >= (2 if form == "langsplat" else 1) * finished
    assert len(json.loads((out / "embedding.json").read_text())["photos"]) == 8
    assert subprocess.run(command).returncode == 0
    assert times_of(out) == done
    whole = tmp_path / "whole"
    embed_compactly(ds.read_views(tmp_path), whole, ColorSegmenter(), ThumbnailEncoder(), form=form)
    for name in done.keys() - {"embedding.json"}:
        assert (out / name).read_bytes() == (whole / name).read_bytes()
    assert times_of(whole).keys() == done.keys()  # nothing hidden is left either


def write_model_folder(folder: Path, views: list[View]) -> None:
    write_colmap_text(folder / "sparse/0", *model_of(views), [])


def peak_bytes(folder: Path, count: int) -> int:
    """That Python and NumPy hold at once while so many photos are embedded."""
    view = a_view(folder, "a.png", 240, 180)
    views = [replace(view, name=f"{index:03}.png") for index in range(count)]
    tracemalloc.start()
    embed_quietly(views, folder / f"{count}")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


@pytest.mark.slow
def test_memory_does_not_grow_with_photos(tmp_path):
    """What grows is the record and the views, some kilobytes a photo; one photo takes more than its maps."""
    peak_bytes(tmp_path, 2)  # what is imported on the way is not of photos
    few, many = peak_bytes(tmp_path, 8), peak_bytes(tmp_path, 40)
    assert few > 4 * 240 * 180 * 4
    assert many - few < 32 * 8192 < few / 4


# The whole way


@pytest.fixture(scope="module")
def three_balls(tmp_path_factory) -> Path:
    """A capture of a red, a green and a blue ball; row i of the scene is of ball i // 60."""
    folder = tmp_path_factory.mktemp("balls")
    scene = random_gaussians(180, seed=1, extent=0.3, size=0.12, sh_degree=0)
    means, colors = scene.means.copy(), np.eye(3, dtype=np.float32)
    for ball in range(3):
        turn = 2 * np.pi * ball / 3
        means[60 * ball : 60 * (ball + 1)] += (0.9 * np.cos(turn), 0.9 * np.sin(turn), 0)
    sh = ((np.repeat(colors, 60, 0) - 0.5) / SH_C0)[:, None].astype(np.float32)
    opacities = np.full(180, 0.95, np.float32)
    scene = replace(scene, means=means.astype(np.float32), sh=sh, opacities=opacities)
    ds.write_gaussians(folder / "scene.ply", scene)
    views = ring(6)
    write_model_folder(folder, views)
    (folder / "images").mkdir()
    for view in views:
        write_picture(folder / "images" / view.name, as_pixels(ds.render(scene, view).rgb))
    return folder


# The command


@pytest.fixture
def fake_models(monkeypatch) -> None:
    from drsplat.photos.models import loading, sam

    def load_segmenter(name, device, settings, threads):
        assert device == "cpu"
        assert threads == 0
        levels = {("large",): LargeSegmenter, LEVELS: ColorSegmenter}
        return levels[settings.levels if settings else ("large",)](model=name)

    monkeypatch.setattr(sam, "load_segmenter", load_segmenter)
    monkeypatch.setattr(loading, "load_encoder", lambda name, device, threads: ThumbnailEncoder(name))


def test_the_command_reports_and_resumes(three_balls, tmp_path, fake_models, capsys):
    out = tmp_path / "features"
    command = ["embed", three_balls, "--segmenter", "s", "--encoder", "e", "--device", "cpu", "--langsplat", "-o", out]
    answer = answer_of(capsys, *command)
    assert (answer["num_photos"], answer["num_photos_reused"], answer["num_photos_redone"]) == (6, 0, 0)
    assert answer["num_masks"] == sum(answer["masks_per_level"].values())
    assert set(answer["masks_per_level"]) == set(LEVELS)
    assert (answer["encoder"], answer["dim"], answer["output"]) == ("e", DIM, str(out))
    assert answer["photos_per_second"] > 0
    assert answer["num_empty_masks"] >= 6
    assert cli.main([*map(str, command), "--levels", "large", "--max-height", "60"]) == 0
    said, told = capsys.readouterr()
    assert "6 over older files" in said
    assert "max_height: 1080 -> 60" in told
    assert np.load(out / "photo_00_s.npy").shape == (4, 60, 80)


@pytest.mark.parametrize("named", [".", "sparse/0", "sparse/0/cameras.txt"])
def test_where_the_command_writes_unless_told(named, three_balls, fake_models, capsys):
    answer = answer_of(capsys, "embed", three_balls / named, "--device", "cpu")
    assert Path(answer["output"]) == three_balls / "language_features"


def test_an_encoder_of_words_alone_is_refused(three_balls, fake_models, monkeypatch, capsys):
    from drsplat.photos.models import loading

    monkeypatch.setattr(loading, "load_encoder", lambda name, device, threads: ds.WordEncoder())
    command = ("embed", three_balls, "--encoder", "drsplat-words", "--device", "cpu")
    assert "embeds words, no images" in error_of(capsys, *command)


@pytest.fixture
def built_in_only(monkeypatch) -> None:
    from drsplat.fronts.scanning import choosing

    def missing():
        raise MissingExtraError("transformers is not installed: install it")

    monkeypatch.setattr(choosing, "models_library", missing)


def test_what_can_be_had_is_chosen_and_said(three_balls, fake_models, built_in_only, capsys):
    command = ["embed", str(three_balls), "--device", "cpu"]
    assert cli.main(command) == 0
    told = capsys.readouterr().err
    assert "The built-in models (graph and drsplat-mini) work, because transformers is not installed" in told
    assert "run drsplat embed with --overwrite" in told
    assert cli.main([*command, "--json"]) == 0
    said, told = capsys.readouterr()
    answer = json.loads(said)
    assert (answer["segmenter"], answer["encoder"], answer["num_photos_reused"]) == ("graph", "drsplat-mini", 6)
    assert "built-in" not in told


def test_features_of_better_models_are_not_replaced_by_chance(three_balls, fake_models, built_in_only, capsys):
    command = ["embed", str(three_balls), "--device", "cpu"]
    assert cli.main([*command, "--segmenter", "graph", "--encoder", "clip"]) == 0
    capsys.readouterr()
    assert cli.main(command) == 1
    told = capsys.readouterr().err
    assert "holds features of clip, and what can be had now is drsplat-mini, because transformers" in told
    assert cli.main([*command, "--overwrite"]) == 0


def test_options_of_sam_need_sam(three_balls, fake_models, built_in_only, capsys):
    told = error_of(capsys, "embed", three_balls, "--device", "cpu", "--points", 16)
    assert "leave out --points" in told
    assert "SAM cannot be had: transformers is not installed" in told


def test_sam_on_a_cpu_brings_few_points_along(monkeypatch):
    from drsplat.fronts.commands.embed import COARSE_TO_FINE, Cutting, Options
    from drsplat.fronts.scanning.choosing import ModelChoice
    from drsplat.photos.models.sam import CPU_SEGMENTER

    models = ModelChoice(CPU_SEGMENTER, "clip")
    light = Options(capture="capture").point_settings(models)
    assert (light.levels, light.crop_layers, light.most_points) == (("large",), 0, COARSE_TO_FINE["most_points"])
    given = Options(capture="capture", cutting=Cutting(points=16, levels="four")).point_settings(models)
    assert (given.levels, given.crop_layers, given.points_per_side) == (LEVELS, 0, 16)
    assert Options(capture="capture", segmenter=CPU_SEGMENTER).point_settings(models).crop_layers == 1
