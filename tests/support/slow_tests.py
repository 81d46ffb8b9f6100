"""Option `--slow` of pytest: run the slow tests of the whole suite, too.

A few of the tests take three quarters of the time: kills at every stage, files damaged in thousands of ways, real
captures from photos to answers. `pytest` alone leaves them out, so that it is done in minutes.
"""

import pytest


def add_option(parser: pytest.Parser) -> None:
    parser.addoption("--slow", action="store_true", help="run the slow tests of the whole suite, too")


class WithoutSlow:
    """Plugin that deselects slow tests."""

    @staticmethod
    def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
        slow = [item for item in items if item.get_closest_marker("slow")]
        config.hook.pytest_deselected(items=slow)
        items[:] = [item for item in items if not item.get_closest_marker("slow")]


def register(config: pytest.Config, whole_suite: bool) -> None:
    """Leave slow tests out of a whole run, unless `--slow` or a marker is asked for."""
    if whole_suite and not config.option.slow and not config.option.markexpr:
        config.pluginmanager.register(WithoutSlow(), "without_slow")
