"""Recordings of rerun, read back by its own program."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from drsplat.errors import InputError, MissingExtraError
from drsplat.exporting.writers import write_scene
from drsplat.formats.rerun_writing import write_rrd
from drsplat.scene.labelled import LabelledScene
from drsplat.scene.views import View
from scene_files import random_gaussians
from test_usd import labelled


def printed(path: Path, *arguments: str) -> str:
    command = [sys.executable, "-m", "rerun", "rrd", *arguments, str(path)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


@pytest.mark.oracle
def test_rerun_reads_what_we_write(tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    view = View("a.png", np.array([[100.0, 0, 50], [0, 100, 40], [0, 0, 1]]), np.eye(4), 100, 80)
    write_rrd(tmp_path / "out.rrd", labelled(), views=[view])
    text = printed(tmp_path / "out.rrd", "print", "-vvv")
    for place in ("/world/splats", "/world/things", "/world/groups", "/world/matches", "/world/annotations"):
        assert place in text
    assert "/world/photos/0" in text
    assert "Pinhole:image_from_camera" in text
    assert "GaussianSplats3D:sh_coefficients" in text
    printed(tmp_path / "out.rrd", "verify")
    with pytest.raises(InputError, match="exists already"):
        write_rrd(tmp_path / "out.rrd", labelled())


@pytest.mark.oracle
@pytest.mark.parametrize("degree", range(4))
def test_each_degree_is_written(degree: int, tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    write_scene(tmp_path / "out.rrd", LabelledScene(random_gaussians(np.random.default_rng(0), 5, degree)))
    assert ("sh_coefficients" in printed(tmp_path / "out.rrd", "print", "-v")) == (degree > 0)


def test_without_the_sdk_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(MissingExtraError, match=r"drsplat\[rerun\]"):
        write_scene(tmp_path / "out.rrd", labelled())
    assert not (tmp_path / "out.rrd").exists()
