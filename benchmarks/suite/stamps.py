"""Stamps of the code that decides a number, so that a run never takes finished parts of older rules for fresh ones.

A stamp is a hash of source code without comments and docstrings: explaining a rule better makes nothing stale.
"""

import ast
import hashlib
from functools import cache
from pathlib import Path

SOURCE_SUFFIXES = (".py", ".cpp", ".h", ".ts", ".css", ".html")
ROOT = Path(__file__).resolve().parents[2]
PACKAGE, SUITE = ROOT / "src" / "drsplat", ROOT / "benchmarks" / "suite"

REGISTERED = (  # masks, their embeddings, and what they say of Gaussians
    *(PACKAGE / name for name in ("field/codes", "field/evidence", "kernels", "photos/models", "scene")),
    *(ROOT / "native" / name for name in ("host", "kernels")),
)
ASKED = (PACKAGE / "field", PACKAGE / "query")
SCORED = (PACKAGE / "evaluation", *(SUITE / name for name in ("masks.py", "scenes.py", "scoring.py")))
FEATURES = (PACKAGE / "query" / "thresholds.py", *SCORED)  # how systems are scored that only have a feature a Gaussian

METHODS = (*REGISTERED, *ASKED, *SCORED, SUITE / "aggregators", SUITE / "methods.py")
"""What decides how an aggregator, or answers in whole objects, do in a made room."""
RENDERED = (*REGISTERED, *FEATURES, SUITE / "rendered.py")
"""The same of features that are fitted to renderings."""
FITTED = (*FEATURES, SUITE / "rivals")
"""The same of rivals, which take hours: no rule of ours but how masks are made and answers are scored."""
ANSWERS = (
    *REGISTERED,
    *ASKED,
    ROOT / "benchmarks" / "drawn_embeddings.py",
    *(
        SUITE / f"{name}.py"
        for name in ("answers", "masks", "outlines", "places", "scenes", "scoring", "trials", "vocabularies")
    ),
)
"""What decides the answers to words in rooms and captures."""


@cache
def stamp(paths: tuple[Path, ...]) -> str:
    """Return 12 hexadecimal digits for files, and for all source files in folders."""
    digest = hashlib.blake2b(digest_size=6)
    for path in paths:
        files = [path] if path.is_file() else [p for p in sorted(path.rglob("*")) if p.suffix in SOURCE_SUFFIXES]
        for file in files:
            digest.update(f"{file.relative_to(ROOT).as_posix()}\n".encode() + _code(file) + b"\n")
    return digest.hexdigest()


def _code(file: Path) -> bytes:
    return without_words(file.read_text(encoding="utf-8")).encode() if file.suffix == ".py" else file.read_bytes()


def without_words(source: str) -> str:
    """Return Python code as a syntax tree in words, without comments and docstrings.

    >>> without_words('def f():\\n    "What it does."\\n    return 1  # why') == without_words("def f(): return 1")
    True
    """
    tree = ast.parse(source)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [part for part in body if not _is_text(part)]  # type: ignore[attr-defined]
    return ast.dump(tree)


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
