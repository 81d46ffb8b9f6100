"""drsplat remove: remove views from a field, as if they had never been registered."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from .add import FieldToChange, answer_of, show_change
from .declaring import Facts, declaration, option, part, words
from .options import Verb

if TYPE_CHECKING:
    from ...field import LanguageField
    from ...field.growing import Change

EXAMPLES = """\
  drsplat remove room.field --scene scene.ply --views IMG_0017 IMG_0018.jpg
  drsplat remove room.field --scene scene.ply --views 'blurred/*'

The field is then the same, to the bit, as one registered from the remaining views. It remembers the removed ones:
`drsplat add` leaves them out, unless its --views names them."""


@declaration
class Options(Verb):
    """Options of this verb."""

    of: FieldToChange = part(FieldToChange)
    views: list[str] = option(
        "views to remove: names of photos, with or without suffix, or patterns with * and ?", "NAME", words,
        required=True, nargs="+",
    )  # fmt: skip


def run(options: Options) -> Facts:
    from ...field.growing import change_field, remove_views
    from ...field.growing.naming import views_named
    from ...photos.embedding.voting import vote_for_objects, votes_beside
    from ...scene.moving import canonical_of

    path, gaussians = options.of.read()

    def change(field: LanguageField) -> Change:
        known = field.evidence.masks.view_names if field.evidence else ()
        before = field.growth.removed if field.growth else ()  # a command that is given again means the same views
        names = views_named(options.views, [*known, *before])
        return remove_views(field, gaussians, names, **options.running)

    vote = partial(
        vote_for_objects, gaussians=canonical_of(gaussians), views=(), kept=votes_beside(path), threads=options.threads
    )
    return answer_of(change_field(path, gaussians, change, vote=vote, threads=options.threads), path)


def show(answer: Facts) -> None:
    show_change(answer, f"{'removed' if answer['removed'] else 'nothing to remove'} from {answer['field']}")
    if answer["left_out"]:
        print("Views listed as left out were removed before.")
