"""The public names, what importing them costs, and the one direction of imports."""

import ast
import re
import subprocess
import sys
from collections import Counter
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path

import pytest

import drsplat

HEAVY = ("torch", "faiss", "rich", "scipy", "numpy", "PIL")

# A module imports only from wings and rooms before its own, or from its own. Rooms of a wing follow their order.
WINGS: dict[str, tuple[str, ...]] = {
    "errors": (),
    "base": (),
    "scene": (),
    "kernels": (),
    "formats": (),
    "field": ("codes", "evidence", "", "objects", "registration", "method", "tiles", "growing"),
    "photos": ("models", "capture", "embedding", "arriving"),
    "drawing": (),
    "query": ("", "catalogue"),
    "authoring": ("editing", "exporting", "filming", "exchange", "photographing"),
    "training": ("triangulation", ""),
    "evaluation": ("", "demo"),
    "fronts": ("serving", "viewing", "scanning", "commands"),
    "cli": (),
    "__main__": (),
}
ORDER = tuple(f"{wing}.{room}".strip(".") for wing, rooms in WINGS.items() for room in rooms or ("",))
SOURCE = Path(drsplat.__file__).parent


def test_public_names_are_few_and_no_others_are_shown():
    """Each stands in docs/api.md as well (`test_docs.py`)."""
    assert len(drsplat.__all__) <= 41  # with __version__
    assert set(dir(drsplat)) == set(drsplat.__all__)


@pytest.mark.parametrize("name", drsplat.__all__)
def test_public_name_is_there_and_named_so(name):
    thing = getattr(drsplat, name)
    assert getattr(thing, "__name__", name) == name


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'read_gausians'"):
        drsplat.read_gausians  # noqa: B018


def test_version_is_the_installed_one():
    assert drsplat.__version__ == version("drsplat")


def imported_by(statement: str) -> set[str]:
    """Of HEAVY, what a fresh interpreter has loaded after a statement."""
    code = f"import sys; {statement}; print(*[m for m in {HEAVY} if m in sys.modules])"
    command = [sys.executable, "-c", code]
    return set(subprocess.run(command, capture_output=True, text=True, check=True).stdout.split())


def test_importing_the_package_imports_nothing_heavy():
    assert imported_by("import drsplat") == set()
    assert imported_by("from drsplat.cli import make_parser; make_parser()") == set()


def test_no_public_name_needs_torch_faiss_or_rich():
    loaded = imported_by("from drsplat import *")
    assert not loaded & {"torch", "faiss", "rich"}
    assert "numpy" in loaded  # so this test could fail


def place_of(parts: list[str]) -> str:
    """Where in ORDER a module of drsplat is: its wing, and its room where the wing has some."""
    wing, *inner = parts
    return f"{wing}.{inner[0]}" if inner and inner[0] in WINGS[wing] else wing


@lru_cache(1000)
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@lru_cache(2000)
def imported(path: Path, *, types: bool = True) -> set[str]:
    """Modules and names of drsplat, without its own name, that a file imports from, wherever in it.

    types: also what types alone need.
    """
    package, tree = path.relative_to(SOURCE).parent.parts, parsed(path)
    asides = [n for n in ast.walk(tree) if isinstance(n, ast.If) and ast.unparse(n.test) == "TYPE_CHECKING"]
    left_out = set() if types else {id(inner) for node in asides for inner in ast.walk(node)}
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level and id(node) not in left_out:
            base = [*package[: len(package) - node.level + 1], *(node.module.split(".") if node.module else [])]
            found |= {".".join([*base, alias.name]) for alias in node.names}
    return found


def imports_of(path: Path) -> set[str]:
    """Places in ORDER that a file imports from; the package itself is none."""
    parts = [name.split(".") for name in imported(path)]
    return {place_of(name) for name in parts if name[0] in WINGS}


MODULES = sorted(SOURCE.rglob("*.py"))


def test_imports_go_one_way():
    """But a wing's `__init__` names modules of its rooms, and loads none."""
    upwards = {}
    for path in MODULES:
        parts = path.relative_to(SOURCE).with_suffix("").parts
        assert parts[0] in {*WINGS, "__init__"}, f"give the new module '{parts[0]}' its place in WINGS"
        if parts[-1] != "__init__":
            own = ORDER.index(place_of(list(parts)))
            upwards[path] = {name for name in imports_of(path) if ORDER.index(name) > own}
    assert {path: names for path, names in upwards.items() if names} == {}


def test_no_two_modules_need_each_other():
    def name_of(path: Path) -> str:
        return ".".join(path.relative_to(SOURCE).with_suffix("").parts).removesuffix(".__init__")

    paths = {name_of(path): path for path in MODULES}
    left = {}
    for name, path in paths.items():
        named = imported(path, types=False)
        left[name] = (named | {one.rpartition(".")[0] for one in named if one not in paths}) & paths.keys() - {name}
    while free := {name for name, needed in left.items() if not needed & left.keys()}:
        left = {name: needed for name, needed in left.items() if name not in free}
    assert sorted(left) == []  # what remains is in a circle, or needs one


