"""Fixtures that are costly enough to be made once, and how the suite is spread over processes."""

import os
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

import last_skipped
import slow_tests
from browsing import a_browser
from drsplat.evaluation.demo import story as household
from furnished.story import Story, tell
from growing_rooms import full_room, half_room  # noqa: F401  (fixtures)
from toy_capture import write_balls

COSTLY = "household_story"
settings.register_profile("suite", max_examples=30, deadline=None)  # laws that need more, or fewer, say so
settings.load_profile("suite")
MAX_PROCESSES = 8  # each makes the costly fixtures of its files anew


def pytest_addoption(parser: pytest.Parser) -> None:
    last_skipped.add_option(parser)
    slow_tests.add_option(parser)


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config: pytest.Config) -> None:
    """Run the whole suite in a process for each core, and single files in this one; `-n` overrides both."""
    is_worker = hasattr(config, "workerinput")  # which would start workers of its own
    if not is_worker and not config.option.file_or_dir and getattr(config.option, "numprocesses", 0) is None:
        config.option.numprocesses, config.option.maxprocesses = "logical", MAX_PROCESSES
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        os.environ.setdefault("OMP_NUM_THREADS", "1")


def pytest_configure(config: pytest.Config) -> None:
    """Let tests interrupt the programs they start, also where a shell runs pytest in the background."""
    last_skipped.register(config, whole_suite=not config.option.file_or_dir)
    slow_tests.register(config, whole_suite=not config.option.file_or_dir)
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
    return tell(demo_folder)


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
    return write_balls(tmp_path_factory.mktemp("edited"))


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """A headless browser for the tests of a file."""
    with a_browser() as browser:
        yield browser


@pytest.fixture
def room(edited_room: Path, tmp_path: Path) -> Path:
    """A copy of it to edit; where a test file has a room of its own, that."""
    return Path(shutil.copytree(edited_room, tmp_path / "room"))


@pytest.fixture
def bounded_memory() -> Iterator[None]:
    """Reading a file of some kilobytes may take 48 MiB of address space."""
    from mutations import bounded_allocations

    with bounded_allocations(48 << 20):
        yield


@pytest.fixture(scope="session")
def cuda_engine_on_cpu() -> Any:
    """The CUDA kernels, compiled once for the CPU; skips where there is no C++ compiler."""
    from cuda_on_cpu import CpuEngine, compiled

    return CpuEngine(compiled())
