"""--help in the width of the terminal: prose is filled, examples go on in the next line after a backslash."""

import argparse
import textwrap


class HelpFormatter(argparse.RawDescriptionHelpFormatter):
    def _fill_text(self, text: str, width: int, indent: str) -> str:
        blocks = text.split("\n\n")
        return "\n\n".join("\n".join(_block(block.splitlines(), width, indent)) for block in blocks)


def _block(lines: list[str], width: int, indent: str) -> list[str]:
    """Commands are indented, and so are lists; the lines between them are prose."""
    made: list[str] = []
    prose: list[str] = []
    for line in [*lines, "  "]:
        if not line.startswith("  "):
            prose.append(line)
            continue
        made += textwrap.wrap(" ".join(prose), width, initial_indent=indent, subsequent_indent=indent)
        prose = []
        made += _command(indent + line, width) if line.strip() else []
    return made


def _command(line: str, width: int) -> list[str]:
    if len(line) <= width:
        return [line]
    parts = textwrap.wrap(
        line, width - 2, subsequent_indent="      ", break_long_words=False, break_on_hyphens=False,
        drop_whitespace=True,
    )  # fmt: skip
    return [*(f"{part} \\" for part in parts[:-1]), parts[-1]]
