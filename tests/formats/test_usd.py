"""OpenUSD: scenes with their objects, written and read by us and by programs of others."""

import shutil
import subprocess
import sys
import tracemalloc
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from command_line import answer_of
from drsplat import read_gaussians
from drsplat.errors import DrSplatWarning, MissingExtraError
from drsplat.formats.known import write_scene
from drsplat.formats.usd import read_usd
from drsplat.formats.usd_writing import prim_name
from drsplat.scene.gaussians import Gaussians
from drsplat.scene.labelled import LabelledScene, Thing
from labelled_scenes import NAMES, TURNED, labelled
from refusing import malformed, refused
from scene_files import ply_bytes, ply_columns, random_gaussians

needs_library = pytest.mark.usefixtures("library")
each_suffix = pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usdz"])


@pytest.fixture
def library():
    return pytest.importorskip("pxr")


def assert_equal(read: Gaussians, written: Gaussians, atol: float = 2e-7) -> None:
    """Compare all but positions to what another normalising of quaternions leaves."""
    assert_array_equal(read.means, written.means)
    for name in ("quats", "scales", "opacities", "sh"):
        assert_allclose(getattr(read, name), getattr(written, name), rtol=0, atol=atol, err_msg=name)


def assert_same_things(read: tuple[Thing, ...], written: tuple[Thing, ...]) -> None:
    for ours, theirs in zip(read, written, strict=True):
        assert (ours.name, ours.score, ours.parent) == (theirs.name, theirs.score, theirs.parent)
        for name in ("center", "axes", "extent"):
            assert_array_equal(getattr(ours, name), getattr(theirs, name))
        if theirs.embedding is not None:
            assert_array_equal(ours.embedding, theirs.embedding)


@needs_library
@each_suffix
def test_a_scene_comes_back_with_everything(suffix, tmp_path):
    scene, path = labelled(), tmp_path / f"out{suffix}"
    write_scene(path, scene)
    read = read_usd(path)
    assert_equal(read.gaussians, scene.gaussians)
    assert read.gaussians.fingerprint == scene.gaussians.fingerprint
    for name in ("things", "groups", "matches"):
        assert_same_things(getattr(read, name), getattr(scene, name))
    assert_array_equal(read.object_of, scene.object_of)
    assert_array_equal(read.relevancy, scene.relevancy)
    assert (read.title, read.query, read.up, read.encoder) == (scene.title, scene.query, scene.up, scene.encoder)
    assert [(note.text, note.outline is None) for note in read.annotations] == [("a point", True), ("a box", False)]
    assert_array_equal(read.annotations[1].outline.axes, TURNED)
    with refused("exists already"):
        write_scene(path, scene)


@needs_library
@each_suffix
@pytest.mark.parametrize("degree", range(4))
def test_each_degree_comes_back(degree, suffix, tmp_path):
    gaussians = replace(random_gaussians(default_rng(degree), 9, degree), antialiased=degree == 2)
    path = tmp_path / f"out{suffix}"
    write_scene(path, LabelledScene(gaussians))
    read = read_gaussians(path)
    assert_equal(read, gaussians)
    assert (read.sh_degree, read.antialiased, dict(read.extra)) == (degree, degree == 2, {})


