"""drsplat when: two things of a scene that moves, and a relation -> the spans of time in which it holds."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...query.schema import Place, fields
from .declaring import Facts, argument, declaration, option, part, words
from .options import Encoders, Photos, Verb
from .query_options import FIELD_HELP, asked, open_with, query_of

if TYPE_CHECKING:
    from .query_options import Asked

TEXT_CUT = fields(Place.COMMAND_LINE, Place.WORDS)
RELATIONS = ("on", "in", "next_to", "above", "under", "left_of", "right_of")
EXAMPLES = """\
  drsplat when film.field "toy car" next_to "white vase" --scene film.motion
  drsplat when film.field "toy car" left_of "white vase" --scene film.motion --views capture --view cam00/frame_0000

Each query stands for its best match and those nearly as good: the relation holds if it holds between any of the
first and any of the second. Left and right are seen from the camera of the photo --view, which is assumed to be
still. The spans cover the scene's times from first to last without gaps."""
DAILY = "scene view views threshold encoder"


@declaration
class Options(Verb):
    """Options of this verb."""

    field: str = argument(FIELD_HELP)
    one: str = argument("first object, in words", words)
    relation: str = argument("relation of the first object to the second", choices=RELATIONS)
    other: str = argument("second object, in words", words)
    scene: str | None = option("moving scene that was registered")
    views: str | None = option("posed photos, for --view", "CAPTURE")
    view: str | None = option("photo whose camera defines left_of and right_of", "NAME", words)
    both: Asked = asked(TEXT_CUT, "both queries")
    encoders: Encoders = part(Encoders)
    photos: Photos = part(Photos)


def run(options: Options) -> Facts:
    scene = open_with(options, options.field, options.scene)
    one, other = (query_of({**options.both, "text": text}) for text in (options.one, options.other))
    spans = scene.when(one, options.relation, other, options.view)
    return {
        "field": options.field,
        "one": options.one,
        "relation": options.relation,
        "other": options.other,
        "view": options.view,
        "times": list(scene.moving.span),
        "spans": list(map(list, spans)),
    }


def show(answer: Facts) -> None:
    from ...query.tracks import spans_text

    start, end = answer["times"]
    said = f"'{answer['one']}' is {answer['relation'].replace('_', ' ')} '{answer['other']}'"
    held = spans_text(answer["spans"]) or "at no time"
    print(f"{said}: {held} (of {start:.4g} to {end:.4g})")
