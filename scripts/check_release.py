"""Hold a release together: the tag, the version of pyproject.toml, CITATION.cff and the heading of CHANGELOG.md.

usage: python check_release.py vX.Y.Z [--notes]    --notes: print what CHANGELOG.md says of it
"""

import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def version() -> str:
    """Of pyproject.toml, which alone decides it."""
    return str(tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"])


def notes(number: str) -> tuple[str, str]:
    """Date (or "unreleased") and text of a version in CHANGELOG.md. Raises: SystemExit: it has no heading."""
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    found = re.search(rf"^## \[{re.escape(number)}\] - (\S+)\n(.*?)(?=^## \[|\Z)", text, re.MULTILINE | re.DOTALL)
    if not found:
        raise SystemExit(f"CHANGELOG.md has no heading '## [{number}] - DATE'")
    return found[1], found[2].strip()


def cited() -> str:
    """The version of CITATION.cff."""
    found = re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE)
    return found[1] if found else ""


def faults(tag: str) -> list[str]:
    number = version()
    date, _ = notes(number)
    return [
        *([f"the tag is {tag}, pyproject.toml says {number}: expected v{number}"] if tag != f"v{number}" else []),
        *([f"CITATION.cff is of {cited()}, pyproject.toml says {number}"] if cited() != number else []),
        *([f"CHANGELOG.md dates {number} '{date}'"] if not re.fullmatch(r"\d{4}-\d\d-\d\d", date) else []),
    ]


def main(arguments: list[str]) -> int:
    if "--notes" in arguments:
        print(notes(version())[1])
        return 0
    found = faults(arguments[0])
    print("\n".join(found) or f"{arguments[0]} is ready")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
