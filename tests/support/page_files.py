"""Pages as a browser reads them."""

import base64
import json
import re
import zlib
from pathlib import Path
from typing import Any

import numpy as np

KINDS = {"f4": np.float32, "f2": np.float16, "u1": np.uint8, "u2": np.uint16, "u4": np.uint32}


def read_page(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The header of a page, and its arrays."""
    text = path.read_text(encoding="utf-8")
    header, blob = (re.search(rf'id="{name}">(.*?)</script>', text, re.DOTALL) for name in ("header", "blob"))
    document = json.loads(header[1])
    return document, arrays_in(zlib.decompress(base64.b64decode(blob[1])), document["arrays"])


def arrays_in(data: bytes, layout: Any) -> dict[str, np.ndarray]:
    """Arrays of a page or of a viewer's answer, by their names."""
    return {name: np.frombuffer(data, KINDS[kind], count, offset) for name, kind, offset, count in layout}
