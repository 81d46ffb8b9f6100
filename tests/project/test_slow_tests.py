"""A whole run of pytest leaves slow tests out; `--slow`, a marker or a named file does not."""

from types import SimpleNamespace

import slow_tests


def registered(whole_suite: bool, slow: bool = False, markexpr: str = "") -> list[str]:
    """Return the plugins that are registered for a command line."""
    names: list[str] = []
    manager = SimpleNamespace(register=lambda _, name: names.append(name))
    config = SimpleNamespace(option=SimpleNamespace(slow=slow, markexpr=markexpr), pluginmanager=manager)
    slow_tests.register(config, whole_suite)
    return names


def test_only_a_whole_run_leaves_them_out():
    assert registered(whole_suite=True) == ["without_slow"]
    assert registered(whole_suite=False) == []
    assert registered(whole_suite=True, slow=True) == []
    assert registered(whole_suite=True, markexpr="slow") == []


def test_marked_tests_are_deselected(request):
    own = request.node
    marked = SimpleNamespace(get_closest_marker=lambda name: name == "slow")
    left_out: list[object] = []
    hook = SimpleNamespace(pytest_deselected=lambda items: left_out.extend(items))
    items = [own, marked]
    slow_tests.WithoutSlow.pytest_collection_modifyitems(SimpleNamespace(hook=hook), items)
    assert (items, left_out) == ([own], [marked])
