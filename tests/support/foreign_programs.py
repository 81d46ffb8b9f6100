"""Programs of others that come from npm: where they are, and the line to type where they are not.

`tests/foreign/package.json` names them and their versions; nothing of them is part of the repository.
"""

import shutil
import subprocess
from pathlib import Path

import pytest

from places import TESTS

NPM_FOLDER = TESTS / "foreign"
INSTALL_LINE = "npm install --prefix tests/foreign"
NODE = shutil.which("node")


def npm_package(name: str) -> Path:
    """Return the folder where a package of `package.json` is once it is installed."""
    return NPM_FOLDER / "node_modules" / name


def needs_packages(*names: str) -> pytest.MarkDecorator:
    """Skip where a package is not installed, with the line to type."""
    missing = [name for name in names if not npm_package(name).is_dir()]
    return pytest.mark.skipif(bool(missing), reason=f"{', '.join(missing)} not installed: {INSTALL_LINE}")


needs_node = pytest.mark.skipif(NODE is None, reason="no node is installed")


def splat_transform(*arguments: object) -> None:
    """Run splat-transform on the processor, in one thread; what it prints is in the failure."""
    script = npm_package("@playcanvas/splat-transform") / "bin" / "cli.mjs"
    options = ["--quiet", "--overwrite", "--gpu", "cpu", "--max-workers", "0", "--iterations", "1"]
    finished = subprocess.run(
        [str(NODE), str(script), *options, *map(str, arguments)], capture_output=True, text=True, timeout=300
    )
    assert finished.returncode == 0, finished.stdout + finished.stderr
