"""What programs of others make of every format that `drsplat export` writes, and what we make of theirs.

    python benchmarks/study_round_trips.py DEMO [--photo 0] [--pictures FOLDER] [--tables numbers pictures theirs]

DEMO: the output of `drsplat demo`. The scene with its objects is written in each format. Then three tables:

1. Numbers: largest deviations from the scene as others read the file, beside half a step of the format. Positions in
   scene units, scales as logarithms (from exp(-10) on, below which SPZ has none), rotations in degrees, constant
   colours as shown (0 to 1; bytes cut off what is brighter), harmonics. "ids": Gaussians with the number of their
   object, and "names": different ones of objects, by readers that are written from the formats' descriptions and use
   nothing of drsplat.
2. Pictures of a photo's camera in a browser, where the scene is: PSNR of what a viewer shows against our picture of the
   scene, and against that of the scene with colours in bytes, which most viewers keep; against the same of Gaussians
   that are widened as the viewer widens them (`FINER`); and what the file itself loses: our picture of the file against
   that of the scene. --pictures keeps them as PNG.
3. The reverse: files that others write of the scene's PLY, as drsplat reads them; of a SOG beside their own decoding.
   An SPZ of gsply, which has the axes of a PLY and does not say so, is turned back.

Needs Chromium, Node.js, `npm install --prefix tests/foreign` and `pip install playwright usd-core rerun-sdk gsply
plyfile`; what is not installed is left out, in words.
"""

import argparse
import io
import json
import struct
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests/support"))

import drsplat as ds
from benchmarks import machine
from browsing import a_browser
from drsplat.authoring.exporting import export, labelled
from drsplat.authoring.exporting.writing import written_tiles3d
from drsplat.formats.axes import HALF_TURN, standing_up
from drsplat.formats.georeference import Georeference
from drsplat.scene.gaussians import SH_C0, Gaussians
from drsplat.scene.geodesy import enu_axes, geocentric
from drsplat.scene.labelled import LabelledScene
from drsplat.scene.morton import morton_order
from foreign_programs import splat_transform
from foreign_viewing import HEIGHT, WIDTH, pictured, psnr, turned, with_colors_in_bytes
from glb_files import Read

NORTH_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
PLACE = Georeference(8.5, 47.4, 400.0, NORTH_UP, 1.0)
SAME_PLACE = 1e-3  # scene units: rows are in the same order where all are as near
SMALLEST = np.exp(-10)  # of a scale: what is thinner SPZ holds as this, and no picture shows
THERE = 0.01  # opacity of our picture from which a pixel shows the scene
TOO_LONG = subprocess.TimeoutExpired
Reader = Callable[[Path], Gaussians]


class Found(NamedTuple):
    """Objects as a program of others finds them. ids: number of each Gaussian's object, None where there are none."""

    names: list[str]
    ids: np.ndarray | None


# --- files of ours, read without drsplat ---


def by_plyfile(path: Path) -> Gaussians:
    from plyfile import PlyData

    rows = PlyData.read(str(path))["vertex"]
    names = [p.name for p in rows.properties]
    count = sum(name.startswith("f_rest_") for name in names) // 3

    def columns(*wanted: str) -> np.ndarray:
        return np.stack([np.asarray(rows[name], np.float32) for name in wanted], 1)

    rest = [columns(*(f"f_rest_{channel * count + k}" for channel in range(3))) for k in range(count)]
    sh = np.stack([columns("f_dc_0", "f_dc_1", "f_dc_2"), *rest], 1)
    opacities = 1 / (1 + np.exp(-columns("opacity")[:, 0].astype(np.float64)))
    scales = np.exp(columns("scale_0", "scale_1", "scale_2"))
    return _of(columns("x", "y", "z"), columns("rot_0", "rot_1", "rot_2", "rot_3"), scales, opacities, sh)


def by_splat_transform(path: Path) -> Gaussians:
    copy = path.with_name(f"{path.name}.copy.ply")
    splat_transform(path, copy)
    return by_plyfile(copy)


