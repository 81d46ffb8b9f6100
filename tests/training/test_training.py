"""Training as a whole: it finds a known scene again, goes on after a kill to the same bits, writes what
3DGS tools expect, and refuses what cannot work."""

import json
import os
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import drsplat as ds
from captures_to_train import HEIGHT, WIDTH, known_scene, perturbed_points, photographed, ring
from command_line import answer_of
from drsplat.cli import main
from drsplat.errors import FormatError, InputError, MismatchError
from drsplat.formats.captures import SparsePoints, read_sparse_points
from drsplat.formats.ply import write_vertices
from drsplat.formats.tensors import map_tensors, write_tensors
from drsplat.scene.eight_bits import clamped_in_bytes
from drsplat.training import everyday
from places import IMPORTED
from written_captures import model_of, write_colmap_text

BUSY = ds.TrainingSettings(
    iterations=120,
    refine_from=20,
    refine_every=20,
    reset_every=60,
    reset_recovery=20,
    sh_degree=2,
    sh_degree_every=30,
    background="random",
)
"""Everything that happens in 30,000 iterations happens in 120."""
CHAIN = replace(BUSY, strategy="mcmc", max_gaussians=400)
FINE = replace(BUSY, antialiased=True)
COARSE = replace(BUSY, full_size_from=80, opacity_penalty=0.01)
LIMITED = replace(BUSY, colors_in_bytes=True, sh_rate=0.1)
KINDS = {"default": BUSY, "mcmc": CHAIN, "coarse": COARSE, "antialiased": FINE, "colours in bytes": LIMITED}
both = pytest.mark.parametrize("settings", KINDS.values(), ids=KINDS)
POINTS = perturbed_points(known_scene())
train = partial(ds.train, points=POINTS, device="cpu")


@pytest.fixture(scope="module")
def scene() -> ds.Gaussians:
    return known_scene()


@pytest.fixture(scope="module")
def views(scene, tmp_path_factory) -> list[ds.View]:
    return photographed(tmp_path_factory.mktemp("photos"), scene, ring(32))


@pytest.fixture(scope="module")
def capture(views, tmp_path_factory) -> Path:
    """A COLMAP text model of every fourth view, with points."""
    folder = tmp_path_factory.mktemp("capture")
    (folder / "images").mkdir()
    some = views[::4]
    for view in some:
        (folder / "images" / view.name).write_bytes(view.image_path.read_bytes())
    places, colors = (column.tolist() for column in POINTS)
    points = [(k, *point) for k, point in enumerate(zip(places, colors, strict=True))]
    write_colmap_text(folder / "sparse/0", *model_of(some), points)
    return folder


# --- it learns ---


def test_the_chain_learns_within_its_budget(views):
    settings = replace(CHAIN, iterations=300, max_gaussians=350, background="black")
    training = train(views, settings)
    assert training.evaluation.psnr > 20
    assert len(training.gaussians) == 350


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:held-out photos")
def test_without_points_it_starts_from_found_and_random_ones_and_still_learns(views):
    settings = ds.TrainingSettings(iterations=150, random_points=2000, sh_degree=0)
    with pytest.warns(ds.DrSplatWarning, match="triangulating 14 photos gave"):
        before = ds.train(views[::2], replace(settings, iterations=1), device="cpu").evaluation.psnr
    with pytest.warns(ds.DrSplatWarning, match="2,000 random points as well"):
        after = ds.train(views[::2], settings, device="cpu")
    assert after.evaluation.psnr > before + 3
    assert after.start["random"] == 2000
    assert after.measures()["start"] == after.start


