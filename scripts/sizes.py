#!/usr/bin/env python3
"""Count the code: tokens of Python without comments, docstrings, newlines and indents, which lines cannot cheat.

usage: python -m scripts.sizes            the wings of src/drsplat, its modules, and what stands around it
       python -m scripts.sizes --check    fails where src/drsplat is above the ceiling
       python -m scripts.sizes FOLDER...  each file of these folders, the largest last
"""

import ast
import io
import sys
import tokenize
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "drsplat"
CEILING = 500_000  # tokens of src/drsplat: what it had when the ceiling was set, and room for one large change
AROUND = ("tests", "benchmarks", "world", "scripts")
SHORT = 60  # lines
LAYOUT = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER,
}  # fmt: skip
DOCUMENTED = (ast.Module, ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)


def tokens(source: str) -> int:
    """Return the number of tokens of Python code that do something."""
    nodes = [node for node in ast.walk(ast.parse(source)) if isinstance(node, DOCUMENTED) and ast.get_docstring(node)]
    said = {node.body[0].lineno for node in nodes}
    found = tokenize.generate_tokens(io.StringIO(source).readline)
    return sum(one.type not in LAYOUT and not (one.type == tokenize.STRING and one.start[0] in said) for one in found)


def sizes(folder: Path) -> dict[Path, int]:
    """Return the tokens of each module below a folder."""
    return {path: tokens(path.read_text(encoding="utf-8")) for path in sorted(folder.rglob("*.py"))}


def main(arguments: list[str]) -> int:
    if arguments and arguments != ["--check"]:
        for path, count in sorted(
            (pair for name in arguments for pair in sizes(Path(name)).items()), key=lambda p: p[1]
        ):
            print(f"{count:8,} {path}")
        return 0
    source = sizes(SOURCE)
    total = sum(source.values())
    if arguments:
        print(f"src/drsplat: {total:,} tokens of {CEILING:,}")
        return total > CEILING  # a change that needs more raises CEILING, and says why in that line
    wings: Counter[str] = Counter()
    for path, count in source.items():
        inner = path.relative_to(SOURCE).parts
        wings[inner[0] if len(inner) > 1 else "(top)"] += count
    rows = [*sorted(wings.items(), key=lambda wing: -wing[1]), ("src/drsplat", total)]
    rows += [(name, sum(sizes(ROOT / name).values())) for name in AROUND]
    print("| | tokens |\n|---|---|")
    for name, count in rows:
        print(f"| {name} | {count:,} |")
    short = sum(len(path.read_text(encoding="utf-8").splitlines()) < SHORT for path in source)
    print(f"| modules of src/drsplat; under {SHORT} lines | {len(source)}; {short} |")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
