"""JSON of answers, matches, tracks and objects: the names and units that every front writes.

Coordinates are those of the scene's world, lengths scene units, times those of the scene. decimals: of coordinates; of
scores, shares and axes there are 4 then. None writes numbers as they are.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np

from ..base.arrays import Array, Matrix3, Shaped, Vector3
from ..base.contents import Document
from ..field.evidence.evidence import Explanation
from ..field.objects.agreed import FEW_PHOTOS
from ..formats.georeference import Georeference
from .answer import Answer, Match, MatchTrack, Segmentation
from .objects import objects_of, photos_of
from .scene import Scene

SHARE_DECIMALS = 4
DEGREE_DECIMALS, HEIGHT_DECIMALS = 9, 4  # a ten-thousandth of a metre


def box_document(center: Vector3, axes: Matrix3, extent: Vector3, decimals: int | None = None) -> Document:
    """Return an oriented box: its centre, its full lengths along the axes, and its axes as rows."""
    return {"center": rounded(center, decimals), "extent": rounded(extent, decimals), "axes": _short(axes, decimals)}


def match_document(match: Match, decimals: int | None = None, georeference: Georeference | None = None) -> Document:
    """Return a match: its box, its score, whether it is sure, how many Gaussians it has, and masks that support it.

    georeference: of its scene, for where on the Earth it is.
    """
    return {
        **box_document(match.center, match.axes, match.extent, decimals),
        **earth_document(georeference, match.center, match.axes, match.extent),
        "score": _short(match.score, decimals),
        "sure": match.sure,
        "num_gaussians": len(match),
        "support": support_document(match.support, decimals),
    }


def support_document(support: Iterable[Explanation], decimals: int | None = None) -> list[Document]:
    """Return masks: the photo, the mask's number there, and its part of all support."""
    return [{"view": one.view_name, "mask": one.mask_id, "share": _short(one.share, decimals)} for one in support]


def track_document(track: MatchTrack, decimals: int | None = None, most: int | None = None) -> Document:
    """Return where a match is over time. most: times and photos at most, evenly chosen; None: all of them."""
    count = len(track)
    chosen = np.linspace(0, count - 1, min(count, most or count)).round().astype(int)
    return {
        "times": rounded(track.times[chosen]),
        "centers": rounded(track.centers[chosen], decimals),
        "extents": rounded(track.extents[chosen], decimals),
        "axes": _short(track.axes[chosen], decimals),
        "spans": [list(span) for span in track.spans],
        "views": list(track.views[:most]),
    }


def answer_document(answer: Answer) -> Document:
    """Return how an answer was measured and cut; its range is without what a "not" left out."""
    values = answer.values[answer.values > answer.lowest]
    values = values if len(values) else np.full(1, answer.lowest, np.float32)
    return {
        "measure": answer.measure,
        "threshold": answer.threshold,
        "threshold_rule": answer.rule,
        "score_range": [float(values.min()), float(values.max())],
        "score_p99": float(np.percentile(values, 99)),
        "num_registered": len(answer.field),
        "num_selected": len(answer.gaussian_ids),
        "certainty": answer.certainty,
        "doubt": answer.doubt,
        "list_doubt": answer.list_doubt,
        "seen_from": answer.seen_from,
    }


def segmentation_document(segmentation: Segmentation) -> Document:
    """Return how many Gaussians each class has, and above which threshold."""
    answers, counts = segmentation.answers, segmentation.counts
    num_registered = len(answers[0].field)
    return {
        "measure": answers[0].measure,
        "num_registered": num_registered,
        "num_labelled": sum(counts),
        "doubt": segmentation.doubt,
        "list_doubt": segmentation.list_doubt,
        "classes": [
            {"name": name, "num_gaussians": count, "share": count / max(num_registered, 1), "threshold": one.threshold}
            for name, count, one in zip(segmentation.names, counts, answers, strict=True)
        ],
    }


def object_documents(scene: Scene, listed: Iterable[Match], decimals: int | None = None) -> list[Document]:
    """Return objects of a scene with their names, boxes, and photos, those that show most of one first."""
    objects, names, agreed = objects_of(scene.field), scene.object_names(), scene.agreed.tolist()
    surfaces = scene.surfaces
    return [
        {
            "id": number,
            "label": match.label,
            "name": names[number],
            **box_document(match.center, match.axes, match.extent, decimals),
            **earth_document(scene.georeference, match.center, match.axes, match.extent),
            "num_gaussians": len(match),
            "mass": float(objects.masses[node]),
            "num_views": int(objects.num_views[node]),
            "sure": _short(match.score, decimals),
            "agreed": agreed[number],
            "few_photos": bool(objects.num_views[node] <= FEW_PHOTOS),
            "surface": surfaces and surfaces[number],
            "views": photos_of(scene.field, node),
        }
        for match in listed
        if (number := match.object_id) is not None
        for node in [objects.thing(number)]
    ]


def rounded(values: Shaped[Array, "*any"] | Iterable[float] | float, decimals: int | None = None) -> Any:
    """Return a number, or numbers as lists, to some decimals."""
    numbers = np.asarray(values, np.float64)
    return (numbers if decimals is None else np.round(numbers, decimals)).tolist()


def _short(values: Any, decimals: int | None) -> Any:
    return rounded(values, None if decimals is None else SHARE_DECIMALS)


def earth_document(
    georeference: Georeference | None, center: Vector3, axes: Matrix3, extent: Vector3
) -> dict[str, Any]:
    """Return the position of a box's centre and its footprint, in WGS 84; nothing without a georeference.

    The footprint is a polygon as GeoJSON has it (RFC 7946): what the box covers seen from above, anticlockwise and
    closed, at the height of its lowest corner.
    """
    if georeference is None:
        return {}
    sides = axes * extent[:, None] @ georeference.enu_from_world.T
    middle, flat = georeference.enu_from_world @ center, sides[:, :2]
    east, north = flat.T
    flat = np.where(((east < 0) | ((east == 0) & (north < 0)))[:, None], -flat, flat)[flat.any(1)]
    flat = flat[np.argsort(np.arctan2(flat[:, 1], flat[:, 0]), kind="stable")]
    # seen from above a box is a polygon of its sides, in the order of their directions, and of these again, backwards
    ring = middle[:2] - flat.sum(0) / 2 + np.cumsum(np.concatenate([np.zeros((1, 2)), flat, -flat[:-1]]), axis=0)
    local = np.column_stack([ring, np.full(len(ring), middle[2] - np.abs(sides[:, 2]).sum() / 2)])
    places = georeference.positions(np.vstack([center, local[[*range(len(local)), 0]] @ georeference.enu_from_world]))
    here, *footprint = [_rounded(place) for place in places]
    return {
        "position": dict(zip(("longitude", "latitude", "height"), here, strict=True)),
        "footprint": {"type": "Polygon", "coordinates": [footprint]},
    }


def _rounded(place: Vector3) -> list[float]:
    longitude, latitude, height = place.tolist()
    return [round(longitude, DEGREE_DECIMALS), round(latitude, DEGREE_DECIMALS), round(height, HEIGHT_DECIMALS)]
