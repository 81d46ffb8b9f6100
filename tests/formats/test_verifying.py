"""`drsplat inspect --verify` finds a flipped bit in every file with checksums, and says what it did with others."""

import io
import json
import shutil
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np
import pytest
from numpy.random import default_rng

from catalogued import write_scene
from command_line import answer_of, error_of, text_of
from drsplat.cli import main
from drsplat.errors import DrSplatError
from drsplat.field import build_field
from drsplat.field.codes import PQ, load_codebook, save_codebook
from drsplat.field.tiles.cutting import cut
from drsplat.formats.embedding_record import open_record
from drsplat.formats.langsplat import write_features
from drsplat.formats.moving_scenes import MOTION, read_moving, write_moving
from drsplat.formats.sources import blocks_of
from drsplat.formats.tensors import map_tensors
from drsplat.formats.tiles import TILES, read_tiles
from drsplat.scene.labelled import Annotation
from fields import SCENE, TOY, random_evidence, toy_field, unit_rows
from moving_scenes import drifting
from mutations import quota
from refusing import malformed
from scenes import random_gaussians

FLIPS = quota(10)  # spread over each file, besides its beginning and its end
EDGE_BYTES = 8


def write_field(folder: Path) -> Path:
    rng = default_rng(2)
    field = build_field(random_evidence(rng), SCENE, TOY, PQ())
    field.with_negatives(unit_rows(rng, 2, 32), ("one", "two")).save(folder / "a.field")
    return folder / "a.field"


def write_motion(folder: Path) -> Path:
    write_moving(folder / "a.motion", drifting(12))
    return folder / "a.motion"


def write_tiles(folder: Path, seed: int = 0) -> Path:
    import drsplat as ds

    ds.write_gaussians(folder / f"{seed}.ply", random_gaussians(60, seed))
    cut(blocks_of([folder / f"{seed}.ply"]), folder / f"{seed}.tiles", 25)
    return folder / f"{seed}.tiles"


def write_catalogue(folder: Path) -> Path:
    from drsplat.query.catalogue import Catalogue

    catalogue = Catalogue.open(folder / "a.catalogue")
    for name, words in (("kitchen", ("red mug", "table", "plant")), ("hall", ("blue mug", "chair", "lamp"))):
        catalogue.add(write_scene(folder / name, words, photos=False))
    catalogue.remove("hall")
    return catalogue.path


def write_embedded(folder: Path) -> Path:
    record = open_record(folder / "features", {"encoder": {"name": "toy", "dim": 8, "weights": ""}})
    masks = np.repeat(np.arange(12).reshape(1, 3, 4) % 3, 4, axis=0).astype(np.int32)
    write_features(record.folder, "photo", masks, unit_rows(default_rng(1), 3, 8), form="compact")
    record.add("photo", "hash", {"large": 3}, 0, "compact")
    record.close()
    return record.folder


WRITERS = (write_field, write_motion, write_tiles, write_catalogue, write_embedded)


def verdict(path: Path) -> tuple[int, str]:
    """The exit code of `drsplat inspect PATH --verify`, and what it says."""
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as said:
        code = main(["inspect", str(path), "--verify", "--json"])
    return code, out.getvalue() + said.getvalue()


def positions(size: int, rng: np.random.Generator) -> list[int]:
    edges = [*range(min(EDGE_BYTES, size)), *range(max(0, size - EDGE_BYTES), size)]
    return sorted({*edges, *rng.integers(0, size, FLIPS).tolist()})


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*no thumbnails")
@pytest.mark.parametrize("write", WRITERS)
def test_a_flipped_bit_in_any_file_is_found_and_the_file_named(write, tmp_path):
    path, rng = write(tmp_path), default_rng(7)
    files = sorted(file for file in path.rglob("*") if file.is_file())
    code, said = verdict(path)
    assert code == 0
    assert sorted(json.loads(said)["verified"]) == [file.relative_to(path).as_posix() for file in files]
    for file in files:
        good = file.read_bytes()
        for at in positions(len(good), rng):
            damaged = bytearray(good)
            damaged[at] ^= 1 << int(rng.integers(8))
            file.write_bytes(damaged)
            code, said = verdict(path)
            assert (code, file.name in said) == (1, True), (file, at, said)
        file.write_bytes(good)
    assert verdict(path)[0] == 0


# --- films ---


