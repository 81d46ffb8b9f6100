"""Time of adding one view to a large field, and of removing it again: part by part, beside that of making it anew.

    python benchmarks/bench_growing.py [--gaussians 1000000] [--views 200] [--masks 150] [--dim 512] [--threads 0]
        [--codes mixture pq given]

A room of Gaussians with the statistics of a trained one (rooms.py), registered for real from cameras inside of it. The
last view is then added to the field's folder, and removed again. `given` has a codebook that was trained elsewhere. The
view is none of those that the code is learnt from, which it is with a chance of 64 in V + 1: then all rows are coded
again, as `all rows` shows. Every file is compared with that of a field registered at once. Seconds of the wall and, in
brackets, of the processor, all threads together.
"""

import tempfile
import time
from pathlib import Path
from typing import ClassVar
from unittest.mock import patch

from machine import arguments
from rooms import SyntheticFeatures, room, room_views

from drsplat import LanguageField, Registration, Sampling, load_field, read_gaussians, register, write_gaussians
from drsplat.base.progress import Stopwatch
from drsplat.field import learning
from drsplat.field.codes import PQ, Codebook, CodeSpecification, Mixture
from drsplat.field.growing import Change, add_views, change_field, remove_views


class BothClocks(Stopwatch):
    """A stopwatch that notes the processor's time as well."""

    noted: ClassVar[dict[str, float]] = {}

    def __init__(self) -> None:
        super().__init__()
        self._busy = time.process_time()

    def lap(self, stage: str) -> None:
        super().lap(stage)
        now = time.process_time()
        self.noted[stage], self._busy = now - self._busy, now


def told(what: str, change: Change, whole: tuple[float, float]) -> None:
    parts = ", ".join(f"{name} {spent:.2f} ({BothClocks.noted[name]:.2f})" for name, spent in change.seconds.items())
    share = change.seconds["code"] / sum(change.seconds.values())
    print(
        f"  {what}: {whole[0]:.2f} s ({whole[1]:.2f}), coding {share:.0%} of it: {parts}; "
        f"{change.num_touched:,} Gaussians seen, {change.num_coded:,} coded",
        flush=True,
    )


def timed(path: Path, gaussians, change) -> tuple[Change, tuple[float, float]]:
    begin, busy = time.perf_counter(), time.process_time()
    done = change_field(path, gaussians, change)
    return done, (time.perf_counter() - begin, time.process_time() - busy)


def same_files(path: Path, other: Path) -> bool:
    return all(file.read_bytes() == (other / file.name).read_bytes() for file in path.glob("*"))


def code_named(name: str, registration: Registration) -> CodeSpecification:
    if name == "given":
        field = registration.to_field(PQ())
        return Codebook(field.codebook.centroids, None, registration.encoder)
    return {"mixture": Mixture(), "pq": PQ()}[name]


def main() -> None:
    args = arguments(
        __doc__, gaussians=1_000_000, views=200, masks=150, dim=512, threads=0, codes=["mixture", "pq", "given"]
    )
    views = room_views(args.views + 1)
    features = SyntheticFeatures(views, args.masks, args.dim)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_gaussians(folder / "scene.ply", room(args.gaussians))
        begin = time.perf_counter()
        gaussians = read_gaussians(folder / "scene.ply")
        print(f"reading the scene, which is beside these: {time.perf_counter() - begin:.2f} s")
        every = register(gaussians, views, features, Sampling(), threads=args.threads)
        drawn = set(learning.learning_views(every.evidence))
        new = {kind: next(view for view in views if (view.name in drawn) == kind) for kind in (False, True)}
        for code in args.codes:
            measure(folder, every, gaussians, features, new, code_named(code, every), f"{code}", args.threads)


def measure(folder, every, gaussians, features, new, code, name, threads) -> None:
    path, whole = folder / "a.field", folder / "whole.field"
    begin, busy = time.perf_counter(), time.process_time()
    field = every.to_field(code, threads=threads)
    spent = time.perf_counter() - begin, time.process_time() - busy
    field.save(whole, overwrite=True)
    size = sum(file.stat().st_size for file in whole.iterdir()) / 2**20
    print(f"{name}: {len(field):,} rows, {every.weights.nnz:,} weights, {size:,.0f} MiB; coding all rows anew takes "
          f"{spent[0]:.1f} s ({spent[1]:.1f})", flush=True)  # fmt: skip
    for is_learnt_from, view in new.items():
        if is_learnt_from and name == "given":
            continue  # from none of these
        every.without([view.name]).to_field(code, threads=threads).save(path, overwrite=True)
        load_field(path).verify()  # what it costs to read from the disk is not ours

        def add(field: LanguageField, view=view) -> Change:
            return add_views(field, gaussians, [view], features, threads=threads)

        def remove(field: LanguageField, view=view) -> Change:
            return remove_views(field, gaussians, [view.name], threads=threads)

        with patch("drsplat.field.growing.changing.Stopwatch", BothClocks), \
             patch("drsplat.field.growing.folder.Stopwatch", BothClocks):  # fmt: skip
            told("one view, all rows" if is_learnt_from else "one view", *timed(path, gaussians, add))
            print(f"    the same bytes as at once: {same_files(path, whole)}")
            if not is_learnt_from:
                told("removing it", *timed(path, gaussians, remove))


if __name__ == "__main__":
    main()
