"""What a photo costs with `graph`: its stages beside their twins on NumPy and scikit-image.

    python benchmarks/bench_masks.py [--photo FILE ...] [--rounds 5]

The stages are timed in turns with their twins, on one thread: the least CPU seconds of all rounds, their mean over the
photos. Without --photo it cuts a made picture of 640x480 pixels.
"""

import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from machine import arguments, forget_peak, resident_mib
from PIL import Image
from skimage.segmentation import felzenszwalb

from drsplat.kernels import photo_regions as native
from drsplat.photos.models.graph import GraphSegmenter
from drsplat.photos.models.graph import segmenter as graph
from drsplat.photos.models.graph.segmenter import layers_of

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests/support"))

from twins import photo_network
from twins import photo_regions as twin
from twins.photo_merging import Merging, likelihood


class Stages:
    """The stages of `graph` for one photo; each is given what those before it made, by name."""

    def __init__(self, image: np.ndarray) -> None:
        segmenter = GraphSegmenter(threads=1)
        self.image, self.rule, settings = image, segmenter.rule, segmenter.settings
        self.layers, share = layers_of(segmenter.network), graph.working_share(image[..., 0].size)
        self.limits = float(self.rule.threshold[0]), settings.least_area * share, settings.least_width
        self.scale, self.least = graph.MERGE_SCALE * share, round(graph.MIN_AREA_PIXELS * share)

    def twins(self) -> dict[str, Callable[[dict], object]]:
        return {
            "colours": lambda _: twin.lab_colors(self.image),
            "small regions": lambda made: felzenszwalb(
                made["colours"] / native.LAB_STEPS, self.scale, graph.BLUR_PIXELS, self.least
            ).astype(np.int32),
            "network": lambda _: photo_network.look(self.image, self.layers),
            "sums": lambda made: twin.region_graph(made["small regions"], made["colours"], made["network"]),
            "merging": lambda made: self._merged_by_twin(made["sums"]),
        }

    def natives(self) -> dict[str, Callable[[dict], object]]:
        return {
            "colours": lambda _: native.lab_colors(self.image, threads=1),
            "small regions": lambda made: native.small_regions(made["colours"], self.scale / 255, self.least),
            "network": lambda _: native.look(self.image, self.layers, threads=1),
            "sums": lambda made: native.region_graph(made["small regions"], made["colours"], made["network"]),
            "merging": lambda made: native.merged_regions(made["sums"], self.rule.parts, *self.limits),
        }

    def _merged_by_twin(self, graph: native.RegionGraph) -> np.ndarray:
        merging = Merging(graph, partial(likelihood, self.rule))
        merging.merge_above(self.limits[0])
        merging.merge_small(*self.limits[1:])
        return merging.labels()


def done(stages: dict[str, Callable[[dict], object]]) -> tuple[dict[str, Any], np.ndarray]:
    """What all stages make, and the CPU seconds of each."""
    made: dict[str, Any] = {}
    seconds = []
    for name, stage in stages.items():
        start = time.process_time()
        made[name] = stage(made)
        seconds.append(time.process_time() - start)
    return made, np.array(seconds)


def peak_growth(run: Callable[[], object]) -> float:
    """MiB that a run takes at most beyond what the process holds."""
    forget_peak()
    before = resident_mib(peak=False)
    run()
    return resident_mib(peak=True) - before


def made_picture() -> np.ndarray:
    """Overlapping discs in light from above, with noise."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:480, :640]
    picture = np.full((480, 640, 3), 140.0)
    for radius in rng.uniform(10, 120, 60):
        middle, color = rng.uniform(0, (480, 640)), rng.uniform(30, 230, 3)
        light = 1 - 0.4 * np.clip((y - middle[0]) / radius, 0, 1)
        disc = np.hypot(y - middle[0], x - middle[1]) < radius
        picture[disc] = (light[..., None] * color)[disc]
    return np.clip(picture + rng.normal(0, 3, picture.shape), 0, 255).astype(np.uint8)


def bench_graph(photos: Sequence[str], rounds: int) -> None:
    images = [np.asarray(Image.open(photo).convert("RGB")) for photo in photos] or [made_picture()]
    first_stages = Stages(np.ascontiguousarray(graph.working_image(images[0])))
    fast_peak, slow_peak = (
        peak_growth(lambda made=made: done(made)) for made in (first_stages.natives(), first_stages.twins())
    )
    seconds, ties, others = np.zeros((2, 5)), 0, 0
    for image in images:
        stages = Stages(np.ascontiguousarray(graph.working_image(image)))
        least = np.full((2, 5), np.inf)
        for _ in range(rounds):
            (before, first), (after, second) = done(stages.twins()), done(stages.natives())
            least = np.minimum(least, [first, second])
        seconds += least / len(images)
        ties += bool((before["small regions"] != after["small regions"]).any())
        others += bool((before["merging"][before["small regions"]] != after["merging"][after["small regions"]]).any())
    print(f"graph, {len(images)} photos, CPU seconds of one, least of {rounds}: twin, native")
    for name, (slow, fast) in zip([*stages.natives(), "all"], np.c_[seconds, seconds.sum(1)].T, strict=True):
        print(f"{name:<44} {slow:8.3f} {fast:8.3f}")
    print(
        f"{ties} photos with other small regions, where scikit-image takes equal ones otherwise; {others} other masks"
    )
    print(f"memory of the first photo at most {slow_peak:.0f} and {fast_peak:.0f} MiB")
    timed("segment, with masks at full size", lambda: GraphSegmenter(threads=1).segment(images[-1]), rounds)


def timed(name: str, run: Callable[[], object], rounds: int) -> None:
    """The median of some rounds after a warm-up, or one run without."""
    if rounds > 1:
        run()
    walls, cpus = [], []
    for _ in range(rounds):
        wall, cpu = time.perf_counter(), time.process_time()
        run()
        walls.append(time.perf_counter() - wall)
        cpus.append(time.process_time() - cpu)
    print(
        f"{name:<44} {np.median(walls):7.2f} s wall (median of {rounds}; {min(walls):.2f} to "
        f"{max(walls):.2f}), {np.median(cpus):7.2f} s CPU"
    )


def main() -> None:
    args = arguments(__doc__, rounds=5, photo=[""])
    bench_graph([photo for photo in args.photo if photo], args.rounds)


if __name__ == "__main__":
    main()
