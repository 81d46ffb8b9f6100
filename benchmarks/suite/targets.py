"""The table of questions with no, one or several targets, of what `study_targets.py` has counted."""

from collections.abc import Mapping
from typing import Any, Literal

from .tables import markdown

Said = Literal["nothing", "maybe", "all", "fewer", "more", "wrong"]
SAID: dict[Said, str] = {
    "nothing": "“no such object”", "maybe": "maybe", "all": "sure of exactly the targets",
    "fewer": "sure of some of them", "more": "sure of more besides", "wrong": "sure of other things alone",
}  # fmt: skip
"""What is said, and its column."""
ROWS = {"0": "0", "1": "1", "N": "2 or more"}


def targets_table(counted: Mapping[str, Any]) -> str:
    """Rows by the number of targets: how many words were asked, and the percent of each answer."""
    rows = []
    for kind, name in ROWS.items():
        answers = counted["answers"][kind]
        total = sum(answers.values())
        shares = [f"{100 * answers[said] / total:.0f} %" if total else "" for said in SAID]
        rows.append((name, str(total), *shares))
    return markdown(("targets", "words asked", *SAID.values()), rows)