@needs_library
def test_openusd_reads_what_we_write(tmp_path):
    """Typed values, and where the prims stand: up is +Y, boxes are where their numbers say."""
    from pxr import Gf, Usd, UsdGeom, UsdVol

    scene = labelled()
    write_scene(tmp_path / "out.usda", scene)
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    assert (UsdGeom.GetStageUpAxis(stage), UsdGeom.GetStageMetersPerUnit(stage)) == ("Y", 1.0)
    splat = UsdVol.ParticleField3DGaussianSplat(stage.GetPrimAtPath("/scene/gaussians"))
    g = scene.gaussians
    assert_array_equal(splat.GetPositionsAttr().Get(), g.means)
    assert_array_equal(splat.GetScalesAttr().Get(), g.scales)
    assert_array_equal(splat.GetOpacitiesAttr().Get(), g.opacities)
    turns = splat.GetOrientationsAttr().Get()
    assert_array_equal([[turn.GetReal(), *turn.GetImaginary()] for turn in turns], g.quats)
    harmonics = splat.GetRadianceSphericalHarmonicsCoefficientsAttr().Get()
    assert_array_equal(np.array(harmonics).reshape(len(g), -1, 3), g.sh)
    assert splat.GetRadianceSphericalHarmonicsDegreeAttr().Get() == 3
    numbers = UsdGeom.PrimvarsAPI(splat).GetPrimvar("object_id")
    assert numbers.GetInterpolation() == "vertex"
    assert_array_equal(numbers.Get(), scene.object_numbers)
    turn = UsdGeom.Xformable(splat).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
    assert_allclose(turn.TransformDir(Gf.Vec3d(*scene.up)), [0, 1, 0], atol=1e-12)
    world = UsdGeom.XformCache().GetLocalToWorldTransform(stage.GetPrimAtPath("/scene"))
    assert_allclose(turn.ExtractTranslation(), world.Transform(Gf.Vec3d(*g.origin)), atol=1e-6)
    prims = stage.GetPrimAtPath("/scene/objects").GetChildren()
    assert [prim.GetDisplayName() for prim in prims] == list(NAMES)
    for prim, thing in zip(prims, scene.things, strict=True):
        place = UsdGeom.Cube(prim).GetLocalTransformation()
        corner = thing.center + 0.5 * thing.extent @ thing.axes
        assert_allclose(place.Transform(Gf.Vec3d(0.5, 0.5, 0.5)), corner, atol=1e-12)


@needs_library
def test_the_extent_holds_three_standard_deviations(tmp_path):
    """Of one Gaussian that is turned by a quarter about z: its longest axis then lies along y."""
    from pxr import Usd, UsdGeom

    half = np.float32(np.sqrt(0.5))
    one = Gaussians(
        np.float32([[1, 2, 3]]), np.float32([[half, 0, 0, half]]),
        np.float32([[2, 1, 0.5]]), np.ones(1, np.float32), np.zeros((1, 1, 3), np.float32),
    )  # fmt: skip
    write_scene(tmp_path / "out.usda", LabelledScene(one))
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    extent = np.array(UsdGeom.Boundable(stage.GetPrimAtPath("/scene/gaussians")).GetExtentAttr().Get())
    assert_allclose(extent, [[-2, -4, 1.5], [4, 8, 4.5]], atol=1e-5)


@needs_library
@each_suffix
def test_openusd_finds_nothing_to_object(suffix, tmp_path):
    from pxr import Usd, UsdValidation

    write_scene(tmp_path / f"out{suffix}", labelled())
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 10
    errors = UsdValidation.ValidationContext(validators).Validate(Usd.Stage.Open(str(tmp_path / f"out{suffix}")))
    assert [error.GetMessage() for error in errors] == []


@needs_library
@each_suffix
def test_tinyusdz_reads_what_we_write(suffix, tmp_path):
    """Another implementation than OpenUSD's, in another language."""
    tinyusdz = pytest.importorskip("tinyusdz")
    scene, path = labelled(), tmp_path / f"out{suffix}"
    write_scene(path, scene)
    prims = {prim.name: prim for prim in tinyusdz.traverse(tinyusdz.load(str(path)))}
    splat = prims["gaussians"]
    assert splat.type_name == "ParticleField3DGaussianSplat"
    for name, expected in (("positions", scene.gaussians.means), ("scales", scene.gaussians.scales)):
        assert_array_equal(np.asarray(splat.get_attribute(name).value).reshape(-1, 3), expected)
    assert {prim_name(name, number) for number, name in enumerate(NAMES)} <= set(prims)


@needs_library
@each_suffix
def test_we_read_what_nvidias_converter_writes(suffix, tmp_path):
    program = Path(sys.executable).with_name("usd-convert-gsplat")
    if not program.exists() or shutil.which("usd-convert-gsplat", path=str(program.parent)) is None:
        pytest.skip("usd-convert-gsplat is not installed")
    gaussians = random_gaussians(default_rng(3), 50, 2)
    (tmp_path / "in.ply").write_bytes(ply_bytes(ply_columns(gaussians)))
    command = [str(program), "-i", str(tmp_path / "in.ply"), "-o", str(tmp_path / f"made{suffix}")]
    subprocess.run(command, check=True, capture_output=True)
    assert_equal(read_gaussians(tmp_path / f"made{suffix}"), read_gaussians(tmp_path / "in.ply"), 2e-6)


