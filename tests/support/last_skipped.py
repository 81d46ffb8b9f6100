"""Option `--last-skipped` of pytest: run only what the last whole run skipped.

After `pip install` of an extra, the tests that waited for it run without repeating all the others.
"""

from pathlib import Path

import pytest

CACHE_KEY = "drsplat/skipped"


def add_option(parser: pytest.Parser) -> None:
    parser.addoption("--last-skipped", action="store_true", help="run only the tests that the last whole run skipped")


class SkipRecord:
    """Plugin that keeps the ids of skipped tests, and of files skipped whole, in pytest's cache."""

    def __init__(self) -> None:
        self._ids: set[str] = set()

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.skipped:
            self._ids.add(report.nodeid)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.skipped:
            self._ids.add(report.nodeid)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        session.config.cache.set(CACHE_KEY, sorted(self._ids))


class SkippedOnly:
    """Plugin that deselects every test that the last whole run did not skip; files without any are not imported."""

    def __init__(self, root: Path, ids: list[str]) -> None:
        self._ids = frozenset(ids)
        self._files = {root / node.split("::")[0] for node in ids}

    def pytest_ignore_collect(self, collection_path: Path) -> bool | None:
        return True if collection_path.suffix == ".py" and collection_path not in self._files else None

    def pytest_collection_modifyitems(self, config: pytest.Config, items: list[pytest.Item]) -> None:
        chosen = [item for item in items if {item.nodeid, item.nodeid.split("::")[0]} & self._ids]
        config.hook.pytest_deselected(items=[item for item in items if item not in chosen])
        items[:] = chosen


def register(config: pytest.Config, whole_suite: bool) -> None:
    """Add the plugin that the command line asks for; only a whole run is recorded, and by its main process alone.

    Raises: pytest.UsageError: no whole run has been recorded.
    """
    if not config.pluginmanager.hasplugin("cacheprovider"):
        return
    if config.option.last_skipped:
        ids = config.cache.get(CACHE_KEY, None)
        if ids is None:
            raise pytest.UsageError("--last-skipped: no run is recorded; run pytest without arguments first")
        config.pluginmanager.register(SkippedOnly(config.rootpath, ids), "skipped_only")
    elif whole_suite and not hasattr(config, "workerinput"):
        config.pluginmanager.register(SkipRecord(), "skip_record")