def test_annotations_of_arrays_are_from_one_module():
    asking = [path for path in MODULES if "from jaxtyping" in path.read_text(encoding="utf-8")]
    assert asking == [SOURCE / "base/arrays.py"]


def test_few_entries_stand_at_the_root():
    entries = {path.name for path in SOURCE.iterdir()} - {"py.typed", "_native.pyi", "__pycache__"}
    assert len({name for name in entries if not name.startswith("_native.")}) <= 16


FOLDERS = sorted(path.parent for path in SOURCE.rglob("__init__.py") if path.parent != SOURCE)


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.relative_to(SOURCE).as_posix())
def test_a_folder_says_what_it_is_for(folder):
    doc = ast.get_docstring(parsed(folder / "__init__.py"))
    assert len(doc.split()) > 5


@pytest.mark.parametrize("wing", sorted({path.parent for path in SOURCE.glob("*/__init__.py")}), ids=lambda p: p.name)
def test_a_wing_says_where_to_begin_and_what_it_imports(wing):
    doc = ast.get_docstring(parsed(wing / "__init__.py"))
    purpose, _, imports = doc.rpartition("\n\nImports ")
    assert "Begin with" in " ".join(purpose.split())
    used = {name.split(".")[0] for path in wing.rglob("*.py") for name in imports_of(path)}
    assert set(re.findall(r"`(\w+)`", imports)) == used - {wing.name, "base", "errors"}


@pytest.mark.parametrize(
    "written", ["0.2820947917", "0.299, 0.587", "1 - 2 * (y * y + z * z)", "searchsorted(field.gaussian_ids"]
)
def test_a_rule_is_written_once(written):
    """Beside the twins, whose point is to be written again."""
    found = [path.name for path in MODULES if written in path.read_text(encoding="utf-8")]
    assert len(found) <= 1, found


def test_docstrings_begin_with_whole_sentences():
    half = re.compile(r'^ *r?"""(Of|As|What|Who|Whoever|Where|Whether|From) .*', re.MULTILINE)
    assert {path: words for path in MODULES if (words := half.findall(path.read_text()))} == {}


VERBS = set(
    """
    Add Allow Annotate Answer Append Apply Arrange Ask Assemble Become Begin Bring Build Call Cast Change Check
    Choose Claim Clip Close Code Compare Composite Compute Concatenate Convert Copy Correlate Count Create Cut
    Declare Decode Decompress Delete Describe Detect Discard Do Draw Drop Embed Encode End Enlarge Evaluate
    Export Fill Find Fit Forget Format Give Go Grow Hand Hash Identify Import Interpolate Join Judge Keep Label
    Lay Learn Leave Let List Load Locate Lock Log Look Lower Make Map Mark Match Measure Merge Move Multiply Name
    Normalise Note Observe Offer Open Optimise Pack Pad Paint Parse Pick Plan Pose Prepare Print Project Put
    Quantise Quote Read Record Refine Refuse Register Relocate Remove Rename Render Renumber Repeat Replace
    Report Reset Resize Restore Return Rewrite Rotate Round Run Save Say Scale Score Search See Select Send Set
    Show Silence Sort Speak Split Stack Start Step Stop Sum Take Tell Tile Train Transform Triangulate Turn Undo
    Upscale Verify Wait Wake Warn Weigh Wrap Write Yield
    """.split()  # noqa: SIM905 - a list of them would be 200 lines
)
"""What docstrings of functions begin with. A further one belongs here; a noun leaves open what is done with it."""


def test_docstrings_of_functions_begin_with_a_verb():
    """But those of properties, which say what they are."""
    assert {path: lines for path in MODULES if (lines := nouns_first(path))} == {}


def nouns_first(path: Path) -> list[str]:
    functions = [node for node in ast.walk(parsed(path)) if isinstance(node, ast.FunctionDef)]
    actions = [node for node in functions if not any("property" in ast.unparse(d) for d in node.decorator_list)]
    lines = [text.splitlines()[0] for node in actions if (text := ast.get_docstring(node))]
    return [line for line in lines if line.split()[0].rstrip(",:;") not in VERBS]


def test_no_module_gives_a_name_twice():
    """The second would be meant where the first is read: so a joined module reads another's constant."""
    assert {path: names for path in MODULES if (names := given_twice(path))} == {}


def given_twice(path: Path) -> list[str]:
    names: list[str] = []
    for node in parsed(path).body:
        if isinstance(node, ast.Assign):
            names += [name.id for target in node.targets for name in ast.walk(target) if isinstance(name, ast.Name)]
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            names.append(node.target.id)
    return [name for name, count in Counter(names).items() if count > 1 and name != "__all__"]
