"""Pictures of objects: each cut out of the photo that shows it best."""

from collections.abc import Sequence

from ..drawing.cutouts import TILE, captioned, cut_out
from ..drawing.pictures import OtherPixels, best_views, contact_sheet, photo_or_rendering, visible_share
from ..errors import InputError
from ..scene.views import View
from .answer import Match
from .objects import objects_of, photos_of
from .scene import Scene

AT_ONCE = 16  # objects whose photos are compared together
LOOKED_AT = 3  # photos of each, those that show most of it
COLUMNS = 6
MOST = 60  # objects on a sheet


def object_picture(scene: Scene, match: Match, view: View | None = None, size: tuple[int, int] = TILE) -> OtherPixels:
    """An object cut out of a photo of it, or of a rendering where there is no photo. view: None for the best one.

    size: width and height in pixels, of 4 to 3.

    Raises: InputError: the scene has no views or no Gaussians.
    """
    view = view or object_views(scene, [match])[0]
    seen = scene.seen_by(view)
    share = visible_share(seen.gaussians, view, match.gaussian_ids, splats=seen.splats, threads=scene.threads)
    return cut_out(photo_or_rendering(seen.gaussians, view, threads=scene.threads), share, size)


def object_views(scene: Scene, matches: Sequence[Match]) -> list[View]:
    """For each object the view that shows most of it and does not cut it off, of those that its masks are in.

    Raises: InputError: the scene has no views or no Gaussians.
    """
    scene.best_view()  # or the error that says what is missing
    found: list[View] = []
    for begin in range(0, len(matches), AT_ONCE):
        some = matches[begin : begin + AT_ONCE]
        named = {name for match in some for name in _photos(scene, match)[:LOOKED_AT]}
        views = [view for view in scene.views if view.name in named] or list(scene.views)
        found += best_views(
            scene.motion or scene.gaussians, views, [one.gaussian_ids for one in some], threads=scene.threads
        )
    return found


def object_sheet(scene: Scene, matches: Sequence[Match], titles: Sequence[str]) -> OtherPixels:
    """The first 60 objects, each with its title and the name of its photo.

    Raises: InputError: no objects, or as `object_views`.
    """
    if not matches:
        raise InputError("this field has no object to draw")
    shown = list(matches[:MOST])
    tiles = [
        captioned(object_picture(scene, match, view), title, view.name)
        for match, view, title in zip(shown, object_views(scene, shown), titles, strict=False)
    ]
    return contact_sheet(tiles, min(COLUMNS, len(tiles)), tile_width=tiles[0].shape[1])


def _photos(scene: Scene, match: Match) -> list[str]:
    if match.object_id is None:
        return []
    return photos_of(scene.field, objects_of(scene.field).thing(match.object_id))