def library_stage(path: Path, halves: bool = False, degree: int = 1) -> Gaussians:
    """Write three Gaussians with OpenUSD's own classes, as half-precision numbers where `halves`."""
    from pxr import Gf, Usd, UsdGeom, UsdVol, Vt

    gaussians = random_gaussians(default_rng(4), 3, 3)
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, "Z")
    UsdGeom.Mesh.Define(stage, "/World/table")
    splat = UsdVol.ParticleField3DGaussianSplat.Define(stage, "/World/splat")
    wide = {
        "Positions": Vt.Vec3fArray.FromNumpy(gaussians.means), "Scales": Vt.Vec3fArray.FromNumpy(gaussians.scales),
        "Opacities": Vt.FloatArray.FromNumpy(gaussians.opacities),
        "Orientations": Vt.QuatfArray([Gf.Quatf(*map(float, quat)) for quat in gaussians.quats]),
    }  # fmt: skip
    narrow = {
        "Positions": Vt.Vec3hArray.FromNumpy(gaussians.means.astype(np.float16)),
        "Scales": Vt.Vec3hArray.FromNumpy(gaussians.scales.astype(np.float16)),
        "Opacities": Vt.HalfArray.FromNumpy(gaussians.opacities.astype(np.float16)),
        "Orientations": Vt.QuathArray([Gf.Quath(*map(float, quat)) for quat in gaussians.quats]),
    }  # fmt: skip
    for name, value in (narrow if halves else wide).items():
        getattr(splat, f"Create{name}{'h' if halves else ''}Attr")(value)
    splat.CreateRadianceSphericalHarmonicsDegreeAttr(degree)
    coefficients = np.zeros((3, (degree + 1) ** 2, 3), np.float32)
    shared = min(16, coefficients.shape[1])
    coefficients[:, :shared] = gaussians.sh[:, :shared]
    splat.CreateRadianceSphericalHarmonicsCoefficientsAttr(Vt.Vec3fArray.FromNumpy(coefficients.reshape(-1, 3)))
    stage.GetRootLayer().Save()
    return replace(gaussians, sh=np.ascontiguousarray(gaussians.sh[:, :shared]))


@needs_library
@pytest.mark.parametrize("suffix", [".usda", ".usdc"])
@pytest.mark.parametrize("halves", [False, True])
def test_we_read_what_openusd_writes(suffix, halves, tmp_path):
    gaussians = library_stage(tmp_path / f"in{suffix}", halves)
    read = read_gaussians(tmp_path / f"in{suffix}")
    assert_allclose(read.means, gaussians.means, atol=2e-3 if halves else 0)
    assert_allclose(read.quats, gaussians.quats, atol=2e-3 if halves else 2e-7)
    assert_allclose(read.sh, gaussians.sh, atol=1e-7)


@needs_library
@pytest.mark.parametrize("suffix", [".usda", ".usdc"])
def test_harmonics_above_degree_3_are_cut(suffix, tmp_path):
    gaussians = library_stage(tmp_path / f"in{suffix}", degree=4)
    with pytest.warns(DrSplatWarning, match="degree 4 are cut to 3"):
        read = read_gaussians(tmp_path / f"in{suffix}")
    assert_allclose(read.sh, gaussians.sh, atol=1e-7)


