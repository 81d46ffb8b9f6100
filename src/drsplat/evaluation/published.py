"""Numbers that papers print, in per cent, and the condition for comparing ours with them.

Every number has its source. `same_data` says whether a result is of the same scenes and labels; only then is a
difference shown.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

DR_SPLAT = "Dr. Splat"


@dataclass(frozen=True)
class Published:
    """Line of a paper's table. numbers: by metric, in per cent."""

    method: str
    numbers: Mapping[str, float]
    source: str


LERF_PAIRS = {"figurines": 56, "ramen": 71, "teatime": 59, "waldo_kitchen": 22}
"""Number of pairs of a photo and a category in the labels of LERF-OVS."""

SCANNET_8 = frozenset(
    f"scene{number}_00" for number in ("0000", "0062", "0070", "0097", "0140", "0347", "0400", "0590")
)
SCANNET_10 = SCANNET_8 | {"scene0200_00", "scene0645_00"}

_MAIN = "Dr. Splat, main paper"
_VALA = "VALA, Table 1"
_NORMLIFT = "NormLift, Table 1"

LERF_OVS = (
    Published("LangSplat-m", {"miou": 9.83, "acc@0.25": 15.94}, _MAIN),
    Published("OpenGaussian", {"miou": 43.06, "acc@0.25": 59.61}, f"{_MAIN}, re-run"),
    Published("OpenGaussian", {"miou": 38.36, "acc@0.25": 51.43}, "OpenGaussian"),
    Published(DR_SPLAT, {"miou": 43.58, "acc@0.25": 63.87}, f"{_MAIN}, Top-40"),
    Published(DR_SPLAT, {"miou": 32.53, "acc@0.25": 50.43, "acc@0.5": 30.83}, "RADIO-GS audit, official code"),
    Published("Occam's LGS", {"miou": 47.22, "acc@0.25": 74.84}, _VALA),
    Published("VALA", {"miou": 58.02, "acc@0.25": 82.85}, _VALA),
)  # fmt: skip

SCANNET_LOCALIZATION = (
    Published("LangSplat-m", {"miou": 8.0, "iou>0.15": 17.1, "iou>0.30": 7.8, "iou>0.45": 2.9}, _MAIN),
    Published("LEGaussians-m", {"miou": 9.5, "iou>0.15": 19.1, "iou>0.30": 8.9, "iou>0.45": 7.3}, _MAIN),
    Published("OpenGaussian", {"miou": 25.2, "iou>0.15": 59.5, "iou>0.30": 38.0, "iou>0.45": 18.3}, _MAIN),
    Published(DR_SPLAT, {"miou": 25.4, "iou>0.15": 60.7, "iou>0.30": 40.3, "iou>0.45": 25.6}, _MAIN),
    Published(DR_SPLAT, {"miou": 25.4, "iou>0.15": 52.6, "iou>0.30": 40.3, "iou>0.45": 25.6}, "Dr. Splat, Table S1"),
)  # fmt: skip

SCANNET_200_LOCALIZATION = (
    Published("LangSplat-m", {"miou": 3.9, "iou>0.15": 7.6, "iou>0.30": 3.5, "iou>0.45": 0.8}, "Dr. Splat, Table S3"),
    Published("LEGaussians-m", {"miou": 4.0, "iou>0.15": 7.4, "iou>0.30": 3.8, "iou>0.45": 1.4}, "Dr. Splat, Table S3"),
    Published("OpenGaussian", {"miou": 14.7, "iou>0.15": 34.2, "iou>0.30": 18.9, "iou>0.45": 11.0}, "Dr. Splat, Table "
    "S3"),
    Published(DR_SPLAT, {"miou": 14.9, "iou>0.15": 36.0, "iou>0.30": 19.3, "iou>0.45": 14.0}, "Dr. Splat, Table S3, "
    "Top-40"),
)  # fmt: skip

SCANNET_SEGMENTATION = {
    "scannet19": (
        Published("OpenGaussian", {"miou": 30.1, "macc": 46.5}, _MAIN),
        Published(DR_SPLAT, {"miou": 29.6, "macc": 47.7}, _MAIN),
        Published(DR_SPLAT, {"miou": 29.31, "macc": 47.68}, "VALA, Table 2, re-implemented"),
        Published("VALA", {"miou": 32.11, "macc": 50.05}, "VALA, Table 2"),
    ),
    "scannet15": (
        Published(DR_SPLAT, {"miou": 33.25, "macc": 54.33}, "VALA, Table 2, re-implemented"),
        Published("VALA", {"miou": 35.10, "macc": 54.77}, "VALA, Table 2"),
    ),
    "scannet10": (
        Published(DR_SPLAT, {"miou": 44.19, "macc": 65.19}, "VALA, Table 2, re-implemented"),
        Published("VALA", {"miou": 46.21, "macc": 65.61}, "VALA, Table 2"),
    ),
}

SCANNET_POINTS = {
    "scannet19": (
        Published("OpenGaussian", {"miou": 24.73, "macc": 41.54}, _NORMLIFT),
        Published("NormLift", {"miou": 35.77, "macc": 54.02}, _NORMLIFT),
    ),
    "scannet15": (
        Published("OpenGaussian", {"miou": 30.13, "macc": 48.25}, _NORMLIFT),
        Published("NormLift", {"miou": 39.62, "macc": 59.26}, _NORMLIFT),
    ),
    "scannet10": (
        Published("OpenGaussian", {"miou": 38.29, "macc": 55.19}, _NORMLIFT),
        Published("NormLift", {"miou": 48.93, "macc": 68.83}, _NORMLIFT),
    ),
}


def published_for(result: Mapping[str, Any], task: str) -> tuple[Published, ...]:
    """Return the numbers of papers for a protocol and task ("selection", "segmentation", "localization")."""
    name, labels = result["protocol"], str(result.get("label_set"))
    if name.startswith("lerf-ovs@"):
        return LERF_OVS
    if name.startswith("scannet-points@"):
        return SCANNET_POINTS.get(labels, ())
    if not name.startswith("scannet-volume@"):
        return ()
    if task == "segmentation":
        return SCANNET_SEGMENTATION.get(labels, ())
    by_labels = {"scannet19": SCANNET_LOCALIZATION, "scannet200": SCANNET_200_LOCALIZATION}
    return by_labels.get(labels, ())


def same_data(result: Mapping[str, Any]) -> bool:
    """Return whether a result is of the same scenes as the published numbers.

    >>> same_data({"protocol": "lerf-ovs@1", "scenes": [{"name": "teatime", "pairs": 59}]})
    False
    """
    scenes = result["scenes"]
    names = {scene["name"] for scene in scenes}
    if result["protocol"].startswith("lerf-ovs@"):
        return {scene["name"]: scene["pairs"] for scene in scenes} == LERF_PAIRS
    if result["protocol"].startswith("scannet-points@"):
        return names == SCANNET_10
    return result["protocol"].startswith("scannet-volume@") and names == SCANNET_8
