"""The documents are held to the code: links lead somewhere, references exist, tables are as made."""

import ast
import json
import re
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import pytest
from scripts import speed_picture
from scripts.made_tables import TABLES

import drsplat as ds
from drsplat.field.registration import Registration
from drsplat.formats.known import FORMATS
from drsplat.formats.tensors import map_tensors
from toy_capture import NEGATIVES

ROOT = Path(__file__).resolve().parents[2]
PAGES = (*(ROOT / "docs").rglob("*.md"), *(ROOT / name / "README.md" for name in ("world", "benchmarks")))
DOCUMENTS = sorted([*ROOT.glob("*.md"), *PAGES])
CODE_FOLDERS = ("", "src/drsplat", "native")

every_document = pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))


def blocks(document: str, language: str) -> list[str]:
    text = (ROOT / document).read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def test_the_readme_has_the_test_command_that_continuous_integration_runs():
    ci = (ROOT / ".ci/run").read_text(encoding="utf-8")
    pattern = re.search(r"grep -x '(.*)' README.md", ci)
    assert pattern
    lines = [line for block in blocks("README.md", "bash") for line in block.splitlines()]
    assert [line for line in lines if re.fullmatch(pattern[1], line)] == ['pip install ".[dev]" && pytest']


def test_every_public_name_has_its_purpose_in_a_line():
    text = (ROOT / "docs/api.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `(\w+)` \| .+ \|$", text.partition("## A scene")[0], re.MULTILINE)
    assert sorted(listed) == sorted(ds.__all__)


def without_code(text: str) -> str:
    return re.sub(r"^```.*?^```$|`[^`\n]+`", "", text, flags=re.MULTILINE | re.DOTALL)


def anchors(document: Path) -> set[str]:
    """Of the headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", document.read_text(encoding="utf-8"), re.MULTILINE)
    plain = [re.sub(r"[^\w\- ]", "", heading.strip().lower()) for heading in headings]
    return {heading.replace(" ", "-") for heading in plain}


@every_document
def test_links_lead_somewhere(document):
    links = re.findall(r"\]\(([^)\s]+)\)", without_code(document.read_text(encoding="utf-8")))
    for link in links:
        if re.match(r"[a-z]+:", link):
            continue
        path, _, anchor = link.partition("#")
        target = (document.parent / path) if path else document
        assert target.exists(), f"{link} in {document.name}"
        assert not anchor or anchor in anchors(target), f"{link} in {document.name}"


@every_document
def test_lines_are_of_at_most_120_characters(document):
    """But rows of tables and what has no space to break at, such as an address."""
    lines = document.read_text(encoding="utf-8").splitlines()
    too_long = [line for line in lines if len(line) > 120 and not line.startswith("|")]
    assert document.name == "README.md" or not [line for line in too_long if " " in line.strip("-* ")]


@every_document
def test_rows_of_tables_have_the_cells_of_their_head(document):
    """GitHub drops cells that a table has no column for."""
    prose = re.sub(r"^```.*?^```", "", document.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    for table in re.findall(r"(?:^ *\|.*\n?)+", prose, re.MULTILINE):
        numbers = {len(re.findall(r"(?<!\\)\|", row)) for row in table.strip().splitlines()}
        assert len(numbers) == 1, f"{document.name}: {table[:200]}"


def references(document: Path) -> list[tuple[str, str]]:
    """`file::name` in a document."""
    text = document.read_text(encoding="utf-8")
    return re.findall(r"`([\w./-]+\.(?:py|h|cpp))::([\w.]+)`", text)


@lru_cache
def defined(path: Path) -> frozenset[str]:
    """Functions, classes, methods (Class.method) and constants of a file."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        return frozenset(re.findall(r"\w+", re.sub(r"//.*", "", text)))
    names = set()
    for node in ast.parse(text).body:
        names |= names_of(node)
        if isinstance(node, ast.ClassDef):
            names |= {f"{node.name}.{name}" for part in node.body for name in names_of(part)}
    return frozenset(names)


def names_of(node: ast.stmt) -> set[str]:
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        return {node.name}
    targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
    elements = [part for target in targets if target for part in ast.walk(target)]
    return {part.id for part in elements if isinstance(part, ast.Name)}


