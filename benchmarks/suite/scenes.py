"""A packed scene as the protocols need it."""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Int32
from PIL import Image
from scipy.spatial import cKDTree
from world.packing import SCENE

from drsplat import Gaussians, View, read_gaussians, read_views
from drsplat.evaluation.lerf_ovs import LerfScene, read_lerf_scene, without_labelled
from drsplat.evaluation.scannet import ScannetScene, label_set, read_nyu40_scene
from drsplat.formats.tensors import hash_file
from drsplat.kernels import splat_arrays, view_weights

LABEL_SET = "household"
OPACITY = 0.9  # of Gaussians that stand for labelled points
NEIGHBOURS = 3  # their size is the mean distance to these, as 3DGS starts from points
LEAST_SIZE = 1e-4  # metres: points may coincide


@dataclass(frozen=True, eq=False)
class BenchScene:
    """views: without the labelled ones. volume: the trained Gaussians; points: frozen at the labelled points."""

    folder: Path
    views: list[View]
    lerf: LerfScene
    volume: ScannetScene
    points: ScannetScene

    @property
    def name(self) -> str:
        return self.lerf.name

    @property
    def gaussians(self) -> Gaussians:
        return self.volume.gaussians

    def ids(self, view: View) -> Int32[np.ndarray, "h w"]:
        """What each pixel of a photo shows, -1 for nothing."""
        stored = Image.open(self.folder / "ids" / f"{Path(view.name).stem}.png")
        return np.asarray(stored).astype(np.int32) - 1


def read_scene(folder: Path, every: int = 1) -> BenchScene:
    """A folder of `world.packing`. every: takes one in so many of the views."""
    folder = folder.resolve()
    labels = label_set(LABEL_SET)
    lerf = read_lerf_scene(folder.parent, folder.name)
    volume = read_nyu40_scene(folder, labels, read_gaussians(folder / SCENE))
    frozen = at_points(volume.points.positions)
    points = ScannetScene(folder.name, volume.points, labels, frozen)
    views = without_labelled(read_views(folder), lerf)[::every]
    return BenchScene(folder, views, lerf, volume, points)


def owners(folder: Path, gaussians: Gaussians, views: list[View], count: int) -> np.ndarray:
    """The id of each Gaussian's thing or structure, -1 where no photo shows it."""
    splats, votes = splat_arrays(gaussians), np.zeros((len(gaussians), count))
    for view in views:
        path = folder / "ids" / f"{Path(view.name).stem}.png"
        stored = Image.open(path).resize((view.width, view.height), Image.Resampling.NEAREST)
        found = view_weights(splats, view, np.asarray(stored).astype(np.int32) - 1, None)
        np.add.at(votes, (found.gaussian_ids, found.mask_ids), found.weights)
    return np.where(votes.any(axis=1), votes.argmax(axis=1), -1)


def at_points(positions: np.ndarray) -> Gaussians:
    """A round grey Gaussian at each point, as large as the gaps between them: nothing is trained."""
    count = len(positions)
    distances, _ = cKDTree(positions).query(positions, NEIGHBOURS + 1)
    sizes = np.maximum(distances[:, 1:].mean(1), LEAST_SIZE)
    return Gaussians(
        means=np.ascontiguousarray(positions, np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        scales=np.repeat(sizes[:, None], 3, axis=1).astype(np.float32),
        opacities=np.full(count, OPACITY, np.float32),
        sh=np.zeros((count, 1, 3), np.float32),
    )


def about(scene: BenchScene) -> dict[str, object]:
    """What it holds, and hashes of what is scored."""
    truth = json.loads((scene.folder / "truth.json").read_text(encoding="utf-8"))
    labels = sorted((scene.folder.parent / "label" / scene.name).glob("*.json"))
    cloud = scene.folder / f"{scene.name}_vh_clean_2.labels.ply"
    files = [scene.folder / SCENE, cloud, *labels]
    return {
        "seed": truth["seed"],
        "cameras": truth["cameras"],
        "things": len(truth["objects"]),
        "photos": len(scene.views),
        "labelled_photos": len(scene.lerf.frames),
        "pairs": len(scene.lerf.pairs),
        "gaussians": len(scene.gaussians),
        "points": len(scene.points.gaussians),
        "files": {path.name: hash_file(path) for path in files},
        "photos_and_truth": _hash_together(scene.folder),
    }


def _hash_together(folder: Path) -> str:
    """Of photos, poses, and what the photos show."""
    paths = [path for part in ("images", "ids", "sparse") for path in (folder / part).rglob("*.*")]
    digest = hashlib.blake2b(digest_size=16)
    for path in sorted(path for path in paths if path.is_file()):
        digest.update(f"{path.relative_to(folder).as_posix()} {hash_file(path)}\n".encode())
    return digest.hexdigest()
