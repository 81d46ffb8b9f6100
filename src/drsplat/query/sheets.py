"""Pictures of objects: each cut out of the photo that shows it best, or as its attributes see it."""

from collections.abc import Sequence

import numpy as np

from ..base.arrays import OtherPixels
from ..base.terminal import counted
from ..drawing.cards import TILE_PIXELS, Card, card_sheet, cut_out
from ..drawing.heat import heat_of
from ..drawing.pictures import as_pixels, contact_sheet, heated, photo_or_rendering, titled, visible_share, zoomed
from ..drawing.rendering import render
from ..errors import InputError
from ..scene.views import View
from .answer import Answer, Match
from .objects import objects_of, photos_of
from .query import Query
from .scene import Scene

OBJECTS_AT_ONCE = 16  # whose photos are compared together
MAX_PHOTOS_PER_OBJECT = 3  # those that show most of it
SHEET_COLUMNS = 6
MAX_OBJECTS = 60  # on a sheet
MAX_ATTRIBUTES, ATTRIBUTE_SIDE_PIXELS = 12, 640  # pictures in a row; their longer side


def object_picture(
    scene: Scene, match: Match, view: View | None = None, size: tuple[int, int] = TILE_PIXELS
) -> OtherPixels:
    """Cut an object out of a photo of it, or of a rendering where there is no photo. view: None for the best one.

    size: width and height in pixels, of 4 to 3.

    Raises: InputError: the scene has no views or no Gaussians.
    """
    view = view or object_views(scene, [match])[0]
    seen = scene.seen_by(view).seen(view)
    ids = seen.local(match.gaussian_ids)
    share = visible_share(seen.gaussians, view, ids, splats=seen.splats, threads=scene.threads)
    photo = photo_or_rendering(seen.gaussians, view, splats=seen.splats, threads=scene.threads)
    return cut_out(photo, share, size)


def object_views(scene: Scene, matches: Sequence[Match]) -> list[View]:
    """Return for each object the view that shows most of it and does not cut it off, of those that its masks are in.

    Raises: InputError: the scene has no views or no Gaussians.
    """
    scene.best_view()  # or the error that says what is missing
    found: list[View] = []
    for begin in range(0, len(matches), OBJECTS_AT_ONCE):
        some = matches[begin : begin + OBJECTS_AT_ONCE]
        named = {name for match in some for name in _photos(scene, match)[:MAX_PHOTOS_PER_OBJECT]}
        views = [view for view in scene.views if view.name in named] or list(scene.views)
        found += scene.best_views([one.gaussian_ids for one in some], views)
    return found


def object_sheet(scene: Scene, matches: Sequence[Match], names: Sequence[str | None]) -> OtherPixels:
    """Draw a card for each of the first 60 objects: its picture, name, size, number and photo.

    names: None for an object that has none.

    Raises: InputError: no objects, or as `object_views`.
    """
    if not matches:
        raise InputError("this field has no object to draw")
    shown = list(matches[:MAX_OBJECTS])
    cards = [
        Card(object_picture(scene, match, view), name or f"object {match.object_id}", _notes(match, view))
        for match, view, name in zip(shown, object_views(scene, shown), names, strict=False)
    ]
    largest = f"The {len(shown)} largest of " if len(shown) < len(matches) else ""
    heading = f"{largest}{counted(len(matches), 'object')} of {scene.name or 'the scene'}"
    return card_sheet(cards, SHEET_COLUMNS, heading, "Largest first. Lengths of the boxes in scene units.")


def _notes(match: Match, view: View) -> list[str]:
    """Return the size of an object, and its number with the name of the photo."""
    size = " x ".join(f"{length:.2f}" for length in match.extent)
    return [size, f"object {match.object_id} in {view.name}"]


def attribute_row(
    scene: Scene, match: Match, attributes: Sequence[Query | str], view: View | None = None
) -> OtherPixels:
    """Draw one thing as it is, and beside it how well each word fits, as heat: yellow-green at the word's threshold.

    Each heat map says how much of the thing, in opacity, is above that. view: None for the one that shows most of it;
    the pictures are of the part of it about the thing.

    Raises: InputError: no words or too many, none that the encoder knows, no views.
    """
    if not 1 <= len(attributes) <= MAX_ATTRIBUTES:
        raise InputError(f"attributes: expected 1 to {MAX_ATTRIBUTES} words, got {len(attributes)}")
    view = (view or scene.best_view(match.gaussian_ids)).limited(ATTRIBUTE_SIDE_PIXELS)
    own = scene.seen(view)
    ids = own.local(match.gaussian_ids)
    shown = visible_share(own.gaussians, view, ids, splats=own.splats, threads=scene.threads)
    queries = [Query(one) if isinstance(one, str) else one for one in attributes]
    answers = [scene.ask(query).without_maybe() for query in queries]
    heat = [scene.field.dense(heat_of(one.values, one.threshold), fill=0.0) for one in answers]
    values = np.stack(heat if own.rows is None else [one[own.rows] for one in heat], 1)
    drawn = render(own.gaussians, zoomed(view, shown), values=values, splats=own.splats, threads=scene.threads)
    picture, solid = as_pixels(drawn.rgb), np.maximum(drawn.alpha, 1e-3)
    tiles = [titled(picture, match.label or "as it is")]
    for number, (query, answer) in enumerate(zip(queries, answers, strict=True)):
        note = f"{_share_above(scene, match, answer):.0%} of it"
        tiles.append(titled(heated(picture, drawn.channels[..., number] / solid), query.text or "", note))
    return contact_sheet(tiles, len(tiles))


def _share_above(scene: Scene, match: Match, answer: Answer) -> float:
    mass = scene.rows.opacities_of(match.gaussian_ids).astype(np.float64)
    above = np.isin(match.gaussian_ids, answer.gaussian_ids)
    return float(mass[above].sum() / max(mass.sum(), 1e-12))


def _photos(scene: Scene, match: Match) -> list[str]:
    if match.object_id is None:
        return []
    return photos_of(scene.field, objects_of(scene.field).thing(match.object_id))