def test_pixels_past_the_photo_teach_nothing(views):
    """With a lens undone the photos have black corners; the scene must not."""
    bent = [replace(view, distortion=(0.25, 0.0, 0.0, 0.0)) for view in views[:12]]
    colors = np.full(POINTS.colors.shape, 255, np.uint8)
    bright = SparsePoints(POINTS.positions * 3, colors)
    settings = ds.TrainingSettings(iterations=1, test_every=0, sh_degree=0)
    from drsplat.scene.photos import photo_coverage

    outside = ~photo_coverage(bent[0])
    assert outside.any()
    seen = []

    def spying(image, target, *rest, **options):
        seen.append((image.copy(), target.copy()))
        return original(image, target, *rest, **options)

    from drsplat.training import run

    original = run.photometric_loss
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "photometric_loss", spying)
        train(bent, settings, points=bright)
    image, target = seen[0]
    assert image[outside].max() > 0.1
    assert np.array_equal(image[outside], target[outside])
    assert not np.array_equal(image[~outside], target[~outside])


def test_an_antialiased_run_writes_a_scene_that_looks_as_it_was_measured(views, tmp_path):
    training = train(views, FINE, tmp_path / "model")
    scene = ds.read_gaussians(tmp_path / "model")
    assert training.gaussians.antialiased
    assert scene.antialiased

    def psnr(gaussians):
        drawn = np.clip(ds.render(gaussians, views[8]).rgb, 0, 1)
        photo = np.asarray(Image.open(views[8].image_path), np.float32) / 255
        return float(-10 * np.log10(np.mean((drawn - photo) ** 2)))

    measured = next(view.psnr for view in training.evaluation.views if view.name == "photo_08.png")
    assert psnr(scene) == pytest.approx(measured, abs=0.01)
    assert abs(psnr(replace(scene, antialiased=False)) - measured) > 0.05  # so much does the mark say


@pytest.mark.slow
def test_colors_that_stay_in_bytes_are_what_viewers_of_the_web_show(views):
    free = train(views, replace(LIMITED, colors_in_bytes=False)).gaussians
    assert clamped_in_bytes(free).mean() > 0.01
    assert not clamped_in_bytes(train(views, LIMITED).gaussians).any()


# --- the same bits ---


def ply_of(folder: Path, iterations: int = 120) -> bytes:
    return (folder / f"point_cloud/iteration_{iterations}/point_cloud.ply").read_bytes()


@pytest.mark.slow
@both
def test_any_number_of_threads_gives_the_same_bits(settings, views, tmp_path):
    settings = replace(settings, iterations=60)
    for threads in (1, 2):
        train(views[::2], settings, tmp_path / str(threads), threads=threads)
    assert ply_of(tmp_path / "1", 60) == ply_of(tmp_path / "2", 60)


@pytest.mark.slow
def test_an_everyday_run_finds_a_known_scene_again_and_is_planned_for_its_length(views, tmp_path):
    settings = everyday(views, 400, sh_degree=1)
    start = train(views, replace(settings, iterations=1))
    end = train(views, settings, tmp_path / "m")
    assert end.evaluation.psnr > start.evaluation.psnr + 7
    assert len(end.gaussians) <= settings.max_gaussians
    with pytest.raises(MismatchError, match=r"other settings \(.*means_rate_steps.*\)"):
        train(views, everyday(views, 500, sh_degree=1), tmp_path / "m")


def test_nothing_said_is_everyday(views, monkeypatch):
    def stop(job):
        asked.append(job.settings)
        raise KeyboardInterrupt

    asked = []
    monkeypatch.setattr("drsplat.training.loop.train", stop)
    with pytest.raises(KeyboardInterrupt):
        train(views)
    assert asked == [everyday(views)]


KILLED = """
import os, signal, sys
import numpy as np
import test_training as t
from captures_to_train import ring
from dataclasses import replace
from pathlib import Path
photos, folder, kind = sys.argv[1:]
views = [replace(v, image_path=Path(photos) / v.name) for v in ring(32)][::2]
def report(status):
    if status.iteration == 97:
        os.kill(os.getpid(), signal.SIGKILL)
t.train(views, t.KINDS[kind], folder, report=report, checkpoint_every=35)
"""