SPLAT = """def ParticleField3DGaussianSplat "s" {
  point3f[] positions = [(1, 2, 3), (4, 5, 6)]  # a comment, "with a quote
  quatf[] orientations = [(2, 0, 0, 0), (0, 0, 0, 1)]; float3[] scales = [(1, 1, 1), (1e-3, .5, 2.)]
  float[] opacities = [0.5, 1]
  uniform int radiance:sphericalHarmonicsDegree = 0
  float3[] radiance:sphericalHarmonicsCoefficients = [(0, 0, 0), (1, -1, 1)] ( elementSize = 1 )
}
"""
OTHERS = '''( """a layer's
  notes"""
  customLayerData = { dictionary d = { string a = "}" } }
  subLayers = [ @a.usda@, @@@b@c@@@ (offset = 1) ] )
class "_c" { }
over "o" { float x.timeSamples = { 0: 1, 1: 2 }
}
def Xform "w" (
  prepend references = @x.usd@</y>
  prepend variantSets = "v"
  variants = { string v = "a" }
)
{
  variantSet "v" = {
    "a" {
      def Mesh "m" { int[] i = [1, 2]; }
    }
  }
  prepend rel r = [</a>, </b>]
  color3f inputs:c.connect = </m.outputs:c>
  asset f = @tex.png@ ( doc = """it's) """ )
  string[] names = ["a]", 'b"', "c\\""]
  matrix4d m = ( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1) )
  double y = None
  /* no { brace */ // nor } this
  reorder nameChildren = ["s"]
''' + SPLAT + "}\n"  # fmt: skip


def text_file(path: Path, text: str) -> Path:
    """Write a layer, as a package where the name says so."""
    if path.suffix == ".usdz":
        with zipfile.ZipFile(path, "w") as package:
            package.writestr("a.usda", f"#usda 1.0\n{text}")
    else:
        path.write_text(f"#usda 1.0\n{text}")
    return path


@needs_library
@pytest.mark.parametrize("suffix", [".usda", ".usdz"])
def test_what_other_layers_have_is_stepped_over(suffix, tmp_path):
    read = read_gaussians(text_file(tmp_path / f"in{suffix}", OTHERS))
    assert_array_equal(read.means, [[1, 2, 3], [4, 5, 6]])
    assert_array_equal(read.quats, [[1, 0, 0, 0], [0, 0, 0, 1]])
    assert_array_equal(read.sh[:, 0], [[0, 0, 0], [1, -1, 1]])


BOTH = SPLAT + SPLAT.replace('"s"', '"t"')


@needs_library
def test_several_splats_are_one_scene(tmp_path):
    assert len(read_gaussians(text_file(tmp_path / "in.usda", BOTH))) == 4


@needs_library
@pytest.mark.parametrize(
    ("text", "change", "message"),
    [
        (SPLAT, ("ParticleField3DGaussianSplat", "Mesh"), "no prim of the schema .*, only Mesh"),
        (SPLAT, ("positions = [(1, 2, 3), (4, 5, 6)]", "positions.timeSamples = { 0: [(1, 2, 3)] }"), "move with time"),
        (SPLAT, ("point3f[] positions", "point3f[] n"), "expected positions of 3 numbers each"),
        (SPLAT, ("(4, 5, 6)", "(4, 5)"), "OpenUSD does not read it"),
        (SPLAT, ("(4, 5, 6)", "(4, 5, nan)"), "positions .* that are not finite"),
        (SPLAT, ("(4, 5, 6)", "(4, 5, 1e39)"), "positions .* that are not finite"),
        (SPLAT, ("(2, 0, 0, 0)", "(0, 0, 0, 0)"), "rotations"),
        (SPLAT, ("(1, 1, 1)", "(0, 1, 1)"), "scales"),
        (SPLAT, ("[0.5, 1]", "[0.5, 1.5]"), "opacities"),
        (SPLAT, ("[0.5, 1]", "[0.5]"), "2 positions, but 1 opacities"),
        (SPLAT, ("Degree = 0", "Degree = 1"), "have 8 harmonics, got 2"),
        (SPLAT, ("Degree = 0", "Degree = -1"), "degree from 0 to 3"),
        (SPLAT, ("uniform int", 'string drsplat:origin = "1"\nuniform int'), "3 finite numbers"),
        (SPLAT, ("[(1, 2, 3), (4, 5, 6)]", "[]"), "but 2 orientations"),
        (SPLAT, ('"s"', '"s'), "OpenUSD does not read it"),
        (SPLAT, ('"s"', '"\udcff"'), "what is no text"),
        (BOTH, ("{", '{ uniform token[] xformOpOrder = ["xformOp:translate"]\n'), "2 splats, and prims that are moved"),
    ],
)  # fmt: skip
def test_damage_is_named(text, change, message, tmp_path):
    assert change[0] in text
    content = "#usda 1.0\n" + text.replace(*change, 1)
    (tmp_path / "in.usda").write_bytes(content.encode(errors="surrogateescape"))
    with malformed(message):
        read_gaussians(tmp_path / "in.usda")


