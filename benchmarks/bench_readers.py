"""Our readers of scene files beside libraries that read the same: seconds, and what becomes of damaged files.

    pip install gsply pygltflib
    python benchmarks/bench_readers.py [--gaussians 1000000] [--damaged 200]

Both read to arrays in memory, after activation. A damaged file is a good one with damage as the tests do it
(`tests/support/mutations.py`), the same for all, each read in a process that has gigabytes to use and seconds for it.
Its outcomes: an error that names the cause (`FormatError` of ours, ValueError of theirs), any other exception, a crash
or no answer in time, or a scene; of those, how many have rows that no Gaussian has (not finite, no rotation, no size).
"""

import io
import multiprocessing
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

from drsplat import read_gaussians
from drsplat.errors import DrSplatError
from drsplat.formats.glb_layout import HARMONICS, OPACITY, POSITION, ROTATION, SCALE
from drsplat.formats.known import write_scene
from drsplat.formats.spz_writing import spz_bytes
from drsplat.scene.gaussians import Gaussians
from drsplat.scene.labelled import LabelledScene

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
sys.path.insert(0, str(Path(__file__).parent.parent / "tests/support"))
from machine import arguments, interleaved

from mutations import mutants

ROUNDS, SMALL, MAX_S, MAX_BYTES = 5, 60, 20, 4 << 30
Arrays = tuple[np.ndarray, ...]  # positions, rotations, sizes, opacities, harmonics in one or several


def scene(rows: int) -> Gaussians:
    rng = np.random.default_rng(0)
    quats = rng.normal(size=(rows, 4)).astype(np.float32)
    return Gaussians(
        rng.uniform(-3, 3, (rows, 3)).astype(np.float32),
        quats / np.linalg.norm(quats, axis=1, keepdims=True),
        np.exp(rng.uniform(-6, -1, (rows, 3))).astype(np.float32),
        rng.uniform(0.02, 0.98, rows).astype(np.float32),
        rng.uniform(-0.9, 0.9, (rows, 4, 3)).astype(np.float32),
    )


def ours(path: Path) -> Arrays:
    read = read_gaussians(path)
    return read.means, read.quats, read.scales, read.opacities, read.sh


def gsply_arrays(path: Path) -> Arrays:
    import gsply

    read = gsply.read_spz(path) if path.suffix == ".spz" else gsply.plyread(path)
    scales, opacities = np.exp(read.scales), 1 / (1 + np.exp(-read.opacities))
    quats = read.quats / np.linalg.norm(read.quats, axis=1, keepdims=True)
    sh = np.concatenate([read.sh0[:, None], read.shN.reshape(len(quats), -1, 3)], axis=1)
    return read.means, quats, scales, opacities, sh


def pygltflib_arrays(path: Path) -> Arrays:
    """Read the accessors of a GLB; pygltflib gives the document and the bytes."""
    import pygltflib

    gltf = pygltflib.GLTF2().load_binary(str(path))
    binary, primitive = gltf.binary_blob(), gltf.meshes[0].primitives[0]
    found = vars(primitive.attributes)

    def column(name: str) -> np.ndarray:
        accessor = gltf.accessors[found[name]]
        view = gltf.bufferViews[accessor.bufferView]
        size = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor.type]
        return np.frombuffer(binary, "<f4", accessor.count * size, view.byteOffset).reshape(-1, size)

    return tuple(column(name) for name in (POSITION, ROTATION, SCALE, OPACITY, *HARMONICS[:4]))


RIVALS: dict[str, dict[str, Callable[[Path], Arrays]]] = {
    ".ply": {"drsplat": ours, "gsply": gsply_arrays},
    ".spz": {"drsplat": ours, "gsply": gsply_arrays},
    ".glb": {"drsplat": ours, "pygltflib": pygltflib_arrays},
}


def write(gaussians: Gaussians, path: Path) -> None:
    if path.suffix == ".spz":
        path.write_bytes(spz_bytes(gaussians))
    else:
        write_scene(path, LabelledScene(gaussians), overwrite=True)


def is_sound(arrays: Arrays) -> bool:
    _, quats, scales, opacities, *_ = arrays
    finite = all(np.isfinite(array).all() for array in arrays)
    return finite and bool(
        (scales > 0).all()
        and ((opacities >= 0) & (opacities <= 1)).all()
        and (np.abs(np.linalg.norm(quats, axis=1) - 1) < 1e-4).all()
    )


def outcome(read: Callable[[Path], Arrays], path: Path) -> str:
    try:
        arrays = read(path)
    except (DrSplatError, ValueError):
        return "refused"
    except Exception as error:
        return f"other exception ({type(error).__name__})"
    return "sound" if is_sound(arrays) else "unsound"


def worked(read: Callable[[Path], Arrays], places: "multiprocessing.Queue[Path | None]", answers: object) -> None:
    """Answer for one file after another, until there is none."""
    import resource

    sys.stdout, sys.stderr = io.StringIO(), io.StringIO()
    np.seterr(all="ignore")
    resource.setrlimit(resource.RLIMIT_AS, (MAX_BYTES, MAX_BYTES))
    while (path := places.get()) is not None:
        answers.put(outcome(read, path))  # type: ignore[attr-defined]


def outcomes(read: Callable[[Path], Arrays], files: list[Path]) -> Counter[str]:
    """Read files in a process of their own, another one after each that ends or does not answer in time."""
    context, counts = multiprocessing.get_context("fork"), Counter[str]()
    process = None
    for path in files:
        if process is None or not process.is_alive():
            places, answers = context.Queue(), context.Queue()
            process = context.Process(target=worked, args=(read, places, answers), daemon=True)
            process.start()
        places.put(path)
        counts[_answer(process, answers)] += 1
    places.put(None)
    process.join()
    return counts


def _answer(process: object, answers: object) -> str:
    end = time.monotonic() + MAX_S
    while time.monotonic() < end:
        try:
            return str(answers.get(timeout=0.2))  # type: ignore[attr-defined]
        except Exception:
            if not process.is_alive():  # type: ignore[attr-defined]
                return "crash"
    process.kill()  # type: ignore[attr-defined]
    process.join()  # type: ignore[attr-defined]
    return "no answer"


def main() -> None:
    given = arguments(__doc__, gaussians=1_000_000, damaged=200)
    with tempfile.TemporaryDirectory() as folder:
        for suffix, rivals in RIVALS.items():
            path = Path(folder) / f"scene{suffix}"
            write(scene(given.gaussians), path)
            readers = {name: (lambda read=read, path=path: read(path)) for name, read in rivals.items()}
            seconds = interleaved(readers, ROUNDS, time.process_time)
            print(f"{suffix}: {given.gaussians:,} Gaussians of degree 1, {path.stat().st_size / 1e6:.0f} MB")
            for name, taken in seconds.items():
                ratio = np.median(taken) / np.median(seconds["drsplat"])
                print(f"  {name:10s} {np.median(taken):6.2f} CPU s, {ratio:5.2f} x ours")
            write(scene(SMALL), path)
            good, files = path.read_bytes(), []
            for number, damaged in enumerate(mutants(good, np.random.default_rng(1), given.damaged)):
                files.append(Path(folder) / f"{number}{suffix}")
                files[-1].write_bytes(damaged)
            for name, read in rivals.items():
                counts = ", ".join(f"{count} {what}" for what, count in sorted(outcomes(read, files).items()))
                print(f"  {given.damaged} damaged, {name}: {counts}")


if __name__ == "__main__":
    main()