@pytest.mark.slow
@both
def test_a_killed_run_goes_on_to_the_same_bits(settings, views, tmp_path):
    train(views[::2], settings, tmp_path / "whole")
    arguments = (
        str(views[0].image_path.parent),
        str(tmp_path / "killed"),
        next(k for k in KINDS if KINDS[k] is settings),
    )
    environment = os.environ | {"PYTHONPATH": IMPORTED}
    killed = subprocess.run([sys.executable, "-c", KILLED, *arguments], env=environment, check=False)
    assert killed.returncode == -signal.SIGKILL
    assert not (tmp_path / "killed/point_cloud").exists()
    _, texts = map_tensors(tmp_path / "killed/checkpoint.safetensors")
    assert texts["iteration"] == "70"
    leftover = tmp_path / "killed/.0123456789abcdef.tmp"
    leftover.write_bytes(b"half")
    seen = []
    train(views[::2], settings, tmp_path / "killed", report=lambda status: seen.append(status.iteration))
    assert seen == list(range(71, 121))
    assert ply_of(tmp_path / "killed") == ply_of(tmp_path / "whole")
    assert not leftover.exists()
    assert not (tmp_path / "killed/.lock").exists()


# --- the folder ---


@pytest.fixture(scope="module")
def stopped(views, tmp_path_factory) -> Path:
    """A folder whose run was stopped after iteration 30."""
    folder = tmp_path_factory.mktemp("stopped")

    def stop(status: ds.training.Status) -> None:
        if status.iteration == 33:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(views, BUSY, folder, report=stop, checkpoint_every=10)
    return folder


@pytest.fixture
def checkpoint(stopped, tmp_path) -> Path:
    """That of a copy of the stopped run, in tmp_path / "model"."""
    return Path(shutil.copytree(stopped, tmp_path / "model")) / "checkpoint.safetensors"


def test_an_unfinished_run_of_something_else_is_not_gone_on_with(views, checkpoint, tmp_path):
    before = checkpoint.read_bytes()
    with pytest.raises(MismatchError, match=r"other settings \(seed\):.*overwrite=True"):
        train(views, replace(BUSY, seed=1), tmp_path / "model")
    fewer = SparsePoints(POINTS.positions[1:], POINTS.colors[1:])
    other = [*views[:-1], replace(views[-1], image_path=views[0].image_path)]
    for changed, points, what in (
        (views[1:], POINTS, "poses and photos"), (other, POINTS, "photos"), (views, fewer, "points"),
    ):  # fmt: skip
        with pytest.raises(MismatchError, match=f"other {what}: go on with the same ones"):
            train(changed, BUSY, tmp_path / "model", points=points)
    assert checkpoint.read_bytes() == before
    fresh = replace(BUSY, seed=1, iterations=5)
    train(views, fresh, tmp_path / "model", overwrite=True)
    assert ply_of(tmp_path / "model", 5)


@pytest.mark.slow
@pytest.mark.parametrize("how", ["missing", "version", "rng", "cut"])
def test_a_damaged_checkpoint_is_refused(how, views, checkpoint, tmp_path):
    mapped, texts = map_tensors(checkpoint)
    arrays = {name: np.array(array) for name, array in mapped.items()}
    if how == "missing":
        del arrays["order.pending"]
    write_tensors(checkpoint, arrays, texts | {how: "nonsense"}, overwrite=True)
    if how == "cut":
        checkpoint.write_bytes(checkpoint.read_bytes()[:-8])
    with pytest.raises(FormatError, match=r"checkpoint\.safetensors"):
        train(views, BUSY, tmp_path / "model")


@pytest.mark.slow
def test_a_flipped_bit_in_a_checkpoint_is_noticed(views, checkpoint, tmp_path):
    good = checkpoint.read_bytes()
    for at in np.random.default_rng(0).integers(8, len(good), 24):
        bad = bytearray(good)
        bad[at] ^= 1 << int(at % 8)
        checkpoint.write_bytes(bad)
        with pytest.raises(FormatError, match=r"checkpoint\.safetensors.*remove it to start anew"):
            train(views, BUSY, tmp_path / "model")


