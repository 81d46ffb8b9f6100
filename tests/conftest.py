"""Fixtures that are costly enough to be made once."""

import shutil
import signal
from importlib.util import find_spec
from pathlib import Path

import pytest

from drsplat.demo import story as household
from edited_rooms import write_room
from furnished.story import Setup, Story, tell

collect_ignore = [] if find_spec("msgspec") else ["test_view.py"]  # whose imports need the extra drsplat[viewer]
COSTLY = "household_story"
SMALL = Setup(coarse=2.0, num_views=12, size=(320, 240))


def pytest_configure() -> None:
    """What a shell starts in the background may ignore ctrl-C, and so would the programs that tests start."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """Tests of a file go to the same process, and so do all files that use the demo: each fixture is made once."""
    from xdist.scheduler import LoadScopeScheduling

    class ByFixture(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = nodeid.split("::")[0]
            return COSTLY if COSTLY in (config.rootpath / file).read_text(encoding="utf-8") else file

    return ByFixture(config, log)


@pytest.fixture(scope="session")
def demo_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the furnished room's files are; tests read them and write elsewhere."""
    return tmp_path_factory.mktemp("furnished") / "room"


@pytest.fixture(scope="session")
def story(demo_folder: Path) -> Story:
    """The furnished room with fewer Gaussians and photos, told once."""
    return tell(demo_folder, SMALL)


@pytest.fixture(scope="session")
def household_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the demo's files are; tests read them and write elsewhere."""
    return tmp_path_factory.mktemp("demo") / "room"


@pytest.fixture(scope="session")
def household_story(household_folder: Path) -> household.Story:
    """The demo, told once."""
    return household.tell(household_folder)


@pytest.fixture(scope="session")
def edited_room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A red and a blue ball, a field that knows both as objects, the photos' poses."""
    return write_room(tmp_path_factory.mktemp("edited"))


@pytest.fixture
def room(edited_room: Path, tmp_path: Path) -> Path:
    """A copy of it to edit; where a test file has a room of its own, that."""
    return Path(shutil.copytree(edited_room, tmp_path / "room"))
