"""Damaged OpenUSD: its own library reads it, in a process of its own here, whose death would be seen."""

import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from drsplat.formats.known import write_scene
from drsplat.formats.usd import parse_usd, read_usd
from drsplat.scene.labelled import LabelledScene, Thing
from mutations import quota
from places import SUPPORT
from refusing import malformed
from scene_files import random_gaussians

pytestmark = pytest.mark.oracle
pytest.importorskip("pxr")
MUTANTS = quota(300)
READER = """
import resource, sys, warnings
from pathlib import Path
import numpy as np
from drsplat.errors import DrSplatError
from drsplat.formats.usd import read_usd
from mutations import mutants, seeded

good, refused = Path(sys.argv[1]), 0
warnings.simplefilter("ignore")
resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))
for number, damaged in enumerate(mutants(good.read_bytes(), seeded(1), int(sys.argv[2]))):
    path = good.with_name(f"{number}{good.suffix}")
    path.write_bytes(damaged)
    try:
        gaussians = read_usd(path).gaussians
        assert np.isfinite(gaussians.means).all() and (gaussians.scales > 0).all()
    except DrSplatError:
        refused += 1
    path.unlink()
print(refused)
"""


def written(path: Path) -> Path:
    thing = Thing("red mug", 0.5, np.zeros(3), np.eye(3), np.ones(3), number=3)
    gaussians = random_gaussians(np.random.default_rng(0), 40)
    write_scene(path, LabelledScene(gaussians, things=(thing,), object_of=np.arange(40, dtype=np.int32) % 2 - 1))
    return path


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usdz"])
def test_damaged_files_are_refused_or_sound(suffix, tmp_path):
    """The file that the process read last is left where it does not come to its end."""
    command = [sys.executable, "-c", READER, str(written(tmp_path / f"good{suffix}")), str(MUTANTS)]
    ended = subprocess.run(command, cwd=SUPPORT, capture_output=True, text=True)
    left = [path.name for path in tmp_path.iterdir() if path.stem != "good"]
    assert ended.returncode == 0, f"{ended.returncode} at {left}: {ended.stderr[-2000:]}"
    assert 0 < int(ended.stdout) < MUTANTS


def section(content: bytes, name: bytes) -> int:
    """Return where the entry of a section begins in the table of contents."""
    table = struct.unpack_from("<Q", content, 16)[0]
    return content.index(name.ljust(16, b"\0"), table)


@pytest.mark.parametrize("name", [b"TOKENS", b"STRINGS", b"FIELDS", b"FIELDSETS", b"PATHS", b"SPECS"])
def test_a_count_without_its_bytes_is_refused_before_the_library_sees_it(name, tmp_path):
    path = written(tmp_path / "in.usdc")
    content = bytearray(path.read_bytes())
    start = struct.unpack_from("<Q", content, section(content, name) + 16)[0]
    struct.pack_into("<Q", content, start, 1 << 31)
    path.write_bytes(content)
    with malformed(rf"section b'{name.decode()}': .* hold no 2,147,483,648 entries"):
        read_usd(path)


@pytest.mark.parametrize("part", ["the table", "its count", "a section"])
def test_sections_outside_of_the_file_are_refused(part, tmp_path):
    path = written(tmp_path / "in.usdc")
    content = bytearray(path.read_bytes())
    table = struct.unpack_from("<Q", content, 16)[0]
    places = {"the table": 16, "its count": table, "a section": section(content, b"PATHS") + 16}
    struct.pack_into("<Q", content, places[part], 1 << 40)
    path.write_bytes(content)
    with malformed("section b'PATHS'" if part == "a section" else "no table of contents"):
        read_usd(path)


def test_a_file_that_ends_in_its_head_is_refused(tmp_path):
    path = written(tmp_path / "in.usdc")
    path.write_bytes(path.read_bytes()[:20])
    with malformed("ends after 20 bytes"):
        read_usd(path)


X = b'def X "a" { '


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"[" * (100 << 20), "brackets up to 200"),
        (b"(" + b"[" * (10 << 20), "brackets up to 200"),
        (b"(a = " + b"[]" * (1 << 20), "does not read it"),
        (X * 100_000, "brackets up to 200"),
        (b'variantSet "v" = { "a" { ' * 100_000, "brackets up to 200"),
        (X + b'string s = "' + b"a" * (10 << 20), "does not read it"),
        (X + b"float[] primvars:x = [" + b"(" * (10 << 20), "brackets up to 200"),
        (X + b"float[] primvars:x = [" + b"1" * (10 << 20) + b"]\n}", "no prim|does not read it"),
        (X + b"dictionary d = " + b"{ dictionary a = " * 100_000, "brackets up to 200"),
        (b"#" * (10 << 20), "no prim"),
        (b"/*" * (1 << 20), "does not read it"),
        (b'(a = """' + b'"" ' * (1 << 20), "does not read it"),
        (b"def X " + b"'''\\" * (1 << 20), "does not read it"),
        (X + b'float x = @"@ # "\n ' + b"( " * 1000, "brackets up to 200"),
    ],
    ids=map(str, range(14)),
)  # fmt: skip
def test_hostile_text_is_refused(text, message):
    with malformed(message):
        parse_usd(memoryview(b"#usda 1.0\n" + text))


@pytest.mark.parametrize("text", [b'"%s"', b"'%s'", b'"""%s"""', b"'''%s'''"])
def test_brackets_in_text_do_not_count(text):
    content = b"#usda 1.0\n(\n doc = " + text % (b"(" * 1000) + b"\n)\n# " + b"[" * 1000 + b"\n"
    with malformed("no prim of the schema"):
        parse_usd(memoryview(content))
