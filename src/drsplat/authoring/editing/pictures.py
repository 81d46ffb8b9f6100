"""Before and after, side by side."""

from ...base.arrays import OtherPixels
from ...drawing.pictures import as_pixels, contact_sheet, titled
from ...drawing.rendering import render
from ...scene.gaussians import Gaussians
from ...scene.views import View


def before_after(before: Gaussians, after: Gaussians, view: View, title: str = "", threads: int = 0) -> OtherPixels:
    """Draw two renderings from one view: "before" on the left, and "after" with what was done."""
    drawn = [as_pixels(render(one, view, threads=threads).rgb) for one in (before, after)]
    tiles = [titled(drawn[0], "before"), titled(drawn[1], "after", title)]
    return contact_sheet(tiles, 2, tile_width=view.width, gap=8)
