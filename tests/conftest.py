"""Fixtures that are costly enough to be made once."""

from pathlib import Path

import pytest

from drsplat.demo.story import Setup, Story, tell

SMALL = Setup(coarse=2.0, num_views=12, size=(320, 240))


@pytest.fixture(scope="session")
def demo_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the small demo's files are; tests read them and write elsewhere."""
    return tmp_path_factory.mktemp("demo") / "room"


@pytest.fixture(scope="session")
def story(demo_folder: Path) -> Story:
    """The demo with fewer Gaussians and photos, told once."""
    return tell(demo_folder, SMALL)
