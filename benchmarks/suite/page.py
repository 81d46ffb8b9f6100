"""python -m benchmarks.suite.page docs/evaluation.json --output docs/evaluation.md"""

import argparse
import json
import re
from collections.abc import Iterator
from pathlib import Path
from textwrap import fill

from drsplat.formats.replacing import replacing
from drsplat.query.thresholds import CUT

from .numbers import Results, masks_of, measured, methods_of
from .papers import SOURCES, papers_table
from .reading import reading
from .rendered import CONTRIBUTORS, DIRECTIONS, ONE_STEP, RENDERED, STEPS, WIDTH
from .tables import (
    SEGMENTATION,
    SELECTION,
    against_table,
    files_table,
    measures_table,
    scenes_table,
    study_table,
    thresholds_table,
)

_HEAD = """\
This page is made from [evaluation.json](evaluation.json) by `python -m benchmarks.suite.page`, and a test holds it to
that: no number here is typed. Numbers are percent. In brackets is the 95 % interval of the mean over scenes, by
bootstrap; scenes are what is drawn again, so it says how other scenes of this world would do, and nothing about real
photos."""
_METHODS = """\
Masks are *true* (each thing and structure of a photo is one mask) or found by the built-in segmenter *graph*; the
built-in encoder `drsplat-mini` embeds both. It never saw these rooms, their shapes or textures. Photos with labels
are left out of registration. All methods of a scene share one codebook, that of the mean. Aggregators are those of
[aggregators.md](aggregators.md)."""
_RENDERED = """\
`{name}` is no aggregator but the rival: features that are fitted so that their *rendering* matches the embedding of
the mask at each pixel, as LangSplat and LEGaussians optimise theirs, and then looked up in 3D like all others. It is
our own least-squares form of that idea ({directions} directions, {steps} steps of conjugate gradients, photos {width}
pixels wide, {contributors} Gaussians a pixel), not their code. `{one_step}` is its control: one step from zero is the
mean on the same coarse pixels and directions. So `mean` minus `{one_step}` is what the coarseness costs, and
`{one_step}` minus `{name}` what the fitting does."""
_FITTED = """\
Rivals that are fitted from their papers ([rivals](rivals.md), where their costs are) took of their papers' steps:
{taken}. `centre-pixel` is Occam's LGS, `vala` and `vala-scannet` are VALA."""
_PROTOCOLS = """\
- **Selection**, `lerf-ovs@1`: "red mug" selects Gaussians, these alone are rendered into the labelled photos. Means
  over pairs of photo and category, then over scenes. *Seen* is the same of where the selection is more than half of
  the picture of the whole scene: alone, what stands behind something else shows through it and counts as
  wrong.{missing}
- **Volume**, `scannet-volume@1`: classes of free Gaussians by significance-weighted IoU; fixed, automatic and tuned
  are localization, one class at a time by threshold. **Voxel**, `voxel@1`: the same classes compared in voxels of
  {side:g} m.
- **Points**, `scannet-points@1`: one Gaussian frozen at each labelled point, round, as large as the gaps, opacity
  0.9, nothing trained; OpenGaussian trains theirs. So these numbers rank methods, and do not compare with papers.
- Thresholds: *fixed* is the encoder's own ({threshold:.3f}), learned without these scenes. *Automatic* is that of
  `drsplat select`: the fixed one, or {cut:g} of the query's 40th highest cosine where that is more
  ([tasks.md](tasks.md)). *Tuned on test* is the best of {sweep} on the very scenes that it is scored on, as papers
  report it: never compare it with the other two."""
_MISSING = " This run did not measure it: make it again."
_AGAIN = """\
```bash
pip install -e .
python -m benchmarks.suite --output docs/evaluation.json --jobs 2      # goes on where it was when started again
python -m benchmarks.suite.page docs/evaluation.json --output docs/evaluation.md
drsplat evaluate lerf-ovs world/scenes --name {scene} --scene world/scenes/{scene}/scene.compressed.ply \\
    --features per_gaussian.npy --encoder drsplat-mini --report peer     # features of any other system
```"""


