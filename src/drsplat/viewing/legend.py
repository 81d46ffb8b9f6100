"""What the colours of classes mean."""

from collections.abc import Sequence

from ..drawing.palette import class_colors
from .texts import escaped, paragraphs


def legend_html(names: tuple[str, ...], counts: Sequence[int]) -> str:
    """A swatch, a name and a number of Gaussians on each line."""
    spot = "display:inline-block;width:.8em;height:.8em;border-radius:3px;margin-right:.6em"
    return paragraphs(
        *(
            f'<span style="{spot};background:rgb({",".join(map(str, color))})"></span>{escaped(name)} '
            f'<span style="opacity:.6">{count:,}</span>'
            for name, color, count in zip(names, class_colors(len(names)), counts, strict=True)
        )
    )
