"""The line that installs an extra is one that works for drsplat as it was installed."""

import importlib.metadata
import json
from pathlib import Path

import pytest

from drsplat.errors import pip_install

ROOT = Path(__file__).resolve().parents[2]
ADDRESS = "https://example.org/drsplat"


class Installed:
    """What is kept of an installation: where it came from."""

    def __init__(self, record: str | None) -> None:
        self.record = record

    def read_text(self, name: str) -> str | None:
        assert name == "direct_url.json"
        return self.record


def line(monkeypatch: pytest.MonkeyPatch, record: object) -> str:
    text = record if record is None or isinstance(record, str) else json.dumps(record)
    monkeypatch.setattr(importlib.metadata, "distribution", lambda name: Installed(text))
    return pip_install("capture")


def test_a_checkout_is_named_by_its_folder(monkeypatch, tmp_path):
    checkout = tmp_path / "my checkout"
    checkout.mkdir()
    record = {"url": checkout.as_uri(), "dir_info": {}}
    assert line(monkeypatch, record) == f'pip install "{checkout}[capture]"'
    monkeypatch.chdir(checkout)
    assert line(monkeypatch, record) == 'pip install ".[capture]"'
    assert line(monkeypatch, record | {"dir_info": {"editable": True}}) == 'pip install -e ".[capture]"'


@pytest.mark.parametrize(("record", "wanted"), [
    (None, "drsplat[capture]"),  # an index
    ("no JSON", "drsplat[capture]"),
    ({"url": "file:///w/drsplat-0.1.0.whl", "archive_info": {}}, "/w/drsplat-0.1.0.whl[capture]"),
    ({"url": f"{ADDRESS}.whl", "archive_info": {}}, f"drsplat[capture] @ {ADDRESS}.whl"),
    ({"url": ADDRESS, "vcs_info": {"vcs": "git", "commit_id": "1"}}, f"drsplat[capture] @ git+{ADDRESS}"),
])  # fmt: skip
def test_other_origins(record, wanted, monkeypatch):
    assert line(monkeypatch, record) == f'pip install "{wanted}"'


def test_without_an_installation_it_is_that_of_an_index(monkeypatch):
    def absent(name):
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "distribution", absent)
    assert pip_install("capture") == 'pip install "drsplat[capture]"'


def test_no_other_place_knows_the_line():
    """A second form of it would be wrong for some installation."""
    found = [path for path in (ROOT / "src").rglob("*.py") if 'pip install "drsplat' in path.read_text("utf-8")]
    assert found == []
