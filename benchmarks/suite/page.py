"""python -m benchmarks.suite.page docs/evaluation.json --output docs/evaluation.md

Takes docs/answers.json and docs/targets.json beside the results as well, and draws docs/evaluation.svg beside the
page.
"""

import argparse
import json
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from textwrap import fill
from typing import Any

from drsplat.formats.replacing import replacing
from drsplat.query.thresholds import CUT_SHARE

from .headline import Answers, headline_table, picture, places_table, systems_table
from .numbers import Results, masks_of, methods_of
from .papers import SOURCES, papers_table
from .places import SIDE
from .reading import reading
from .rendered import CONTRIBUTORS, DIRECTIONS, ONE_STEP, RENDERED, STEPS, WIDTH
from .tables import methods_table, study_table
from .targets import targets_table

ANSWERS_FILE, TARGETS_FILE = "answers.json", "targets.json"
_HEAD = """\
How well a word finds the thing that is meant, in photos of real places and in made-up rooms whose truth is known to
the pixel. `python -m benchmarks.suite` makes [evaluation.json](evaluation.json), [answers.json](answers.json), and
this page from them; more columns of it, and what was tuned, stood here until 2b6e4a87."""
_TARGETS = """\
A word can mean no thing of a place, one or several, and the answer says which: *no such object* (`certainty` is
"nothing"), *maybe* with the reason, or sure matches, which are counted. Asked were all nouns that the built-in encoder
was taught, in {rooms} made-up rooms (`python benchmarks/study_targets.py ROOM=FIELD...`, which counts
[targets.json](targets.json); few of these words mean several things of a room). `drsplat evaluate` asks LERF-OVS and
ScanNet, whose questions all have a target, with `--present`, so that nothing is refused."""
_HEADLINE = """\
Percent of IoU: what was selected *and* meant, of what was selected *or* meant. *Plain* asks every Gaussian for itself,
*whole objects* is what `drsplat` does. The *best threshold* of the plain field is chosen for each word with the truth:
it says how much a better rule could gain. In brackets are 95 % intervals, over words for CLIP's vectors and over rooms
for the built-in encoder. The last two columns are percent of the present words that found nothing, and of the absent
ones that found something: plain, then whole objects."""
_SYSTEMS = """\
All on the same Gaussians, masks and embeddings (the built-in encoder's), in the made-up rooms. *Selection*: IoU in
photos, with a threshold that is chosen without the truth. *Localization*: how often the best place is on the thing.
*Classes*: IoU of classes of Gaussians, by volume. *Fitted* systems took of their papers' steps: {taken}; no code of
theirs is in it ([rivals](rivals.md))."""
_WORDS = """\
**Words in real captures and rooms.** Things of the captures were outlined by hand in some photos, or came with labels;
photos are {side} pixels wide. Words have genuine CLIP vectors, and masks genuine vectors of pictures that fit these
words; {wrong} % of the masks have a wrong one. IoU is over Gaussians, by the weight that photos give them. Masks are
found by the segmenter that ships (`graph`), *true*, or *simulated*: masks of whole things, as SAM makes them, their
borders up to three pixels off."""
_METHODS = """\
**Methods in rooms, with the built-in encoder.** Masks are *true* (each thing and structure of a photo is one mask) or
found by *graph*; `drsplat-mini`, which never saw these rooms, their shapes or textures, embeds both. Photos with labels
are left out of registration. All methods of a scene share one codebook, that of the mean
([aggregators](aggregators.md))."""
_RENDERED = """\
`{name}` fits features so that their *rendering* matches the embedding of the mask at each pixel, as LangSplat and
LEGaussians do, and looks them up in 3D like all others: our own least-squares form ({directions} directions, {steps}
steps of conjugate gradients, photos {width} pixels wide, {contributors} Gaussians a pixel). `{one_step}` is its
control, the mean on the same coarse pixels and directions: `mean` minus `{one_step}` is what the coarseness costs,
`{one_step}` minus `{name}` what the fitting does."""
_PROTOCOLS = """\
- **Selection**, `lerf-ovs@1`: "red mug" selects Gaussians, these alone are rendered into the labelled photos. Means
  over pairs of photo and category, then over scenes. What stands behind something else shows through it and counts
  as wrong.
- **Volume**, `scannet-volume@1`: classes of free Gaussians by significance-weighted IoU. **Voxel**, `voxel@1`: the
  same classes compared in voxels of {side:g} m.
- **Points**, `scannet-points@1`: one Gaussian frozen at each labelled point, round, as large as the gaps, opacity
  0.9, nothing trained; OpenGaussian trains theirs. So these numbers rank methods, and do not compare with papers.
- The threshold is that of `drsplat select`: the encoder's own ({threshold:.3f}, learned without these scenes), or
  {cut:g} of the query's 40th highest cosine where that is more ([tasks.md](tasks.md)). Papers report thresholds that
  are tuned on the test."""
