"""What a release consists of: one version, workflows that name what exists, recipes that are well-formed."""

import re
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest
from scripts import check_release

ROOT = Path(__file__).resolve().parents[2]

WORKFLOWS = sorted((ROOT / ".github/workflows").glob("*.yml"))
pytestmark = pytest.mark.skipif(not WORKFLOWS, reason="an sdist has no workflows")


def test_the_version_stands_in_one_place():
    """And where it has to stand again, it is the same."""
    number = check_release.version()
    assert version("drsplat") == number == check_release.cited()
    _, text = check_release.notes(number)
    assert "### Fields and answers" in text
    tree = [path for folder in ("src", "native", "scripts") for path in (ROOT / folder).rglob("*.*")]
    named = [path for path in tree if path.suffix in (".py", ".h", ".cpp") and f'"{number}"' in path.read_text()]
    assert not named


def test_a_tag_that_is_not_the_version_is_no_release(capsys):
    assert check_release.main(["v99.0.0"]) == 1
    assert "expected v" in capsys.readouterr().out


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.name)
def test_a_workflow_runs_scripts_that_exist(workflow):
    text = workflow.read_text(encoding="utf-8")
    for name in re.findall(r"(?:scripts|containers|tests)/[\w./]+\w", text):
        assert (ROOT / name).exists(), name
    for name in re.findall(r"uses: \./(\S+)", text):
        assert (ROOT / name).is_file(), name


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.name)
def test_actions_are_named_by_commit_and_keep_no_credentials(workflow):
    """A tag or a branch of an action may be moved by whoever takes its repository."""
    text = workflow.read_text(encoding="utf-8")
    used = re.findall(r"uses: (?!\./)(.+)", text)
    assert all(re.fullmatch(r"[\w/-]+@[0-9a-f]{40}  # v[\d.]+", one) for one in used), used
    assert text.count("actions/checkout@") == text.count("{ persist-credentials: false }")


def test_extras_that_workflows_install_exist():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    named = {extra for path in WORKFLOWS for group in re.findall(r"\"\.?\[([\w,]+)\]", path.read_text()) for extra in
             group.split(",")}  # fmt: skip
    assert named
    assert named <= extras.keys()
