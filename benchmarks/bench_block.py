"""A city's block from photos to a query, stage by stage: time, memory and disk against the number of views.

    drsplat demo --output-dir demo
    python benchmarks/bench_block.py demo OFFICIAL FOLDER [--views 50 100 200 400] [--rooms 30] [--side 80]
    python benchmarks/bench_block.py demo OFFICIAL FOLDER --views 100 --blocks 3 --ray    # two Ray nodes

A block is a street of copies of the demo's room: 30 of them have 3 million Gaussians. Several --blocks lie side by
side, overlap by a tenth of a room, and keep half of that each. --views: photos of each room, of --side pixels, from
slightly other places.

Every stage is a command of its own, as people would give it: `drsplat tile`, the embedding of photos, `drsplat
register`, `drsplat objects`, `drsplat locate`. Masks are the demo's, on smaller photos. Embeddings are drawn with the
statistics of a published CLIP codebook, OFFICIAL's (drawn_embeddings.py): each of 40 kinds of masks is a thing, and
each mask another view of it. So the embedding stage has all but the networks.

Memory is what all processes of a stage held together, looked at every 20 ms: their own (anonymous), and with the pages
of files that they had mapped. With --ray two nodes of one processor each run the tasks, and seconds of the processor
are those of the whole machine, which should have nothing else to do.
"""

import hashlib
import json
import os
import shutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from bench_tiles import step_of, walk
from check_ray import children, cluster
from costs import cost_of
from drawn_embeddings import CLIP, Drawn
from machine import arguments
from PIL import Image

import drsplat as ds
from drsplat.field.codes.mixture.scene_atoms import spherical_kmeans
from drsplat.formats.colmap_binary import write_colmap
from drsplat.formats.langsplat import FeatureFolder, level_index, write_features
from drsplat.photos.embedding.embed import embed
from drsplat.scene.gaussians import concatenated

KINDS = 40
APART = 0.9  # of a room, from a block to the next one
DRSPLAT = [sys.executable, "-m", "drsplat"]
EACH = ["--threads", "1", "--json"]


class Drawing:
    """Encoder of crops: what the built-in one sees in a crop says which kind of thing it is, and that is drawn."""

    identity = CLIP
    threads = 1

    def __init__(self, official: Path, seen: np.ndarray) -> None:
        self.drawn, self.mini = Drawn(official), ds.MiniEncoder()
        self.kinds = spherical_kmeans(seen, KINDS, 0, threads=1)
        self.things = self.drawn.things(KINDS)
        self._kind_of: dict[bytes, int] = {}

    def on_one_thread(self) -> "Drawing":
        return self

    def encode_images(self, images: Sequence[np.ndarray]) -> np.ndarray:
        return self.drawn.masks(self.things[[self._kind(image) for image in images]])

    def _kind(self, image: np.ndarray) -> int:
        key = hashlib.blake2b(image.tobytes()).digest()
        if key not in self._kind_of:
            self._kind_of[key] = int((self.kinds @ self.mini.encode_images([image])[0]).argmax())
        return self._kind_of[key]


class Stage(NamedTuple):
    """A command, and what it leaves on disk."""

    command: list[str]
    left: Path | None


class Block(NamedTuple):
    """What a run is about. place: where it is written."""

    demo: Path
    place: Path
    rooms: int
    blocks: int
    side: int


def write_scene(block: Block) -> None:
    """Write the Gaussians of a block, and where the blocks lie."""
    room = ds.read_gaussians(block.demo / "scene.compressed.ply")
    step = step_of(room)
    rooms = [replace(room, means=room.means + np.array([k * step, 0, 0], np.float32)) for k in range(block.rooms)]
    ds.write_gaussians(block.place / "block.ply", concatenated(rooms))
    low, high = np.quantile(room.means[:, 1], (0.001, 0.999))
    entries = []
    for number in range(block.blocks):
        place, keep = np.eye(4), {"low": [-1e6] * 3, "high": [1e6] * 3}
        place[1, 3] = number * APART * (high - low)
        if number > 0:
            keep["low"][1] = place[1, 3] + low + (1 - APART) / 2 * (high - low)
        if number < block.blocks - 1:
            keep["high"][1] = place[1, 3] + high - (1 - APART) / 2 * (high - low)
        entries.append({"file": "block.ply", "transform": place.tolist(), "keep": keep})
    (block.place / "blocks.json").write_text(json.dumps(entries))


def write_seeds(block: Block) -> list[ds.View]:
    """Write the demo's photos and masks, smaller; return its views."""
    features = FeatureFolder(block.demo / "language_features", level_index("large"))
    views = [view for view in ds.read_views(block.demo) if Path(view.name).stem in features]
    (block.place / "photos").mkdir()
    for view in views:
        small, stem = view.limited(block.side), Path(view.name).stem
        assert view.image_path is not None
        Image.open(view.image_path).resize((small.width, small.height)).save(block.place / "photos" / f"{stem}.jpg")
        mask_ids, embeddings = features.stored(stem)
        rows = ((np.arange(small.height) + 0.5) * mask_ids.shape[-2] / small.height).astype(int)
        columns = ((np.arange(small.width) + 0.5) * mask_ids.shape[-1] / small.width).astype(int)
        write_features(block.place / "masks", stem, mask_ids[..., rows[:, None], columns], embeddings, form="compact")
    return views


