"""A small data set in the formats of LVIS v1 and COCO, written after their descriptions."""

import json
from pathlib import Path

import numpy as np
from PIL import Image

WIDTH, HEIGHT = 40, 30


def runs_of(mask: np.ndarray) -> list[int]:
    """Run lengths down the columns, pixels outside first, by a plain loop."""
    counts, inside, length = [], False, 0
    for pixel in mask.T.ravel():
        if bool(pixel) != inside:
            counts.append(length)
            inside, length = not inside, 0
        length += 1
    return [*counts, length]


def packed(counts: list[int]) -> str:
    """COCO's compressed text, by a plain loop: five bits a character, lowest first, signed."""
    text = ""
    for index, count in enumerate(counts):
        number = count - counts[index - 2] if index > 2 else count
        more = True
        while more:
            digit, number = number & 31, number >> 5
            more = number != (-1 if digit & 16 else 0)
            text += chr(48 + digit + (32 if more else 0))
    return text


def box_mask(x0: int, y0: int, x1: int, y1: int) -> np.ndarray:
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[y0:y1, x0:x1] = True
    return mask


def segmentation_of(mask: np.ndarray, kind: str) -> object:
    """Of a rectangle (polygon) or any mask (runs)."""
    counts = runs_of(mask)
    if kind == "polygon":
        y, x = np.nonzero(mask)
        x0, y0, x1, y1 = int(x.min()), int(y.min()), int(x.max()) + 1, int(y.max()) + 1
        return [[x0, y0, x1, y0, x1, y1, x0, y1]]
    size = list(mask.shape)
    return {"counts": counts if kind == "runs" else packed(counts), "size": size}


def annotation(number: int, photo: int, mask: np.ndarray, kind: str, **more: object) -> dict:
    return {
        "id": number,
        "image_id": photo,
        "category_id": 1 + number % 2,
        "area": float(mask.sum()),
        "bbox": [0.0, 0.0, 1.0, 1.0],
        "segmentation": segmentation_of(mask, kind),
    } | more


BOXES = {1: (2, 3, 22, 25), 2: (20, 5, 38, 17), 3: (0, 0, 12, 30), 4: (30, 20, 40, 30), 5: (5, 5, 9, 9)}  # fmt: skip
"""x0, y0, x1, y1 by annotation; 5 has 16 pixels."""
KINDS = {1: "polygon", 2: "runs", 3: "text", 4: "polygon", 5: "polygon"}
PHOTOS = {1: 11, 2: 11, 3: 12, 4: 13, 5: 13}


def document() -> dict:
    return {
        "images": [
            {"id": 11, "height": HEIGHT, "width": WIDTH,
             "coco_url": "http://images.cocodataset.org/train2017/000011.png"},
            {"id": 12, "height": HEIGHT, "width": WIDTH,
             "coco_url": "http://images.cocodataset.org/val2017/000012.png"},
            {"id": 13, "height": HEIGHT, "width": WIDTH, "file_name": "000013.png"},
        ],
        "categories": [{"id": 1, "name": "cup"}, {"id": 2, "name": "sofa"}],
        "annotations": [annotation(n, PHOTOS[n], box_mask(*BOXES[n]), KINDS[n]) for n in BOXES],
    }  # fmt: skip


def write_set(folder: Path, content: dict | None = None) -> Path:
    """Annotations, and beside them the folder images/ with train2017/ and val2017/."""
    photos = {11: "train2017/000011.png", 12: "val2017/000012.png", 13: "000013.png"}
    for number, name in photos.items():
        path = folder / "images" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(pixels_of(number)).save(path)
    path = folder / "annotations.json"
    path.write_text(json.dumps(document() if content is None else content))
    return path


def pixels_of(photo: int) -> np.ndarray:
    return np.random.default_rng(photo).integers(1, 256, (HEIGHT, WIDTH, 3)).astype(np.uint8)