def by_gsply(path: Path) -> Gaussians:
    """Read a PLY or an SPZ. It leaves an SPZ in the axes of its file, y up, so it is turned here."""
    import gsply

    read = gsply.plyread(str(path)) if path.suffix == ".ply" else gsply.read_spz(str(path))
    rest = read.shN if read.shN is not None else np.zeros((len(read.means), 0, 3))
    sh = np.concatenate([read.sh0[:, None], rest.reshape(len(read.means), -1, 3)], 1)
    logits = np.asarray(read.opacities, np.float64)
    found = _of(read.means, read.quats, np.exp(read.scales), 1 / (1 + np.exp(-logits)), sh)
    return found if path.suffix == ".ply" else _turned(found)


def by_the_specification(path: Path) -> Gaussians:
    """Read a GLB by the text of glTF and KHR_gaussian_splatting alone, in the axes of its mesh."""
    read = Read.of(path.read_bytes())
    name = "KHR_gaussian_splatting"
    sh = [read.attribute(key) for key in read.primitive["attributes"] if key.startswith(f"{name}:SH_")]
    quats = np.roll(read.attribute(f"{name}:ROTATION"), 1, axis=1)
    scales, opacities = read.attribute(f"{name}:SCALE"), read.attribute(f"{name}:OPACITY")
    return _of(read.attribute("POSITION"), quats, scales, opacities, np.stack(sh, 1))


def by_openusd(path: Path) -> Gaussians:
    from pxr import Usd, UsdVol

    stage = Usd.Stage.Open(str(path))
    splat = UsdVol.ParticleField3DGaussianSplat(stage.GetPrimAtPath("/scene/gaussians"))
    turns = splat.GetOrientationsAttr().Get()
    quats = np.array([[turn.GetReal(), *turn.GetImaginary()] for turn in turns])
    sh = np.array(splat.GetRadianceSphericalHarmonicsCoefficientsAttr().Get())
    means, scales = np.array(splat.GetPositionsAttr().Get()), np.array(splat.GetScalesAttr().Get())
    return _of(means, quats, scales, np.array(splat.GetOpacitiesAttr().Get()), sh.reshape(len(means), -1, 3))


def by_rerun(path: Path) -> Gaussians:
    values = _recorded(path, "/world/splats", "GaussianSplats3D:")
    count = len(values["colors"])
    rgba = values["colors"].astype(np.uint32)
    shown = np.stack([rgba >> 24, rgba >> 16, rgba >> 8], 1) & 255
    constant = ((shown / 255 - 0.5) / SH_C0)[:, None]
    sh = np.concatenate([constant, values["sh_coefficients"].reshape(count, -1, 3)[:, :3]], 1)
    means, scales = values["centers"].reshape(count, 3), values["scales"].reshape(count, 3)
    return _of(means, np.roll(values["quaternions"].reshape(count, 4), 1, axis=1), scales, (rgba & 255) / 255, sh)


def _recorded(path: Path, entity: str, archetype: str) -> Mapping[str, np.ndarray]:
    """Return the flat columns of an archetype in a recording, by rerun's own reader."""
    from rerun.chunk import RrdReader

    columns: dict[str, np.ndarray] = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            if chunk.entity_path == entity and name.startswith(archetype):
                while hasattr(column, "flatten") and column.type.num_fields:
                    column = column.flatten()
                columns[name.removeprefix(archetype)] = column.to_numpy(zero_copy_only=False)
    return columns


def _of(means: Any, quats: Any, scales: Any, opacities: Any, sh: Any) -> Gaussians:
    quats = np.asarray(quats, np.float64)
    quats = quats / np.linalg.norm(quats, axis=1, keepdims=True)
    numbers = (np.ascontiguousarray(values, np.float32) for values in (means, quats, scales, opacities, sh))
    return Gaussians(*numbers)


def _turned(g: Gaussians) -> Gaussians:
    """Return Gaussians by half a turn about x, harmonics of degree 1 too: y, z and x are their axes."""
    signs = np.array([1, -1, -1], np.float32)
    sh = g.sh * np.array([1, -1, -1, 1], np.float32)[None, : g.sh.shape[1], None]
    return replace(g, means=g.means * signs, quats=g.quats * np.array([1, *signs], np.float32), sh=sh)


