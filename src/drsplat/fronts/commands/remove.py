"""drsplat remove: remove views from a field, as if they had never been registered."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from .changes import add_field_options, answer_of, field_and_scene, show_change
from .options import tracker, words

if TYPE_CHECKING:
    from ...field import LanguageField
    from ...field.growing import Change

EXAMPLES = """\
  drsplat remove room.field --scene scene.ply --views IMG_0017 IMG_0018.jpg
  drsplat remove room.field --scene scene.ply --views 'blurred/*'

The field is then the same, to the bit, as one registered from the remaining views. It remembers the removed ones:
`drsplat add` leaves them out, unless its --views names them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_field_options(parser)
    parser.add_argument(
        "--views", required=True, nargs="+", type=words, metavar="NAME",
        help="views to remove: names of photos, with or without suffix, or patterns with * and ?",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from ...field.growing import change_field, remove_views
    from ...field.growing.naming import views_named

    path, gaussians = field_and_scene(arguments)

    def change(field: LanguageField) -> Change:
        known = field.evidence.masks.view_names if field.evidence else ()
        before = field.growth.removed if field.growth else ()  # a command that is given again means the same views
        names = views_named(arguments.views, [*known, *before])
        return remove_views(field, gaussians, names, threads=arguments.threads, track=tracker(arguments))

    return answer_of(change_field(path, gaussians, change, threads=arguments.threads), path)


def show(answer: dict[str, Any]) -> None:
    show_change(answer, f"{'removed' if answer['removed'] else 'nothing to remove'} from {answer['field']}")
    if answer["left_out"]:
        print("Views listed as left out were removed before.")
