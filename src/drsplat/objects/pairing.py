"""The last round of joining: two things that stand out and touch are one if they stand out more together.

The rounds before ask a thing to stand out far more than its pieces do. The large parts of a jointed thing do not need
that: a head and a body both stand out by themselves, and depth jumps between them along most of their border, where the
chin is before the dress. They still touch along a good part of it.
"""

from collections.abc import Iterator
from heapq import heapify, heappop, heappush

import numpy as np
from jaxtyping import Bool, Float64

from .sides import MOST, SHORT, Outline, Side, outline_of, united

STANDS_OUT = 0.5  # relief of each of the two
TOUCHES = 0.1  # of the outline of one of the two, as far as nothing is before it
MORE = 0.01  # of relief over that of either


def paired(
    sides: dict[int, dict[int, Side]], areas: Float64[np.ndarray, " n"], is_whole: Bool[np.ndarray, " n"]
) -> list[tuple[list[int], float]]:
    """Return the sets of two and more things that are one, with their relief. Pairs that touch most come first.

    sides: of things by number; used up. is_whole: things that single masks hold as a whole stay what they are.
    """
    outlines = {node: outline_of(beside) for node, beside in sides.items() if not is_whole[node]}
    sizes, members = areas.tolist(), [[node] for node in range(len(areas))]
    most, inner = MOST * sum(sizes), set()
    heap = [
        entry for one in sides for other in sides[one] if one < other for entry in _entry(outlines, sides, one, other)
    ]
    heapify(heap)
    while heap:
        _, one, other = heappop(heap)
        if one in inner or other in inner or sizes[one] + sizes[other] > most:
            continue
        new = len(sizes)
        sides[new] = united(sides, one, other, new)
        outlines[new] = outline_of(sides[new])
        sizes.append(sizes[one] + sizes[other])
        members.append(members[one] + members[other])
        inner |= {one, other}
        for beside in sides[new]:
            for entry in _entry(outlines, sides, beside, new):
                heappush(heap, entry)
    return [
        (sorted(members[node]), outlines[node].relief) for node in range(len(areas), len(sizes)) if node not in inner
    ]


def _entry(
    outlines: dict[int, Outline], sides: dict[int, dict[int, Side]], one: int, other: int
) -> Iterator[tuple[float, int, int]]:
    """Yield the pair for the heap, best first, if the two are one thing."""
    if one not in outlines or other not in outlines:
        return
    side, pair = sides[one][other], (outlines[one], outlines[other])
    front = sum(outline.front for outline in pair) - side.front - side.behind
    level = sum(outline.level for outline in pair) - 2 * side.level
    touching = side.level / max(min(outline.front + outline.level for outline in pair), SHORT)
    apart = [outline.relief for outline in pair]
    together = Outline(front, level, front + level).relief
    if min(apart) >= STANDS_OUT and touching >= TOUCHES and together >= max(apart) + MORE:
        yield -touching, one, other