def write_capture(block: Block, views: list[ds.View], per_room: int) -> Path:
    """Write the photos of the street, their cameras and their masks; photos of one picture are one file."""
    capture = block.place / f"capture{per_room}"
    room = ds.read_gaussians(block.demo / "scene.compressed.ply")
    low, high = np.quantile(room.means[:, 1], (0.001, 0.999))
    street, seed_of = walk(views, block.rooms, per_room, step_of(room), block.side)
    walked, seeds = [], {}
    for number in range(block.blocks):
        for view in street:
            pose = view.cam_from_world.copy()
            pose[:3, 3] -= pose[:3, 1] * number * APART * (high - low)
            walked.append(replace(view, name=f"block{number}_{view.name}", cam_from_world=pose))
        seeds |= {f"block{number}_{stem}": seed for stem, seed in seed_of.items()}
    for folder in ("sparse", "images", "masks"):
        (capture / folder).mkdir(parents=True)
    write_colmap(capture / "sparse", walked, np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
    ending = ".features.safetensors"
    for stem, seed in seeds.items():
        os.link(block.place / f"photos/{seed}.jpg", capture / f"images/{stem}.jpg")
        os.link(block.place / f"masks/{seed}{ending}", capture / f"masks/{stem}{ending}")
    return capture


def embed_photos(official: Path, capture: Path) -> None:
    """Embed the masks of a capture, in a process of its own."""
    masks = FeatureFolder(capture / "masks", level_index("large"))
    seeds = [masks.stored(name)[1] for name in sorted(masks)[:KINDS]]
    encoder = Drawing(official, np.concatenate(seeds))
    embed(ds.read_views(capture), capture / "language_features", masks, encoder)
    np.save(capture / "query.npy", encoder.drawn.texts(encoder.things[:1])[0])


def machine_seconds() -> float:
    """Return the processor's seconds of the whole machine so far, in user and system."""
    user, nice, system = Path("/proc/stat").read_text().split()[1:4]
    return (int(user) + int(nice) + int(system)) / os.sysconf("SC_CLK_TCK")


def bytes_on_disk(place: Path) -> int:
    return sum(file.stat().st_size for file in place.rglob("*") if file.is_file())


def stages_of(block: Block, official: Path, capture: Path, ray: str | None) -> dict[str, Stage]:
    """Return the command of each stage, and what it leaves on disk."""
    tiles, field, parts = (capture.with_suffix(f".{kind}") for kind in ("tiles", "field", "parts"))
    features, query = capture / "language_features", capture / "query.npy"
    spread = ["--parts", parts, *(["--ray", ray] if ray else [])]
    commands: dict[str, tuple[list[object], Path | None]] = {
        "tile": (["tile", block.place / "blocks.json", "-o", tiles], tiles),
        "embed": ([official, capture], features),
        "register": (["register", tiles, capture, "--features", features, "-o", field, *spread], parts),
        "objects": (["objects", field, "--scene", tiles, *spread], field),
        "locate": (["locate", field, "--vector", query, "--scene", tiles], None),
    }
    own = {"embed": [sys.executable, __file__, "--embed"]}
    return {
        name: Stage([*own.get(name, DRSPLAT), *map(str, given), *([] if name in own else EACH)], left)
        for name, (given, left) in commands.items()
    }


def run(block: Block, official: Path, per_room: int, views: list[ds.View], ray: str | None) -> None:
    """Go through all stages for one number of views, and print a row for each."""
    capture = write_capture(block, views, per_room)
    stages = stages_of(block, official, capture, ray)
    for name, stage in stages.items():
        on_ray = ray is not None and name in ("register", "objects")
        cost = cost_of(stage.command, machine_seconds, partial(children, "ray::")) if on_ray else cost_of(stage.command)
        held = f"{cost.own / 2**30:.2f}", f"{cost.whole / 2**30:.2f}"
        disk = f"{bytes_on_disk(stage.left) / 2**30:.2f}" if stage.left else ""
        row = (
            f"{block.blocks * block.rooms * per_room:,}",
            name,
            f"{cost.clock_s:.0f}",
            f"{cost.cpu_s:.1f}",
            *held,
            disk,
        )
        print("|".join(("", *row, "")), flush=True)
    made, found = ds.load_field(capture.with_suffix(".field")), json.loads(cost.output)
    assert made.evidence is not None
    assert made.objects is not None
    print(
        f"{len(made):,} Gaussians with a feature, {made.evidence.weights.nnz:,} weights, {len(made.objects)} objects, "
        f"{len(found['matches'])} matches", flush=True
    )  # fmt: skip
    for folder in (capture, *(stage.left for stage in stages.values() if stage.left)):
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def two_nodes(wanted: bool) -> Iterator[str | None]:
    os.environ["RAY_AUTH_MODE"] = "disabled"  # nobody else is on this machine's port
    with cluster() if wanted else nullcontext((None, None)) as (address, _):
        yield address


def main() -> None:
    if sys.argv[1:2] == ["--embed"]:
        embed_photos(*map(Path, sys.argv[2:]))
        return
    given = arguments(
        __doc__, "demo", "official", "folder", views=[50, 100, 200, 400], rooms=30, blocks=1, side=80, ray=False
    )
    block = Block(given.demo, given.folder, given.rooms, given.blocks, given.side)
    given.folder.mkdir(parents=True)
    write_scene(block)
    views = write_seeds(block)
    print("|views|stage|s|CPU s|GiB own|with maps|GiB on disk|\n|--:|---|--:|--:|--:|--:|--:|")
    with two_nodes(given.ray) as address:
        for per_room in given.views:
            run(block, given.official, per_room, views, address)


if __name__ == "__main__":
    main()
