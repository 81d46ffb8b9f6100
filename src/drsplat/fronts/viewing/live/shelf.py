"""A catalogue that is searched in the viewer, and the answer that is on show."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ....base.terminal import counted
from ....errors import InputError
from ....query.catalogue import Catalogue, Entry
from ..texts import printable

MAX_ENTRIES = 12


@dataclass(eq=False)
class Shelf:
    """entries: of the last answer, best first. opened: name and field's fingerprint of the scene that is open."""

    catalogue: Catalogue
    entries: Sequence[Entry] = ()
    opened: tuple[str, str] = ("", "")

    def ask(self, text: str) -> dict[str, Any]:
        """Search all scenes. Raises: InputError: no words, or such as the encoder does not know."""
        answer = self.catalogue.answer(text, top=MAX_ENTRIES)
        self.entries = answer.entries
        matches = counted(len(self.entries), "match", "matches")
        return {
            "summary": f"{matches} by {answer.measure}, threshold {answer.threshold:.3g}",
            "entries": [_entry(number, entry) for number, entry in enumerate(self.entries)],
        }

    def entry(self, number: int) -> Entry:
        """Return an entry by its number. Raises: InputError: there is none of that number."""
        if not 0 <= number < len(self.entries):
            raise InputError(f"there is no entry {number} of {len(self.entries)}: search the catalogue first")
        return self.entries[number]

    def picture(self, number: int) -> bytes:
        """Return the thumbnail of an entry as JPEG. Raises: InputError: it has none."""
        entry = self.entry(number)
        if entry.thumbnail is None:
            raise InputError(f"entry {number} has no picture")
        entry.picture()  # or the error that says that it is damaged
        return entry.thumbnail


def _entry(number: int, entry: Entry) -> dict[str, Any]:
    return {
        "number": number,
        "title": printable(entry.title, 60),
        "scene": printable(entry.scene, 60),
        "score": round(entry.score, 4),
        "picture": entry.thumbnail is not None,
    }