def test_a_folder_with_something_else_in_it_is_refused(views, tmp_path):
    (tmp_path / "holiday.txt").write_text("mine")
    with pytest.raises(InputError, match="not empty"):
        train(views, BUSY, tmp_path)
    quick = replace(BUSY, iterations=1)
    old = tmp_path / "point_cloud/iteration_30000/point_cloud.ply"
    old.parent.mkdir(parents=True)
    old.write_bytes(b"of another run")
    train(views, quick, tmp_path, overwrite=True)
    assert (tmp_path / "holiday.txt").read_text() == "mine"
    assert not old.exists()  # it would be taken for the latest
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="is a file"):
        train(views, quick, tmp_path / "file")


FULL = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
sys.dont_write_bytecode = True
resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, 40_000))
from drsplat.cli import main
sys.exit(main(["train", *sys.argv[1:]]))
"""


@pytest.mark.slow
def test_a_full_disk_is_a_clear_error_and_leaves_nothing_half_written(capture, tmp_path):
    """Files may grow to 40 kB here, which the first checkpoint does not fit into."""
    folder = tmp_path / "model"
    command = [sys.executable, "-c", FULL, str(capture), "-o", str(folder), "--iterations", "3"]
    command += ["--checkpoint-every", "2", "--device", "cpu"]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ran.returncode == 1
    assert "no room left" in ran.stderr
    assert "free some space" in ran.stderr
    assert "Traceback" not in ran.stderr
    written = {str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file()}
    assert written == {"cameras.json", "cfg_args", "input.ply", "settings.json"}


# --- the verb ---


def run_verb(capsys, *arguments: str) -> dict[str, object]:
    return answer_of(capsys, "train", *arguments, "--device", "cpu")


def test_the_verb_writes_the_layout_of_3dgs(capture, tmp_path, capsys):
    folder = tmp_path / "model"
    options = "--iterations 30 --save-at 10 --eval-every 10 --sh-degree 1 --colors-in-bytes"
    answer = run_verb(capsys, str(capture), "-o", str(folder), *options.split())
    assert answer.keys() >= {"psnr_test", "ssim_test", "num_gaussians", "iterations", "seconds"}
    assert (answer["iterations"], answer["num_gaussians"], answer["num_views"]) == (30, 300, 8)
    files = {str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file()}
    assert files == {
        "point_cloud/iteration_10/point_cloud.ply",
        "point_cloud/iteration_30/point_cloud.ply",
        "cameras.json",
        "cfg_args",
        "checkpoint.safetensors",
        "input.ply",
        "results.json",
        "settings.json",
        "test/photo_00.png",
    }
    assert len(ds.read_gaussians(folder)) == 300
    assert ds.read_gaussians(folder).sh_degree == 1
    with pytest.warns(ds.DrSplatWarning, match="no photo"):
        cameras = ds.read_views(folder / "cameras.json")
    assert [view.name for view in cameras] == [view.name for view in ds.read_views(capture)]
    results = json.loads((folder / "results.json").read_text())
    assert results["psnr_test"] == answer["psnr_test"]
    assert [entry["iteration"] for entry in results["history"]] == [10, 20]
    settings = json.loads((folder / "settings.json").read_text())
    assert (settings["iterations"], settings["colors_in_bytes"]) == (30, True)
    arguments = (folder / "cfg_args").read_text()
    assert arguments.startswith("Namespace(")
    assert f"source_path='{capture}'" in arguments
    picture = np.asarray(Image.open(folder / "test/photo_00.png"))
    assert picture.shape == (HEIGHT, 3 * WIDTH, 3)
    photo = np.asarray(Image.open(capture / "images/photo_00.png"))
    assert np.array_equal(picture[:, :WIDTH], photo)


@pytest.mark.parametrize(
    ("resolution", "size"),
    [((), (96, 72)), (("2",), (48, 36)), (("4",), (24, 18)), (("40",), (40, 30)), (("500",), (96, 72))],
)
def test_resolution_divides_or_is_the_longer_side(resolution, size, capture, tmp_path, capsys):
    options = ("--resolution", *resolution) if resolution else ()
    answer = run_verb(capsys, str(capture), "-o", str(tmp_path / "m"), "--iterations", "1", *options)
    assert (answer["width"], answer["height"]) == size


def refused(capsys, *arguments: str) -> str:
    assert main(["train", *arguments]) == 1
    return capsys.readouterr().err


def test_the_verb_refuses_views_without_photos(capture, tmp_path, capsys):
    said = refused(capsys, str(capture / "sparse/0/cameras.txt"), "-o", str(tmp_path / "m"), "--images", str(tmp_path))
    assert "no photo" in said
    assert "--images" in said
    assert not (tmp_path / "m").exists()


def without_points(capture: Path, folder: Path) -> tuple[str, ...]:
    """Arguments of the verb for a copy of the capture."""
    for name in ("cameras.txt", "images.txt"):
        (folder / name).write_bytes((capture / "sparse/0" / name).read_bytes())
    return (str(folder), "--images", str(capture / "images"), "-o", str(folder / "m"))


def test_the_verb_says_that_it_triangulates(capture, tmp_path, capsys):
    options = ("--device", "cpu", "--max-gaussians", "500", "--iterations", "1")
    assert main(["train", *without_points(capture, tmp_path), *options]) == 0
    said = capsys.readouterr()
    assert "has no points: triangulating" in said.err
    assert "random points as well" in said.err
    for words in ("500 random points", "trained:", "PSNR", "SSIM", "Gaussians", "ms an iteration"):
        assert words in said.out
    assert len(ds.read_gaussians(tmp_path / "m")) == 500


def test_the_verb_starts_from_a_file_of_points(capture, tmp_path, capsys):
    write_vertices(tmp_path / "cloud.ply", dict(zip("xyz", POINTS.positions.T, strict=True)))
    options = ("--points", str(tmp_path / "cloud.ply"), "--iterations", "2")
    answer = run_verb(capsys, *without_points(capture, tmp_path), *options)
    assert answer["start"] == {"given": 300, "triangulated": 0, "random": 0}
    started = read_sparse_points(capture, points=tmp_path / "m/input.ply")
    assert started.positions == pytest.approx(POINTS.positions, abs=1e-6)
    assert (started.colors == 128).all()
    assert "there is no such file" in refused(capsys, str(capture), "-o", str(tmp_path / "n"), "--points", "none.ply")


# --- going on ---


def scenes_of(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*.ply")}


def test_a_run_killed_before_its_first_checkpoint_goes_on(views, tmp_path, monkeypatch):
    """Also after --save-at has written a scene."""

    def killed(status):
        if status.iteration == 12:
            raise RuntimeError("killed")

    few = replace(BUSY, iterations=20)
    train(views[::4], few, tmp_path / "whole", save_at=(5,))
    with pytest.raises(RuntimeError):
        train(views[::4], few, tmp_path / "m", save_at=(5,), report=killed)
    assert (tmp_path / "m/cfg_args").is_file()
    assert not (tmp_path / "m/results.json").exists()
    train(views[::4], few, tmp_path / "m", save_at=(5,))
    assert scenes_of(tmp_path / "m") == scenes_of(tmp_path / "whole")


def test_the_same_command_on_a_finished_run_gives_the_same_files(views, tmp_path):
    few = replace(BUSY, iterations=20)
    train(views[::4], few, tmp_path)
    before, results = scenes_of(tmp_path), (tmp_path / "results.json").read_text()
    train(views[::4], few, tmp_path)
    assert scenes_of(tmp_path) == before
    assert json.loads((tmp_path / "results.json").read_text())["psnr_test"] == json.loads(results)["psnr_test"]


@pytest.mark.slow
@both
def test_a_finished_run_goes_on_as_if_it_had_been_longer(settings, views, tmp_path):
    """Refinements of the last iteration included, which a run leaves out when it ends there."""
    long, short = replace(settings, iterations=60), replace(settings, iterations=40)
    train(views[::4], long, tmp_path / "whole")
    train(views[::4], short, tmp_path / "m")
    train(views[::4], long, tmp_path / "m")
    assert ply_of(tmp_path / "m", 60) == ply_of(tmp_path / "whole", 60)
    assert json.loads((tmp_path / "m/settings.json").read_text())["iterations"] == 60
    with pytest.raises(MismatchError, match="has done 59 iterations already, 40 are asked for"):
        train(views[::4], short, tmp_path / "m")


def test_a_longer_run_that_cannot_be_the_planned_one_says_so(views, tmp_path):
    """The reset after 60 was left out, because the run ended at 70."""
    train(views[::4], replace(BUSY, iterations=70), tmp_path)
    with pytest.warns(ds.DrSplatWarning, match="planned for 70 iterations and left out an opacity"):
        train(views[::4], replace(BUSY, iterations=90), tmp_path)


def test_a_scene_is_saved_before_the_opacity_reset(views, tmp_path):
    settings = replace(BUSY, reset_every=10, evaluate_every=10, iterations=40)
    training = train(views[::4], settings, tmp_path, save_at=(10, 11))
    at, after = (
        ds.read_gaussians(tmp_path / f"point_cloud/iteration_{i}/point_cloud.ply").opacities.max() for i in (10, 11)
    )
    assert at > 0.1
    assert after < 0.02
    assert training.history[0]["psnr_test"] > 12


INTERRUPTED = """
import os, signal, sys, threading, time
from pathlib import Path
folder = Path(sys.argv[3])
def press():
    while not (folder / "checkpoint.safetensors").exists():
        time.sleep(0.01)
    time.sleep(0.3)
    os.kill(os.getpid(), signal.SIGINT)
