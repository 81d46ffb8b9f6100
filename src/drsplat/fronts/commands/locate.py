"""drsplat locate: words, a picture or a click -> the things in the scene."""

from typing import Literal

from ...base.terminal import counted
from ...query.defaults import MIN_GAUSSIANS
from .declaring import Facts, count, declaration, flag, option, part
from .options import Verb
from .query_options import Outputs, Question, answer_json, ask, draw, measured_text, print_doubt
from .tables import place_text, show_table, text_of

EXAMPLES = """\
  drsplat locate room.field "red mug" --scene scene.ply
  drsplat locate room.field "mug, not red" --scene scene.ply --threshold auto
  drsplat locate room.field "red mug" --encoder laion/CLIP-ViT-B-16-laion2B-s34B-b88K --scene scene.ply
  drsplat locate room.field --image my_mug.png --encoder models/clip --threshold 0.6 --scene scene.ply
  drsplat locate room.field --click photo_003:210,140 --views capture --scene scene.ply
  drsplat locate room.field "red mug" --vocabulary clip_texts.json --relevancy --scene scene.ply --top 3
  drsplat locate room.field --vector query.npy --threshold 0.25 --scene scene.ply --save found.ply
  drsplat locate film.field "toy car" --scene film.motion --tracks --during 0 0.5
  drsplat locate room.field "red mug" --scene scene.ply --picture mug.png --views capture --view photo_003

Which threshold? Cosines between texts of one encoder are near 1 for a match; those between texts and photos in CLIP
seldom exceed 0.3. Relevancy has the same scale for every encoder and is the measure for words with --encoder. With
--threshold auto, each query has its own threshold. For other queries, look at the printed range."""
DAILY = "scene threshold top encoder save picture views overwrite click"


@declaration
class Options(Verb):
    """Options of this verb."""

    question: Question = part(Question)
    top: int = option("matches to list, best first (default: 10)", "N", count, 10)
    min_gaussians: int = option(
        f"minimum number of Gaussians in a match (default: {MIN_GAUSSIANS})", "N", count, MIN_GAUSSIANS
    )
    box: Literal["upright", "free"] = option(
        "upright: boxes stand upright, if the photos show which way is up; free: boxes follow the match's own axes "
        "(default: upright)", default="upright", choices=("upright", "free"),
    )  # fmt: skip
    tracks: bool = flag("list where each match is at all times of a moving scene, and when photos see it")
    outputs: Outputs = part(
        Outputs,
        save={
            "help": "write the scene with two more columns: relevancy, the measured value; match_id, the match's "
            "number or -1"
        },
    )


def run(options: Options) -> Facts:
    import numpy as np

    from ... import write_gaussians
    from ...formats.replacing import together
    from ...query.documents import match_document, track_document
    from ...query.suggesting import missed_text, words_instead

    outputs = options.outputs
    scene, answer = ask(options.question, outputs, options.threads)
    report = answer_json(options.question, answer)
    if not scene.has_gaussians:
        return {**report, "count": None, "num_matches": None, "matches": None}
    matches = scene.locate(answer, min_gaussians=options.min_gaussians, box=options.box)
    report["count"] = sum(match.sure for match in matches)
    report["num_matches"] = len(matches)
    report["instead"] = [] if matches else words_instead(scene, answer)
    report["missed"] = "" if matches else missed_text(answer, report["instead"])
    listed = matches[: options.top]
    report["matches"] = [match_document(match, georeference=scene.georeference) for match in listed]
    if options.tracks:
        for document, track in zip(report["matches"], scene.tracks(listed, options.box), strict=True):
            document["track"] = track_document(track)
    with together():
        if outputs.save:
            match_ids = np.full(len(scene.gaussians), -1, np.int32)
            for number, match in enumerate(matches):
                match_ids[match.gaussian_ids] = number
            columns = {"relevancy": answer.dense, "match_id": match_ids}
            write_gaussians(outputs.save, scene.gaussians, columns, overwrite=outputs.overwrite)
        if outputs.picture:
            ids = np.concatenate([match.gaussian_ids for match in matches] or [np.empty(0, np.int64)])
            note = counted(len(matches), "match", "matches") if matches else "no match"
            report["view"] = draw(options.question, outputs, scene, ids, note)
    return report


def show(answer: Facts) -> None:
    of = counted(answer["num_registered"], "registered Gaussian")
    measured = f"{text_of(answer['num_selected'])} of {of} selected; {measured_text(answer)}"
    print_doubt(answer)
    if not (answer["num_selected"] if answer["matches"] is None else answer["matches"]):
        print(f"No match for '{answer['query']}'. {answer['missed']}".rstrip(), measured, sep="\n")
        if answer["num_selected"]:
            above = counted(answer["num_selected"], "Gaussian is", "Gaussians are")
            print(f"{above} above the threshold, too few or too scattered for a match.")
        return
    if answer["matches"] is None:
        print(f"{measured}\nFor places, pass --scene SCENE.")
        return
    columns = ("match", "score", "Gaussians", "centre", "extent")
    rows = [_row(number, match) for number, match in enumerate(answer["matches"])]
    sure = "" if answer["count"] == answer["num_matches"] else f", {answer['count']:,} sure"
    title = f"{counted(answer['num_matches'], 'match', 'matches')} of '{answer['query']}'{sure}, in scene units"
    show_table(title, columns, rows)
    for number, match in enumerate(answer["matches"]):  # names of photos are long, and people copy them
        if match["support"]:
            photos = dict.fromkeys(mask["view"] for mask in match["support"])
            print(f"match {number} is supported by {', '.join(photos)}")
        if "position" in match:
            here = match["position"]
            print(f"match {number} lies at {here['latitude']:.7f}, {here['longitude']:.7f}, {here['height']:.2f} m")
        if "track" in match:
            print(f"match {number} {_track_text(match['track'])}")
    print(measured)


def _row(number: int, match: Facts) -> tuple[str, ...]:
    places = map(place_text, (match["center"], match["extent"]))
    return str(number), f"{match['score']:.3f}", f"{match['num_gaussians']:,}", *places


def _track_text(track: Facts) -> str:
    from ...query.tracks import spans_text

    if not len(track["times"]):
        return "is nowhere at any time"
    start, end = map(place_text, (track["centers"][0], track["centers"][-1]))
    seen = f", seen {spans_text(track['spans'])}" if track["spans"] else ""
    return f"goes from ({start}) at {track['times'][0]:.4g} to ({end}) at {track['times'][-1]:.4g}{seen}"