def test_a_film_with_a_flipped_bit_never_shows_other_frames(tmp_path):
    path, rng = write_motion(tmp_path), default_rng(3)

    def frames():
        moving = read_moving(path)
        shown = [moving.at(time) for time in moving.times.tolist()]
        return [array.tobytes() for g in shown for array in (g.means, g.quats, g.scales, g.opacities, g.sh)]

    expected = frames()
    for file in sorted(path.iterdir()):
        good = file.read_bytes()
        for at in positions(len(good), rng):
            damaged = bytearray(good)
            damaged[at] ^= 4
            file.write_bytes(damaged)
            with pytest.raises(DrSplatError, match=r"a\.motion"):
                frames()
        file.write_bytes(good)
    assert frames() == expected


def test_a_damaged_frame_is_refused_and_the_others_are_shown(tmp_path):
    path = write_motion(tmp_path)
    means = map_tensors(path / MOTION)[0]["means"]
    content = bytearray((path / MOTION).read_bytes())
    content[content.index(means[2].tobytes()) + 5] ^= 1
    (path / MOTION).write_bytes(content)
    moving = read_moving(path)
    assert len(moving.at(float(moving.times[4]))) == 12
    with malformed(r"means: damaged: row 2 is not what was written.*drsplat motion"):
        moving.at(float(moving.times[2]))


# --- tiles ---


def test_colours_of_two_tiles_are_not_mixed_up(tmp_path):
    path = write_tiles(tmp_path)
    one, other = path / "tile00000.colours.safetensors", path / "tile00001.colours.safetensors"
    one.rename(tmp_path / "aside")
    other.rename(one)
    (tmp_path / "aside").rename(other)
    with malformed(r"tile00000\.colours.*another file than tiles\.json names"):
        read_tiles(path).gaussians()


def test_tiles_of_another_cut_are_refused(tmp_path):
    path, other = write_tiles(tmp_path), write_tiles(tmp_path, seed=1)
    for file in other.glob("tile0*"):
        shutil.copy(file, path)
    tiles = read_tiles(path)
    with malformed(r"tile00000\.shapes.*another file than tiles\.json names.*cut the scene"):
        tiles.shapes(tiles.tiles[0])


# --- what it is, and what was done ---


def test_every_kind_says_what_it_is(tmp_path, capsys):
    tiles = write_tiles(tmp_path)
    for path in (tiles, tiles / TILES):
        answer = answer_of(capsys, "inspect", path)
        assert (answer["kind"], answer["num_gaussians"], answer["num_tiles"]) == ("tiles", 60, 4)
    field = write_field(tmp_path)
    assert answer_of(capsys, "inspect", field / "field.json")["kind"] == "field"
    answer = answer_of(capsys, "inspect", field / "codes.safetensors", "--verify")
    assert (answer["kind"], answer["verified"]) == ("tensors", ["codes.safetensors"])
    save_codebook(toy_field().codebook, tmp_path / "book.safetensors")
    answer = answer_of(capsys, "inspect", tmp_path / "book.safetensors", "--verify")
    assert (answer["kind"], answer["verified"]) == ("codebook", ["book.safetensors"])
    assert answer_of(capsys, "inspect", write_embedded(tmp_path) / "embedding.json")["kind"] == "features"
    assert "verified  " in text_of(capsys, "inspect", tiles, "--verify")


def test_files_that_people_edit_say_what_was_read(tmp_path, capsys):
    from drsplat.formats.annotations import AnnotationFile

    AnnotationFile.beside(tmp_path / "a.ply").add([Annotation("from Delft", np.zeros(3))])
    answer = answer_of(capsys, "inspect", tmp_path / "a.annotations.json", "--verify")
    assert (answer["kind"], answer["texts"], answer["verified"]) == ("annotations", ["from Delft"], [])
    assert "no checksum" in answer["checked"]
    edits = {"format": "drsplat edits", "version": 1, "scene": "3-ab", "done": 0, "edits": []}
    (tmp_path / "a.edits.json").write_text(json.dumps(edits))
    assert answer_of(capsys, "inspect", tmp_path / "a.edits.json")["num_edits"] == 0
    labels = {"format": "drsplat labels", "version": 1, "labels": []}
    (tmp_path / "a.labels.json").write_text(json.dumps(labels))
    assert answer_of(capsys, "inspect", tmp_path / "a.labels.json")["names"] == []
    (tmp_path / "a.labels.json").write_text(json.dumps({**labels, "labels": [5]}))
    assert "a.labels.json" in error_of(capsys, "inspect", tmp_path / "a.labels.json", "--verify")


def test_a_faiss_index_is_told_by_its_content(tmp_path, capsys):
    (tmp_path / "index.bin2").write_bytes(b"IxF2" + bytes(40))
    assert "FAISS" in error_of(capsys, "inspect", tmp_path / "index.bin2")
    with malformed(r"FAISS index.*read_codebook"):
        load_codebook(tmp_path / "index.bin2")
