"""What a command loads when it starts: modules cost time whenever somebody asks."""

import subprocess
import sys

from drsplat.fronts.commands.verbs import GROUPS, SUMMARIES

BUILDING = {
    "drsplat.field.building", "drsplat.field.regrowing", "drsplat.field.carrying", "drsplat.field.registration",
    "drsplat.field.evidence.aggregation.aggregators", "torch", "scipy.ndimage",
}  # fmt: skip
TREES = {"scipy.spatial", "scipy.sparse.csgraph"}
SLOW = {"jaxtyping", "asyncio", "scipy", "PIL", "safetensors", "importlib.metadata", "importlib.resources"}


def loaded_by(*line: object) -> set[str]:
    """Modules that a fresh interpreter has loaded after a command."""
    code = "import sys; from drsplat.cli import main; main(sys.argv[1:]); print(*sys.modules, file=sys.stderr)"
    command = [sys.executable, "-c", code, *map(str, line)]
    return set(subprocess.run(command, capture_output=True, text=True, check=True).stderr.splitlines()[-1].split())


def test_every_verb_is_in_one_group_and_has_a_summary():
    assert [verb for verbs in GROUPS.values() for verb in verbs] == list(SUMMARIES)


def test_help_loads_no_verb():
    loaded = loaded_by("--help")
    assert {"drsplat.fronts.commands.verbs", "argparse"} <= loaded
    assert not loaded & {f"drsplat.fronts.commands.{verb}" for verb in SUMMARIES}
    assert not loaded & {"numpy", "scipy", "json", "tomllib", "html", "subprocess", "dataclasses"}


def test_a_question_loads_nothing_that_builds(story, demo_folder):
    field = demo_folder / "room.field"
    selected = loaded_by("select", field, "blue cup")
    assert "drsplat.field.language_field" in selected
    assert not selected & (BUILDING | TREES | SLOW | {"drsplat.formats.captures", "zstandard"})
    located = loaded_by("locate", field, "blue cup", "--scene", demo_folder / "scene.ply")
    assert located >= TREES  # which link what is selected, where the field has no objects
    assert not located & (BUILDING | {"jaxtyping", "PIL"})


def test_facts_of_a_field_need_no_matrix(story, demo_folder):
    inspected = loaded_by("inspect", demo_folder / "room.field")
    assert "drsplat.field.evidence.evidence" in inspected
    assert not inspected & (BUILDING | SLOW)


def test_facts_of_a_folder_need_nothing_that_edits_or_cuts(story, demo_folder):
    inspected = loaded_by("inspect", demo_folder)
    assert {"drsplat.authoring.editing.edits", "drsplat.formats.langsplat"} <= inspected
    assert not inspected & (BUILDING | TREES | {"scipy", "drsplat.authoring.editing.closing"})