HUNDRED_THOUSAND = """
import sys; import numpy as np; from pathlib import Path
from drsplat.formats.known import write_scene; from drsplat.formats.usd import parse_usd, read_usd
from drsplat.scene.gaussians import Gaussians; from drsplat.scene.labelled import LabelledScene, Thing
def rows(*shape): return np.ones(shape, np.float32)
things = tuple(Thing(f"thing {n % 7}", 0.5, np.zeros(3), np.eye(3), np.ones(3)) for n in range(100_000))
g = Gaussians(rows(3, 3), rows(3, 4) / 2, rows(3, 3), rows(3), rows(3, 1, 3))
path = Path(sys.argv[1])
write_scene(path, LabelledScene(g, things=things, object_of=np.array([0, 99_999, -1], np.int32)))
read = read_usd(path)
assert [thing.name for thing in read.things] == [thing.name for thing in things]
assert read.object_of.tolist() == [0, 99_999, -1]
"""


@needs_library
@pytest.mark.slow
def test_a_hundred_thousand_objects(tmp_path):
    """In a process of its own: checks of types would take most of the time."""
    subprocess.run([sys.executable, "-c", HUNDRED_THOUSAND, str(tmp_path / "out.usda")], check=True)


@needs_library
@each_suffix
def test_what_no_file_could_give_back_is_refused(suffix, tmp_path):
    path = tmp_path / f"out{suffix}"
    gaussians = random_gaussians(default_rng(0), 3)
    gaussians.sh[1, 0, 0] = np.nan
    with refused("the first is row 1"):
        write_scene(path, LabelledScene(gaussians))
    with refused("no Gaussians to write"):
        write_scene(path, LabelledScene(gaussians.subset(np.zeros(0, int))))
    with refused("name that can be written"):
        write_scene(path, LabelledScene(gaussians.subset(np.array([0])), title="\ud800"))
    assert not path.exists()


@needs_library
def test_inspect_shows_the_objects(tmp_path, capsys):
    write_scene(tmp_path / "out.usda", labelled())
    answer = answer_of(capsys, "inspect", tmp_path / "out.usda")
    assert answer["num_gaussians"] == 40
    assert [one["name"] for one in answer["objects"]] == list(NAMES)
    assert answer["fingerprint"] == labelled().gaussians.fingerprint


def test_without_the_library_text_is_written_and_the_error_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "pxr", None)
    write_scene(tmp_path / "out.usda", labelled())
    (tmp_path / "in.usdc").write_bytes(b"PXR-USDC" + bytes(80))
    for name in ("out.usda", "in.usdc"):
        with refused(r"USD needs .*\[usd\]", MissingExtraError):
            read_gaussians(tmp_path / name)
    with refused(r"USD needs .*\[usd\]", MissingExtraError):
        write_scene(tmp_path / "out.usdz", labelled())


@pytest.mark.slow
def test_text_takes_little_memory_to_write_and_to_read(library, tmp_path):
    """It is made and read some thousand rows at a time; the library alone would take a dozen times the text."""
    path, scene = tmp_path / "out.usda", LabelledScene(random_gaussians(default_rng(0), 15_000))
    peaks = []
    for work in (lambda: write_scene(path, scene), lambda: assert_equal(read_gaussians(path), scene.gaussians)):
        tracemalloc.start()
        work()
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    size = path.stat().st_size
    assert size > 10 << 20
    assert peaks[0] < size / 2
    assert peaks[1] < 6 * size
    path.write_bytes(path.read_bytes().replace(b"), (", b") (", 1000))
    with malformed("expected numbers with commas between them"):
        read_gaussians(path)