@every_document
def test_references_exist(document):
    for file, name in references(document):
        found = [path for folder in CODE_FOLDERS if (path := ROOT / folder / file).is_file()]
        assert found, f"{document.name} names {file}, which does not exist"
        assert name in defined(found[0]), f"{document.name}: {file} has no {name}"


@pytest.mark.parametrize("page", TABLES, ids=lambda page: page.name)
def test_tables_that_are_made_of_the_code_are_as_made(page):
    assert "\n".join(TABLES[page]()) in page.read_text(encoding="utf-8"), "run: python -m scripts.made_tables"


def test_the_picture_of_times_is_that_of_its_table():
    rows = speed_picture.stages(speed_picture.PAGE.read_text(encoding="utf-8"))
    picture = speed_picture.PICTURE.read_text(encoding="utf-8")
    assert picture == speed_picture.drawn(rows), "run: python -m scripts.made_tables"
    assert all(row.name.split("(")[0] in picture for row in rows)


def test_every_format_of_scenes_stands_in_the_table():
    text = (ROOT / "docs/formats.md").read_text(encoding="utf-8")
    for one in FORMATS:
        kinds = [*one.suffixes, *one.files, *(kind for kind in one.write if kind.startswith("."))]
        assert all(f"`{kind.split(',')[0]}`" in text for kind in kinds), one.name
        assert not one.row or (" | no | no | " in one.row) == (one.name in ("LCC", "checkpoints"))


def test_every_rule_of_the_method_has_code_and_a_test():
    """In the tables of method.md, a row that says where a rule is also says what proves it."""
    text = (ROOT / "docs/method.md").read_text(encoding="utf-8")
    rows = [row for row in re.findall(r"^\|.+\|$", text, re.MULTILINE) if "::" in row]
    assert len(rows) > 30
    for row in rows:
        files = [file for file, _ in re.findall(r"`([\w./-]+)::([\w.]+)`", row)]
        proofs = [file for file in files if re.match(r"tests/\w+/test_", file)]
        assert proofs, f"no proof: {row}"
        assert set(files) - set(proofs), f"no code or twin: {row}"


@pytest.fixture(scope="module")
def field_folder(edited_room, tmp_path_factory) -> Path:
    encoder = ds.WordEncoder()
    folder = tmp_path_factory.mktemp("field") / "scene.field"
    field = ds.load_field(edited_room / "room.field")
    grown = Registration.from_field(field).to_field(ds.Mixture())
    field = replace(field, growth=grown.growth)
    texts, vectors = tuple(NEGATIVES), encoder.encode_texts(NEGATIVES)
    field.with_negatives(vectors, texts).with_contrast(vectors, texts).save(folder)
    return folder


def table_of(file: str) -> str:
    """Return the rows of the table of formats.md that describes a file of a field."""
    text = (ROOT / "docs/formats.md").read_text(encoding="utf-8")
    (table,) = re.findall(rf"^\| `{re.escape(file)}` \| .+\n((?:\|.*\n)+)", text, re.MULTILINE)
    return str(table)


def test_the_layout_of_a_field_is_as_documented(field_folder):
    """formats.md has a table for each file; `coarse*` are of residual codes, `view_times` of films."""
    documented = {
        (file, name): dtype
        for file in (path.name for path in field_folder.glob("*.safetensors"))
        for name, dtype in re.findall(r"^\| `(\w+)` \| (\w+) \(", table_of(file), re.MULTILINE)
    }
    for part in ("codes", "evidence", "negatives", "contrast", "objects", "growth"):
        file = f"{part}.safetensors"
        tensors, _ = map_tensors(field_folder / file)
        for name, array in tensors.items():
            assert documented.pop((file, name), None) == array.dtype.name, f"{file}: {name}"
    assert {name for _, name in documented} == {"coarse", "coarse_ids", "view_times"}


def test_the_manifest_of_a_field_is_as_documented(field_folder):
    keys = set(re.findall(r"^\| `(\w+)` \|", table_of("field.json"), re.MULTILINE))
    assert keys == set(json.loads((field_folder / "field.json").read_text()))