_COMPARED = """\
`mean`, and each other method minus it, scene by scene, in points of mIoU (`lerf-ovs@1`; `scannet-volume@1`,
`scannet-points@1`, `voxel@1`):"""
_STUDY = """\
Fig. S3 of the paper: how mIoU by Gaussians, with and without significance, correlates with mIoU by voxels, over scenes,
for `mean`."""
_AGAIN = """\
```bash
pip install -e .
# goes on when started again
python -m benchmarks.suite --output docs/evaluation.json \\
    --captures CAPTURE=SCENE.ply ... --clip FOLDER --kept FOLDER
drsplat evaluate lerf-ovs world/scenes --name {scene} \\
    --scene world/scenes/{scene}/scene.compressed.ply --features per_gaussian.npy \\
    --encoder drsplat-mini --report peer     # features of any other system
```"""
_UNSTAMPED = "They are of a run before stamps of the code were kept, so they may be older than the rules of today."
_STALE = "Made by older code than the rest, and not run again: {names}."


def page(results: Results, answers: Answers | None = None, targets: Mapping[str, Any] | None = None) -> str:
    """The whole page, in lines of at most 120 characters where they are prose."""
    return "\n\n".join(map(_wrapped, _sections(results, answers, targets))) + "\n"


def _wrapped(section: str) -> str:
    if section.startswith(("|", "```", "#", "<", "![")):
        return section
    items = re.split(r"\n(?=- )", section)
    return "\n".join(_filled(item, "  " if item.startswith("- ") else "") for item in items)