# --- objects, by descriptions of the formats alone ---


def objects_in_ply(path: Path) -> Found:
    from plyfile import PlyData

    return Found([], np.asarray(PlyData.read(str(path))["vertex"]["object_id"]))


def objects_in_glb(path: Path) -> Found:
    read = Read.of(path.read_bytes())
    table, rows = read.table(0), read.attribute("_FEATURE_ID_0").astype(np.int64)
    return Found(table["name"], np.array([*table["number"], -1])[np.minimum(rows, len(table["number"]))])


def objects_in_sog(path: Path) -> Found:
    with zipfile.ZipFile(path) as archive:
        meta = json.loads(archive.read("meta.json"))
        labels = json.loads(archive.read(meta["drsplat"]["labels"]))
        pixels = np.asarray(Image.open(io.BytesIO(archive.read(meta["drsplat"]["object_id"]["files"][0]))))
    bytes_of = pixels.reshape(-1, pixels.shape[-1])[: meta["count"], :3].astype(np.int64)
    return Found([one["name"] for one in labels["objects"]], bytes_of @ [1, 1 << 8, 1 << 16] - 1)


def objects_in_spz4(path: Path) -> Found:
    """Read the extension 0xD25B0001, which lies between the header of 32 bytes and the table of streams."""
    import zstandard

    content = path.read_bytes()
    kind, length = struct.unpack_from("<II", content, 32)
    assert kind == 0xD25B0001
    payload = content[40 : 40 + length]
    sizes = struct.unpack_from("<3Q", payload)
    raw = zstandard.ZstdDecompressor().decompress(payload[24:], max_output_size=sum(sizes))
    labels = json.loads(raw[sizes[0] + sizes[1] :])
    return Found([one["name"] for one in labels["objects"]], np.frombuffer(raw, "<i4", sizes[0] // 4))


def objects_in_usd(path: Path) -> Found:
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(str(path))
    numbers = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/scene/gaussians")).GetPrimvar("object_id")
    names = [prim.GetDisplayName() for prim in stage.GetPrimAtPath("/scene/objects").GetChildren()]
    return Found(names, np.array(numbers.Get()))


def objects_in_rrd(path: Path) -> Found:
    return Found([str(name) for name in _recorded(path, "/world/things", "Boxes3D:")["labels"]], None)


def objects_in_tiles(path: Path) -> Found:
    """Return the names in all tiles; each tile has a table of its own."""
    reads = [Read.of(file.read_bytes()) for file in sorted(path.glob("*.glb"))]
    return Found(sorted({name for read in reads for name in read.table(0)["name"]}), None)


# --- the tables ---


class Format(NamedTuple):
    """A format that we write. readers: programs that give its numbers back. views: pages of `tests/foreign`."""

    title: str
    file: str
    readers: Mapping[str, Reader]
    objects: Callable[[Path], Found] | None
    views: tuple[str, ...] = ()


FORMATS = (
    Format("PLY without objects", "bare.ply", {"gsply": by_gsply}, None),
    Format("PLY", "room.ply", {"plyfile": by_plyfile, "splat-transform": by_splat_transform, "gsply": by_gsply},
           objects_in_ply, ("spark", "mkkellogg", "playcanvas")),
    Format("GLB", "room.glb", {"specification": by_the_specification}, objects_in_glb, ("playcanvas",)),
    Format("SPZ 3", "room.spz", {"splat-transform": by_splat_transform, "gsply": by_gsply}, None, ("spark",)),
    Format("SPZ 4", "room4.spz", {"splat-transform": by_splat_transform, "gsply": by_gsply}, objects_in_spz4,
           ("spark",)),
    Format("SOG", "room.sog", {"splat-transform": by_splat_transform}, objects_in_sog, ("spark", "playcanvas")),
    Format("USDA", "room.usda", {"usd-core": by_openusd}, objects_in_usd),
    Format("USDC", "room.usdc", {"usd-core": by_openusd}, objects_in_usd),
    Format("rrd", "room.rrd", {"rerun": by_rerun}, objects_in_rrd),
    Format("3D Tiles", "room.tiles3d", {}, objects_in_tiles, ("tiles3d",)),
)  # fmt: skip
FINER = {"playcanvas": 2, "tiles3d": 4}  # pixels for one of ours, by side, in which a viewer widens Gaussians by 0.3
Y_UP = ("room.spz", "room4.spz")  # that viewers show in their own axes, y up


def half_steps(path: Path) -> str:
    """Return what rounding to the format's own steps may cost, as a row of the table."""
    if path.suffix in (".spz", ".tiles3d"):
        bits = _fractional_bits(path) if path.suffix == ".spz" else 0
        place = f"{2.0 ** -(bits + 1):.1e}" if bits else "of each tile"
        return f"{place} | {1 / 32:.4f} | {1 / 510:.4f} | 0.27 | {SH_C0 / 0.15 / 510:.4f} | {1 / 256:.4f}"
    if path.suffix == ".sog":
        with zipfile.ZipFile(path) as archive:
            meta = json.loads(archive.read("meta.json"))
        low, high = np.array(meta["means"]["mins"]), np.array(meta["means"]["maxs"])
        place = ((high - low) / 65535 / 2 * np.exp(np.maximum(abs(low), abs(high)))).max()
        gaps = {name: np.diff(meta[name]["codebook"]).max() / 2 for name in ("scales", "sh0")}
        return f"{place:.1e} | {gaps['scales']:.4f} | {1 / 510:.4f} | 1.10 | {SH_C0 * gaps['sh0']:.4f} | palette"
    if path.suffix == ".rrd":
        return f"0 | 0 | {1 / 510:.4f} | 0 | {1 / 510:.4f} | half floats"
    return "0 | 0 | 0 | 0 | 0 | 0"


def _fractional_bits(path: Path) -> int:
    import gzip

    content = path.read_bytes()
    return (gzip.decompress(content) if content[:2] == b"\x1f\x8b" else content)[13]


def deviations(theirs: Gaussians, own: Gaussians) -> str:
    """Return the largest deviation of each attribute, as a row of the table."""
    if len(theirs) != len(own):
        return f"**{len(theirs):,} Gaussians** | | | | | "
    signs = np.sign(np.einsum("ij,ij->i", theirs.quats, own.quats))[:, None]
    turns = np.linalg.norm(theirs.quats.astype(np.float64) * signs - own.quats, axis=1)
    worst = (
        np.abs(_logs(theirs) - _logs(own)).max(),
        np.abs(theirs.opacities - own.opacities).max(),
        np.degrees(4 * np.arcsin(np.minimum(turns / 2, 1))).max(),
        np.abs(np.clip(_shown(theirs), 0, 1) - np.clip(_shown(own), 0, 1)).max(),
        np.abs(theirs.sh[:, 1:] - own.sh[:, 1:]).max(initial=0),
    )
    return f"{np.abs(theirs.positions - own.positions).max():.0e} | " + " | ".join(f"{value:.4f}" for value in worst)


def _logs(g: Gaussians) -> np.ndarray:
    return np.log(np.maximum(g.scales, SMALLEST))


def _shown(g: Gaussians) -> np.ndarray:
    return np.asarray(0.5 + SH_C0 * g.sh[:, 0])


def write_all(folder: Path, scene: LabelledScene) -> None:
    for kind in FORMATS:
        if kind.file == "room.tiles3d":
            written_tiles3d(folder / kind.file, scene, PLACE)
        else:
            written = scene.gaussians if kind.file == "bare.ply" else scene
            export(folder / kind.file, written, spz_version=4 if kind.file == "room4.spz" else 3)


def numbers(folder: Path, scene: LabelledScene) -> Iterator[str]:
    yield "| format | MB | read by | positions | scales | opacities | rotations | colours | harmonics | ids | names |"
    yield "|---|--:|---|--:|--:|--:|--:|--:|--:|--:|--:|"
    order = morton_order(scene.gaussians.means)
    for kind in FORMATS:
        path = folder / kind.file
        size = sum(file.stat().st_size for file in ([path] if path.is_file() else path.glob("*"))) / 1e6
        yield f"| {kind.title} | {size:.1f} | *half a step* | {half_steps(path)} | | |"
        own = scene.gaussians.subset(order) if path.suffix == ".sog" else scene.gaussians
        for name, read in kind.readers.items():
            yield f"| | | {name} | {attempt(partial(_read, read, path, own), ' | | | | | ')} | | |"
        if kind.objects is not None:
            yield f"| | | objects | | | | | | | {attempt(partial(objects, kind, path, scene, order), ' | ')} |"


def _read(read: Reader, path: Path, own: Gaussians) -> str:
    return deviations(read(path), own)


def objects(kind: Format, path: Path, scene: LabelledScene, order: np.ndarray) -> str:
    found = kind.objects(path)  # type: ignore[misc]
    own = scene.object_numbers if path.suffix != ".sog" else scene.object_numbers[order]  # type: ignore[index]
    ids = "" if found.ids is None else f"{(found.ids == own).sum():,} of {len(own):,}"  # type: ignore[arg-type]
    names = {thing.name for thing in scene.things}
    return f"{ids} | {len(names & {*found.names})} of {len(names)}"


def attempt(run: Callable[[], str], empty: str) -> str:
    """Return what a program says, or why it does not."""
    try:
        return run()
    except (ImportError, AssertionError, ValueError, RuntimeError, AttributeError, KeyError, TOO_LONG) as error:
        return f"**{type(error).__name__}: {str(error).strip().splitlines()[-1][:90] if str(error) else ''}**{empty}"


def pictures(folder: Path, scene: LabelledScene, view: ds.View, kept: Path | None) -> Iterator[str]:
    from playwright.sync_api import Error as PlaywrightError

    yield "| format | shown by | to our picture | with colours in bytes | widened alike | in bytes | the file, by us |"
    yield "|---|---|--:|--:|--:|--:|--:|"
    scenes = (scene.gaussians, with_colors_in_bytes(scene.gaussians, view))
    own = ds.render(scene.gaussians, view)
    there = own.alpha > THERE
    with a_browser() as browser:
        for kind in FORMATS:
            for viewer in kind.views:
                path = folder / kind.file
                try:
                    shown = pictured(browser, viewer, path, view, where(kind, scene))
                except PlaywrightError:
                    yield f"| {kind.title} | {viewer} | **shows nothing** | | | | |"
                    continue
                ours = [finely(one, view, times) for times in (1, FINER.get(viewer, 1)) for one in scenes]
                near = " | ".join(f"{psnr(shown, picture, there):.1f}" for picture in ours)
                lost = "" if path.is_dir() else f"{psnr(_drawn(path, view), own.rgb, there):.1f}"
                yield f"| {kind.title} | {viewer} | {near} | {lost} |"
                if kept is not None:
                    _save(kept / f"{path.stem}{path.suffix}.{viewer}.png", shown)
    if kept is not None:
        _save(kept / "drsplat.png", np.clip(own.rgb, 0, 1))


def finely(gaussians: Gaussians, view: ds.View, times: int) -> np.ndarray:
    """Return a picture whose Gaussians are widened by 0.3 in so much smaller pixels, at the middles of its own."""
    K = view.K * [[times], [times], [1]]
    K[:2, 2] += (1 - times) / 2
    finer = replace(view, K=K, width=view.width * times, height=view.height * times)
    return ds.render(gaussians, finer).rgb[::times, ::times]


def where(kind: Format, scene: LabelledScene) -> np.ndarray:
    """Return the matrix from the scene's world to the axes in which a viewer has the file."""
    if kind.file == "room.glb":
        return turned(standing_up(np.array(scene.up)))
    if kind.file in Y_UP:
        return turned(HALF_TURN)
    if kind.file != "room.tiles3d":
        return np.eye(4)
    place = (PLACE.longitude, PLACE.latitude, PLACE.height)
    matrix = turned(enu_axes(place).T @ NORTH_UP)
    matrix[:3, 3] = geocentric(np.array([place]))[0]
    return matrix


def _drawn(path: Path, view: ds.View) -> np.ndarray:
    return np.clip(ds.render(ds.read_gaussians(path), view).rgb, 0, 1)


def _save(path: Path, picture: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray((picture * 255).astype(np.uint8)).save(path)


def theirs_to_ours(folder: Path, scene: LabelledScene) -> Iterator[str]:
    yield "| written by | format | MB | positions | scales | opacities | rotations | colours | harmonics |"
    yield "|---|---|--:|--:|--:|--:|--:|--:|--:|"
    for writer, title, write in theirs(folder):

        def row(write: Callable[[], Path] = write) -> str:
            path = write()
            return f"{path.stat().st_size / 1e6:.1f} | {deviations(*paired(path, scene.gaussians))}"

        yield f"| {writer} | {title} | {attempt(row, ' | | | | | | ')} |"


def paired(path: Path, own: Gaussians) -> tuple[Gaussians, Gaussians]:
    """Return a file of others as drsplat reads it, and the rows of the scene that are there.

    A SOG has rows in another order and no list of them: there it is their own decoding of the file.
    """
    read = ds.read_gaussians(path)
    if path.suffix == ".sog":
        return read, by_splat_transform(path)
    if path.name == "g.spz":
        read = _turned(read)
    if len(read) != len(own) or np.abs(read.positions - own.positions).max() < SAME_PLACE:
        return read, own
    from scipy.spatial import cKDTree

    _, nearest = cKDTree(_signature(own)).query(_signature(read))
    return read, own.subset(np.asarray(nearest))


def _signature(g: Gaussians) -> np.ndarray:
    """Return all numbers of each row, so weighted that a step of a format is about 1."""
    turns = (g.quats[:, :, None] * g.quats[:, None]).reshape(len(g), -1)  # the same for a rotation of either sign
    colors = np.clip(_shown(g), 0, 1)
    return np.column_stack(
        [
            2000 * g.positions,
            10 * _logs(g),
            100 * g.opacities,
            100 * colors,
            50 * turns,
            g.sh[:, 1:].reshape(len(g), -1),
        ]
    )


def theirs(folder: Path) -> Iterator[tuple[str, str, Callable[[], Path]]]:
    source = folder / "bare.ply"
    files = {
        "PLY": ("t.ply",), "compressed PLY": ("t.compressed.ply",), "SPZ 3": ("t.spz", "--spz-version", "3"),
        "SPZ 4": ("t4.spz", "--spz-version", "4"), "SOG": ("t.sog",), "GLB": ("t.glb",),
    }  # fmt: skip
    for title, (name, *options) in files.items():

        def transform(name: str = name, options: list[str] = options) -> Path:
            splat_transform(*options, source, folder / name)
            return folder / name

        yield "splat-transform", title, transform

    def gsply_compressed() -> Path:
        import gsply

        gsply.plywrite(str(folder / "g.compressed.ply"), gsply.plyread(str(source)), compressed=True)
        return folder / "g.compressed.ply"

    def gsply_spz() -> Path:
        import gsply

        gsply.write_spz(str(folder / "g.spz"), gsply.plyread(str(source)))
        return folder / "g.spz"

    yield "gsply", "compressed PLY", gsply_compressed
    yield "gsply", "SPZ", gsply_spz


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("demo", type=Path)
    parser.add_argument("--photo", type=int, default=0)
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--tables", nargs="+", default=["numbers", "pictures", "theirs"])
    given = parser.parse_args()
    print(machine.describe())
    scene = labelled(ds.open_scene(given.demo), edits="none")
    view = ds.read_views(given.demo)[given.photo].resized(WIDTH, HEIGHT)
    with tempfile.TemporaryDirectory() as folder:
        write_all(Path(folder), scene)
        rows = {
            "numbers": numbers(Path(folder), scene),
            "pictures": pictures(Path(folder), scene, view, given.pictures),
            "theirs": theirs_to_ours(Path(folder), scene),
        }
        for table in given.tables:
            for row in rows[table]:
                print(row, flush=True)
            print()


if __name__ == "__main__":
    main()
