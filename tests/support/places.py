"""Folders of the checkout that tests read."""

import os
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TESTS, SUPPORT = ROOT / "tests", ROOT / "tests" / "support"
IMPORTED = os.pathsep.join(map(str, [TESTS, SUPPORT, *sorted({path.parent for path in TESTS.glob("*/test_*.py")})]))
"""For PYTHONPATH of programs that import what tests share."""
