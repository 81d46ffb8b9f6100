"""drsplat when: two things of a scene that moves, and a relation -> the spans of time in which it holds."""

from __future__ import annotations

import argparse
from typing import Any

from ...query.schema import Place, fields
from .options import add_capture_options, add_query_encoders, words
from .query_options import FIELD_HELP, add_fields, open_scene, values_of

TEXT_CUT = fields(Place.COMMAND_LINE, Place.WORDS)
RELATIONS = ("on", "in", "next_to", "above", "under", "left_of", "right_of")
EXAMPLES = """\
  drsplat when film.field "toy car" next_to "white vase" --scene film.motion
  drsplat when film.field "toy car" left_of "white vase" --scene film.motion --views capture --view cam00/frame_0000

Each query stands for its best match and those nearly as good: the relation holds if it holds between any of the
first and any of the second. Left and right are seen from the camera of the photo --view, which is assumed to be
still. The spans cover the scene's times from first to last without gaps."""
DAILY = ("scene", "view", "views", "threshold", "encoder")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("field", help=FIELD_HELP)
    parser.add_argument("one", type=words, help="first object, in words")
    parser.add_argument("relation", choices=RELATIONS, help="relation of the first object to the second")
    parser.add_argument("other", type=words, help="second object, in words")
    parser.add_argument("--scene", help="moving scene that was registered")
    parser.add_argument("--views", metavar="CAPTURE", help="posed photos, for --view")
    parser.add_argument("--view", type=words, metavar="NAME", help="photo whose camera defines left_of and right_of")
    add_fields(parser.add_argument_group("both queries"), TEXT_CUT)
    add_query_encoders(parser)
    add_capture_options(parser)


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from ...query import Query

    scene = open_scene(arguments)
    one, other = (Query(text, **values_of(arguments, TEXT_CUT)) for text in (arguments.one, arguments.other))
    spans = scene.when(one, arguments.relation, other, arguments.view)
    return {
        "field": arguments.field,
        "one": arguments.one,
        "relation": arguments.relation,
        "other": arguments.other,
        "view": arguments.view,
        "times": list(scene.moving.span),
        "spans": [list(span) for span in spans],
    }


def show(answer: dict[str, Any]) -> None:
    from ...query.tracks import spans_text

    start, end = answer["times"]
    said = f"'{answer['one']}' is {answer['relation'].replace('_', ' ')} '{answer['other']}'"
    held = spans_text(answer["spans"]) or "at no time"
    print(f"{said}: {held} (of {start:.4g} to {end:.4g})")