def page(results: Results) -> str:
    """The whole page, in lines of at most 120 characters where they are prose."""
    return "\n\n".join(map(_wrapped, _sections(results))) + "\n"


def _wrapped(section: str) -> str:
    if section.startswith(("|", "```", "#")):
        return section
    items = re.split(r"\n(?=- )", section)
    return "\n".join(_filled(item, "  " if item.startswith("- ") else "") for item in items)


def _filled(text: str, indent: str) -> str:
    text = " ".join(text.split())
    return fill(text, 120, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def _sections(results: Results) -> Iterator[str]:
    masks, scenes = masks_of(results), results["scenes"]
    yield "# Evaluation"
    yield _HEAD
    yield "## What the numbers say"
    yield "\n".join(f"- {sentence}" for sentence in reading(results))
    yield from _what_is_measured(results)
    for kind in masks:
        yield from _of_masks(results, kind)
    if _efforts(results):
        yield "## What the papers report"
        yield SOURCES
        yield papers_table()
    yield "## Thresholds that were tuned on the test"
    yield thresholds_table(results, masks)
    yield "## Does significance stand in for volume?"
    yield ("Fig. S3 of the paper: mIoU by Gaussians, with and without significance, beside mIoU by voxels, for `mean`.")
    for kind in masks:
        if "mean" in methods_of(results, kind):
            yield f"{kind} masks:"
            yield study_table(results, kind, "mean")
    yield "## Again"
    yield _AGAIN.format(scene=next(iter(scenes)))
    yield _versions(results)
    yield files_table(results)


def _what_is_measured(results: Results) -> Iterator[str]:
    yield "## What is measured"
    number = len(results["scenes"])
    yield f"{number} scenes of the [household world](../world/README.md), held out from all that was learned."
    yield scenes_table(results)
    yield _METHODS
    if RENDERED in methods_of(results, masks_of(results)[0]):
        yield _RENDERED.format(
            name=RENDERED, directions=DIRECTIONS, steps=STEPS[RENDERED], width=WIDTH,
            contributors=CONTRIBUTORS, one_step=ONE_STEP,
        )  # fmt: skip
    if efforts := _efforts(results):
        taken = ", ".join(f"`{name}` {100 * share:g} %" for name, share in efforts.items())
        yield _FITTED.format(taken=taken)
    yield _PROTOCOLS.format(
        side=results["voxel_side"],
        missing="" if measured(results, "seen") else _MISSING,
        threshold=results["encoder"]["threshold"],
        cut=CUT,
        sweep=", ".join(f"{threshold:g}" for threshold in results["sweep"]),
    )


def _efforts(results: Results) -> dict[str, float]:
    """By rival that is fitted, the share of its paper's steps."""
    return {record["method"]: record["effort"] for record in results["records"] if "effort" in record}


def _of_masks(results: Results, kind: str) -> Iterator[str]:
    yield f"## {kind.capitalize()} masks"
    yield "Selection (`lerf-ovs@1`):"
    yield measures_table(results, kind, SELECTION)
    yield (
        "Classes (`scannet-volume@1`, `scannet-points@1`, `voxel@1`), and localization by threshold "
        "(`scannet-volume@1`):"
    )
    yield measures_table(results, kind, SEGMENTATION)
    if "mean" in methods_of(results, kind):
        yield "Minus `mean`, scene by scene:"
        yield against_table(results, kind, "mean")


def _versions(results: Results) -> str:
    encoder, segmenter = results["encoder"], results["segmenter"]
    return (
        f"Made with drsplat {results['drsplat']}, encoder {encoder['name']} (weights `{encoder['weights']}`), "
        f"segmenter {segmenter['name']}, version {segmenter['version']} (weights `{segmenter['weights']}`), label set "
        f"{results['label_set']}. Scenes:"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", type=Path)
    parser.add_argument("--output", type=Path, required=True, metavar="FILE.md")
    arguments = parser.parse_args()
    text = page(json.loads(arguments.results.read_text(encoding="utf-8")))
    with replacing(arguments.output, overwrite=True) as file:
        file.write(text.encode())


if __name__ == "__main__":
    main()