threading.Thread(target=press, daemon=True).start()
from drsplat.cli import main
sys.exit(main(["train", *sys.argv[1:]]))
"""


def test_ctrl_c_writes_a_checkpoint_and_says_how_to_go_on(capture, tmp_path):
    folder = tmp_path / "m"
    command = [sys.executable, "-c", INTERRUPTED, str(capture), "-o", str(folder), "--iterations"]
    ran = subprocess.run([*command, "30000", "--device", "cpu"], capture_output=True, text=True, check=False)
    assert ran.returncode == 130
    assert "the same command, without --overwrite, goes on from there" in ran.stderr
    assert "Traceback" not in ran.stderr
    _, texts = map_tensors(folder / "checkpoint.safetensors")
    assert f"after iteration {int(texts['iteration']):,} of 30,000" in ran.stderr
    assert int(texts["iteration"]) % 1000 != 0


def test_two_runs_do_not_share_a_folder(views, tmp_path):
    few = replace(BUSY, iterations=3)
    said = []

    def second(status):
        with pytest.raises(InputError) as error:
            train(views[::4], few, tmp_path, overwrite=True)
        said.append(str(error.value))

    train(views[::4], few, tmp_path, report=second)
    assert f"is being written by process {os.getpid()} on " in said[0]
    assert (tmp_path / "results.json").is_file()
    train(views[::4], few, tmp_path, overwrite=True)


@pytest.mark.slow
def test_held_out_photos_far_below_are_told_of(views, tmp_path):
    """The photo that is held out shows something else."""
    Image.new("RGB", (WIDTH, HEIGHT), (255, 255, 255)).save(tmp_path / "white.png")
    mixed = [replace(views[0], image_path=tmp_path / "white.png"), *views[4::4]]
    settings = replace(BUSY, iterations=100, background="black")
    with pytest.warns(ds.DrSplatWarning, match=r"held-out photos are rendered at \d+\.\d dB"):
        training = train(mixed, settings)
    assert training.measures()["held_out_far_below"]
    assert training.psnr_train > training.evaluation.psnr + 10
    well = train(views[::4], replace(settings, iterations=30))
    assert not well.held_out_far_below


def test_an_optimisation_that_diverges_is_an_error(views):
    settings = replace(BUSY, means_rate=1e38, means_rate_end=1e38)
    with pytest.raises(ds.DrSplatError, match=r"iteration \d+: .* has left the finite numbers"):
        train(views, settings)
