"""Changes of a catalogue: scenes come and go, the index is built; each replaces `catalogue.json` once.

New files are written before it, and files that no version names any more are removed after it. A kill at any moment
leaves the former version or the new one.
"""

import json
import os
import time
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from ...base.arrays import Arrays, ArraysByName
from ...field.codes import PQ, Codebook, Codes, pq_code, save_codebook, train_codebook
from ...formats.json_files import write_json
from ...formats.replacing import claimed_output
from ...formats.tensors import header_checksum, map_tensors, sealed, write_tensors
from ...scene.encoders import EncoderIdentity
from .entries import SceneEntry
from .snapshot import DOCUMENT, FORMAT, ROWS, VERSION, Contents, FileEntry, PartEntry, Snapshot, current, lengths_of

Scenes = list[tuple[SceneEntry, Arrays]]
MOST_OBJECTS = 100_000  # of a part: larger ones are not put together
TRAINING_OBJECTS = 8192  # whose descriptors a codebook is trained on
DESCRIPTORS_AT_ONCE = 8192  # that are in memory as numbers while they are encoded
OUTDATED_S = 3600.0  # age at which a file goes that no version has ever named
PATIENCE_S = 60.0  # that one writer waits for another


def replace_scene(path: Path, scene: SceneEntry, arrays: Arrays, encoder: EncoderIdentity) -> None:
    """Add a scene, or replace the one of its name; make the catalogue if there is none. The caller holds the lock."""
    before = current(path)
    if before is None:
        path.mkdir(exist_ok=True)
        _publish(path, None, Contents(encoder))
        before = current(path)
        assert before is not None
    removed = tuple(name for name in before.contents.removed if name != scene.scene)
    _change(before, scene.scene, [(scene, arrays)], removed)


def remove_scene(before: Snapshot, name: str) -> None:
    """Remove a scene. The caller holds the lock."""
    _change(before, name, [], tuple(sorted({*before.contents.removed, name})))


def _change(before: Snapshot, name: str, added: Scenes, removed: tuple[str, ...]) -> None:
    """Write a version without a scene of this name, and with others.

    Parts of no more objects than are written anyhow are put together with them, so that there are few, and so are those
    that have lost more than half of their objects.
    """
    contents, kept = before.contents, [list[int]() for _ in before.parts]
    for scene, (at, number) in before.scenes.items():
        if scene != name:
            kept[at].append(number)
    counts = [sum(part.scenes[k].num_objects for k in own) for part, own in zip(before.parts, kept, strict=True)]
    gathered, absorbed = sum(scene.num_objects for scene, _ in added), list[int]()
    for at in sorted(range(len(counts)), key=counts.__getitem__):
        is_small = counts[at] <= gathered and counts[at] + gathered <= MOST_OBJECTS
        if is_small or 2 * counts[at] < len(before.parts[at]):
            absorbed.append(at)
            gathered += counts[at]
    scenes = [(before.parts[at].scenes[k], before.parts[at].scene(k)) for at in sorted(absorbed) for k in kept[at]]
    where = before.scenes.get(name, (-1, 0))[0]
    parts = [
        replace(entry, without=(*entry.without, name)) if at == where else entry
        for at, entry in enumerate(contents.parts)
        if at not in absorbed
    ]
    if scenes or added:
        parts.append(_written(before.path, scenes + added, before.codebook))
    _publish(before.path, contents, replace(contents, parts=tuple(parts), removed=removed))


def _written(path: Path, scenes: Scenes, codebook: Codebook | None) -> PartEntry:
    """Write the files of a part."""
    arrays = {name: np.concatenate([of_scene[name] for _, of_scene in scenes]) for name in ROWS}
    entries = [{**vars(scene), "added": scene.added.isoformat()} for scene, _ in scenes]
    rows = _write(path, "rows", arrays, {"format": FORMAT, "scenes": json.dumps(entries)})
    return PartEntry(rows, None if codebook is None else _write_codes(path, arrays["descriptors"], codebook))


def _write(path: Path, kind: str, arrays: ArraysByName, about: dict[str, str]) -> FileEntry:
    name = f"{kind}-{os.urandom(8).hex()}.safetensors"
    return FileEntry(name, write_tensors(path / name, arrays, about))


def _write_codes(path: Path, descriptors: np.ndarray, codebook: Codebook) -> FileEntry:
    codes = [np.empty((0, codebook.num_subvectors), np.uint8)]
    for begin in range(0, len(descriptors), DESCRIPTORS_AT_ONCE):
        vectors = descriptors[begin : begin + DESCRIPTORS_AT_ONCE].astype(np.float32)
        codes.append(codebook.encode(vectors / lengths_of(vectors, path)[:, None]).codes)
    code = pq_code(codebook, Codes(np.concatenate(codes)))
    arrays = {"grouped_codes": code.grouped, "inverse_norms": code.inverse_norms}
    return _write(path, "codes", arrays, {"format": FORMAT, "codebook": codebook.hash})


def index(snapshot: Snapshot) -> None:
    """Code all descriptors by a new codebook. Others write meanwhile: what they have written is coded at the end."""
    path, sample = snapshot.path, snapshot.spread(TRAINING_OBJECTS).descriptors
    codebook = train_codebook(sample, PQ().parts(snapshot.encoder.dim), encoder=snapshot.encoder)
    name = f"codebook-{os.urandom(8).hex()}.safetensors"
    save_codebook(codebook, path / name)
    codes = _codes_of(snapshot, codebook, {})
    with claimed_output(path, PATIENCE_S):
        now = current(path)
        assert now is not None
        codes = _codes_of(now, codebook, codes)
        parts = tuple(replace(part, codes=codes[part.rows.name]) for part in now.contents.parts)
        file = FileEntry(name, header_checksum(map_tensors(path / name)[1]))
        _publish(path, now.contents, replace(now.contents, parts=parts, codebook=file))


def _codes_of(snapshot: Snapshot, codebook: Codebook, known: dict[str, FileEntry]) -> dict[str, FileEntry]:
    """Write the codes of the parts that have none yet; return all by the names of files of rows."""
    return {
        entry.rows.name: known.get(entry.rows.name) or _write_codes(snapshot.path, part.arrays["descriptors"], codebook)
        for entry, part in zip(snapshot.contents.parts, snapshot.parts, strict=True)
    }


def _publish(path: Path, before: Contents | None, contents: Contents) -> None:
    """Write the document of a new version; remove the files that none names any more."""
    document = {"format": FORMAT, "version": VERSION, **asdict(replace(contents, changes=contents.changes + 1))}
    write_json(path / DOCUMENT, sealed(document), overwrite=True)
    former = set() if before is None else {file.name for file in before.files}
    named = {file.name for file in contents.files}
    for file in path.glob("*.safetensors"):
        with suppress(OSError):  # where others still read it: it goes with a later change
            if file.name not in named and (file.name in former or time.time() - file.stat().st_mtime > OUTDATED_S):
                file.unlink()