def _filled(text: str, indent: str) -> str:
    text = " ".join(text.split())
    return fill(text, 120, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def _sections(results: Results, answers: Answers | None, targets: Mapping[str, Any] | None) -> Iterator[str]:
    yield "# Evaluation"
    yield _HEAD
    if targets:
        yield "## No, one or several targets"
        yield _TARGETS.format(rooms=len(targets["rooms"]))
        yield targets_table(targets)
        yield "## How well answers overlap what is meant"
    if answers:
        yield "![Bars of how well answers overlap what is meant, by place](evaluation.svg)"
    yield "\n".join(f"- {sentence}" for sentence in reading(results, answers))
    yield "## Plain, objects, and what is left to gain"
    yield headline_table(results, answers)
    yield _HEADLINE
    yield "## Beside other systems"
    yield systems_table(results)
    yield _SYSTEMS.format(taken=_taken(results))
    yield from _what_is_measured(results, answers)
    yield "## All numbers"
    if answers:
        yield from _folded("Words in every place", [places_table(answers)])
    for masks in sorted(masks_of(results), key=lambda kind: kind != "graph"):
        yield from _folded(f"Every method in rooms, {masks} masks", _of_masks(results, masks))
    if study := study_table(results, "mean"):
        yield from _folded("Does significance stand in for volume?", [_STUDY, study])
    if _efforts(results):
        yield from _folded("What the papers report", [SOURCES, papers_table()])
    yield "## Again"
    yield _AGAIN.format(scene=next(iter(results["scenes"])))
    yield _versions(results)


def _folded(summary: str, sections: Sequence[str] | Iterator[str]) -> Iterator[str]:
    """Sections that GitHub and the site show when somebody asks for them."""
    yield f'<details markdown="1">\n<summary>{summary}</summary>'
    yield from sections
    yield "</details>"


def _what_is_measured(results: Results, answers: Answers | None) -> Iterator[str]:
    yield "## What is measured"
    if answers:
        yield _WORDS.format(side=SIDE, wrong=" or ".join(map(str, answers["wrong"])))
    yield _METHODS
    yield _scenes(results["scenes"].values())
    yield from _folded("Protocols, thresholds and controls", _protocols(results))


def _scenes(scenes: Collection[Mapping[str, Any]]) -> str:
    words = {"things": "things", "photos": "photos", "labelled_photos": "of them labelled", "pairs": "pairs"}
    sums = ", ".join(f"{sum(scene[key] for scene in scenes):,} {word}" for key, word in words.items())
    return (
        f"{len(scenes)} scenes of the [household world](../world/README.md), held out from all that was learned: "
        f"{sums} of photo and category."
    )


def _protocols(results: Results) -> Iterator[str]:
    if RENDERED in methods_of(results, masks_of(results)[0]):
        yield _RENDERED.format(
            name=RENDERED, directions=DIRECTIONS, steps=STEPS[RENDERED], width=WIDTH,
            contributors=CONTRIBUTORS, one_step=ONE_STEP,
        )  # fmt: skip
    yield _PROTOCOLS.format(side=results["voxel_side"], threshold=results["encoder"]["threshold"], cut=CUT_SHARE)


def _taken(results: Results) -> str:
    return ", ".join(f"`{name}` {100 * share:g} %" for name, share in _efforts(results).items()) or "none was run"


def _efforts(results: Results) -> dict[str, float]:
    """By rival that is fitted, the share of its paper's steps."""
    return {record["method"]: record["effort"] for record in results["records"] if "effort" in record}


def _of_masks(results: Results, kind: str) -> Iterator[str]:
    yield _COMPARED if "mean" in methods_of(results, kind) else "Means over the scenes:"
    yield methods_table(results, kind, "mean")


def _versions(results: Results) -> str:
    encoder, segmenter = results["encoder"], results["segmenter"]
    return (
        f"Methods were run with drsplat {results['drsplat']}, encoder {encoder['name']} (weights "
        f"`{encoder['weights']}`), segmenter {segmenter['name']}, version {segmenter['version']} (weights "
        f"`{segmenter['weights']}`), label set {results['label_set']}. {_ages(results)}"
    )


def _ages(results: Results) -> str:
    """Say which records are not of the code that the last run had."""
    if "code" not in results:
        return _UNSTAMPED
    last, records = results["code"], results["records"]
    older: dict[str, set[str]] = {}
    for one in records:
        if one.get("code") != last[one["method"]]:
            older.setdefault(one["masks"], set()).add(f"`{one['method']}`")
    names = "; ".join(f"with masks {masks} {', '.join(sorted(methods))}" for masks, methods in older.items())
    return _STALE.format(names=names) if older else ""


def write_page(results_file: Path, output: Path) -> None:
    """Write the page, and the picture beside it where answers were made."""
    results = json.loads(results_file.read_text(encoding="utf-8"))
    answers, targets = (beside(results_file, name) for name in (ANSWERS_FILE, TARGETS_FILE))
    with replacing(output, overwrite=True) as file:
        file.write(page(results, answers, targets).encode())
    if answers:
        with replacing(output.with_suffix(".svg"), overwrite=True) as file:
            file.write(picture(answers).encode())


def beside(results_file: Path, name: str) -> Any:
    """Return what a JSON file beside the results holds, None where there is none."""
    path = results_file.with_name(name)
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path)
    parser.add_argument("--output", type=Path, required=True, metavar="FILE.md")
    arguments = parser.parse_args()
    write_page(arguments.results, arguments.output)


if __name__ == "__main__":
    main()
