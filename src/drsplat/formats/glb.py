"""Reading Gaussians from glTF: a GLB or a `.gltf` with KHR_gaussian_splatting, in its own numbers or as SPZ within.

Axes: glTF has y up, a PLY y down, and what drsplat holds is a PLY's: after the transforms of nodes everything is turned
by half about x, as of SPZ; about z what splat-transform wrote, which turns so. What drsplat wrote itself comes back in
the world that it was written from, to the bit.

Source: as of `glb_layout`; KHR_gaussian_splatting_compression_spz_2 (draft).
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..base.arrays import Arrays, Ids, Matrix4
from ..base.contents import file_bytes
from ..errors import FormatError, InputError
from ..scene.gaussians import MIN_SIZED_GAUSSIANS, Gaussians, concatenated, local_origin
from ..scene.similarity import Similarity, similarity_of
from .activation import checked
from .axes import HALF_TURN
from .glb_tables import labels_of_tables, object_names, object_numbers
from .gltf import (
    BYTE,
    COLOR_SPACE,
    FEATURE_ID,
    FEATURES,
    FLOAT,
    HARMONICS,
    KERNEL,
    LINEAR_COLOR_SPACE,
    METADATA,
    OPACITY,
    OURS,
    POINTS_MODE,
    POSITION,
    RELEVANCY,
    ROTATION,
    SCALE,
    SHORT,
    SPLATTING,
    SPZ,
    UNSIGNED_BYTE,
    UNSIGNED_SHORT,
    Entry,
    Gltf,
    gltf_in,
    inner,
    listed,
    placed_meshes,
    whole_number,
)
from .json_files import excerpt
from .labels import Labels
from .spz import parse_spz

UNDERSTOOD = (SPLATTING, SPZ, FEATURES, METADATA, "KHR_mesh_quantization", "KHR_materials_unlit")
MIN_ROW_BYTES = 3  # of its position
FREE_SPZ_ROWS = 100_000  # that any SPZ may unfold to, besides the following for each byte of the file
SPZ_ROWS_PER_BYTE = 12
_FROM_SPZ = Similarity(1.0, HALF_TURN, np.zeros(3))  # whose reader turned it into a PLY's axes


def read_glb(path: Path) -> Gaussians:
    """Read the Gaussians of a `.glb` or a `.gltf`, and files of buffers that lie right beside it.

    Raises: InputError: nothing at `path`. FormatError: as `parse_glb`.
    """
    return _gaussians(gltf_in(file_bytes(path).data, path.parent))


def names_in_glb(path: Path) -> list[tuple[int, str]]:
    """Return number and name of each object of a `.glb` or a `.gltf`, [] where it has none.

    Raises: InputError: nothing at `path`. FormatError: it is damaged.
    """
    return object_names(gltf_in(file_bytes(path).data, path.parent))


def labels_in_glb(path: Path) -> Labels:
    """Return the objects and groups that drsplat wrote into a `.glb` or a `.gltf`, with their boxes.

    Raises: InputError: nothing at `path`. FormatError: it is damaged.
    """
    return labels_of_tables(gltf_in(file_bytes(path).data, path.parent))


def parse_glb(buffer: memoryview) -> Gaussians:
    """Return the Gaussians of a GLB, or of a `.gltf` whose buffers are in it, in the axes of a PLY.

    Numbers of objects come back as the column `object_id` of `Gaussians.extra`, the answer to a query as `relevancy`.

    Raises: FormatError: no splats in it, damaged, truncated, an extension that is required and not known, colours of
    linear light, transforms that shear, or rows that are no Gaussians.
    """
    return _gaussians(gltf_in(buffer))


@np.errstate(all="ignore")  # what damaged floats do on the way is judged at its end
def _gaussians(gltf: Gltf) -> Gaussians:
    unknown = [name for name in gltf.entries("extensionsRequired") if name not in UNDERSTOOD]
    if unknown:
        raise FormatError(f"glTF needs the extension {excerpt(unknown[0])}, which is not read: export it without")
    parts: list[Gaussians] = []
    size = gltf.num_bytes
    # the same bytes may be named many times over, and an SPZ unfolds
    plain, unfolded = 0, 0
    used: set[int] = set()
    for mesh, to_world in placed_meshes(gltf):
        for primitive in listed(gltf.entry("meshes", mesh), "primitives", "a mesh"):
            if SPLATTING not in inner(primitive, "extensions"):
                continue
            extension, attributes = inner(primitive, "extensions", SPLATTING), inner(primitive, "attributes")
            _check_meaning(primitive, extension)
            if compressed := inner(extension, "extensions", SPZ):
                view = whole_number(compressed.get("bufferView"), f"{SPZ}: bufferView")
                if view in used:
                    raise FormatError(f"glTF: bufferViews[{view}] is the SPZ of two primitives: expected one of each")
                used.add(view)
                gaussians = _FROM_SPZ.moved(parse_spz(gltf.view(view)))
                unfolded += len(gaussians)
                if unfolded > FREE_SPZ_ROWS + SPZ_ROWS_PER_BYTE * size:
                    raise FormatError(f"glTF: {unfolded:,} Gaussians of {size:,} bytes of SPZ: damaged")
            else:
                plain += _count(gltf, attributes)
                if plain * MIN_ROW_BYTES > size:
                    raise FormatError(f"glTF: {plain:,} Gaussians do not fit into {size:,} bytes: damaged")
                gaussians = _of_attributes(gltf, attributes)
            extra = _columns(gltf, primitive, attributes, len(gaussians))
            parts.append(_placed(replace(gaussians, extra=extra), to_world))
    if not parts:
        raise FormatError(f"glTF has no primitive with {SPLATTING}: it is a mesh or points, and no Gaussians")
    marked = any(inner(node, "extras", OURS).get("antialiased") is True for node in gltf.entries("nodes"))
    parts = [replace(part, antialiased=part.antialiased or marked) for part in parts]
    try:
        return parts[0] if len(parts) == 1 else concatenated(parts)
    except InputError as error:
        raise FormatError(str(error)) from None


def _check_meaning(primitive: Entry, extension: Entry) -> None:
    mode, kernel, space = primitive.get("mode"), extension.get("kernel", KERNEL), extension.get("colorSpace")
    if mode != POINTS_MODE:
        raise FormatError(f"glTF: a primitive of splats has the mode {excerpt(mode)}: expected {POINTS_MODE}, points")
    if kernel != KERNEL:
        raise FormatError(f"glTF: splats of the kernel {excerpt(kernel)}; '{KERNEL}' can be read")
    if space == LINEAR_COLOR_SPACE:
        raise FormatError(
            f"glTF: splats whose colours are of linear light ({LINEAR_COLOR_SPACE}) blend otherwise than those of "
            f"photos, and no colours of ours look like them: train or export it in {COLOR_SPACE}"
        )
    if space not in (COLOR_SPACE, None):
        raise FormatError(f"glTF: colours of {excerpt(space)}; {COLOR_SPACE} can be read")


def _count(gltf: Gltf, attributes: Entry) -> int:
    missing = [name for name in (POSITION, ROTATION, SCALE, OPACITY, HARMONICS[0]) if name not in attributes]
    if missing:
        raise FormatError(f"glTF: splats without {', '.join(missing)}: export it again with a newer program")
    return whole_number(gltf.entry("accessors", attributes[POSITION]).get("count"), "count")


def _of_attributes(gltf: Gltf, attributes: Entry) -> Gaussians:
    means = gltf.values(attributes[POSITION], "VEC3", POSITION)
    quats = gltf.values(attributes[ROTATION], "VEC4", ROTATION, (FLOAT, BYTE, SHORT))[:, [3, 0, 1, 2]]
    scales = gltf.values(attributes[SCALE], "VEC3", SCALE, (FLOAT, UNSIGNED_BYTE, UNSIGNED_SHORT, BYTE, SHORT))
    opacities = gltf.values(attributes[OPACITY], "SCALAR", OPACITY, (FLOAT, UNSIGNED_BYTE, UNSIGNED_SHORT))[:, 0]
    count = sum(name in attributes for name in HARMONICS)
    if count not in (1, 4, 9, 16) or not all(name in attributes for name in HARMONICS[:count]):
        raise FormatError(f"glTF: {count} coefficients of harmonics: expected 1, 4, 9 or 16, the lowest degrees first")
    sh, lengths = np.empty((len(means), count, 3), np.float32), {len(quats), len(scales), len(opacities)}
    for number, name in enumerate(HARMONICS[:count]):
        values = gltf.values(attributes[name], "VEC3", name, (FLOAT,))
        lengths.add(len(values))
        if len(values) == len(sh):
            sh[:, number] = values
    if lengths != {len(sh)}:
        raise FormatError(f"glTF: attributes of one primitive with {sorted({len(sh), *lengths})} rows: damaged")
    # sound Gaussians; unit rotations stay as they are. Raises: FormatError: rows that are none.
    negative = int((scales < 0).any(1).sum())
    if negative:
        raise FormatError(
            f"glTF: {negative:,} of {len(scales):,} rows have negative scales, and scales are lengths: some programs "
            "wrote logarithms before the format was final (2026), such as splat-transform: export it with a newer one"
        )
    stored = quats.copy()
    gaussians = checked(means, quats, scales, opacities, sh)
    return replace(gaussians, quats=stored) if np.abs(stored - gaussians.quats).max(initial=0) < 1e-6 else gaussians


def _columns(gltf: Gltf, primitive: Entry, attributes: Entry, count: int) -> Arrays:
    columns: Arrays = {}
    if FEATURE_ID in attributes:
        columns["object_id"] = _object_ids(gltf, primitive, attributes)
    if RELEVANCY in attributes:
        columns["relevancy"] = gltf.values(attributes[RELEVANCY], "SCALAR", RELEVANCY, (FLOAT,))[:, 0]
    for name, column in columns.items():
        if len(column) != count:
            raise FormatError(f"glTF: {len(column):,} numbers of '{name}' for {count:,} Gaussians: damaged")
        if not np.isfinite(column).all():
            raise FormatError(f"glTF: '{name}' has numbers that are not finite")
    return columns


def _object_ids(gltf: Gltf, primitive: Entry, attributes: Entry) -> Ids:
    """Return the number of each Gaussian's object, -1 for none: its feature, or what the table says of it."""
    stored = gltf.accessor(
        attributes[FEATURE_ID], "SCALAR", FEATURE_ID, (UNSIGNED_BYTE, UNSIGNED_SHORT, FLOAT, BYTE, SHORT)
    )[:, 0]
    sets = [one for one in listed(inner(primitive, "extensions", FEATURES), "featureIds", FEATURES)]
    none = next((inner(one).get("nullFeatureId") for one in sets if inner(one).get("attribute") == 0), None)
    if not (np.abs(stored) < 2**24).all():  # not so of NaN either
        raise FormatError(f"glTF: {FEATURE_ID}: expected numbers of features")
    ids = stored.astype(np.int32)
    ids[(ids < 0) | (ids == (none if isinstance(none, int) else -1))] = -1
    numbers = object_numbers(gltf)
    if numbers is None:
        return ids
    if ids.max(initial=-1) >= len(numbers):
        raise FormatError(f"glTF: {FEATURE_ID} {ids.max():,} of a table of {len(numbers):,} rows: damaged")
    return np.append(numbers, np.int32(-1))[ids]  # the last one is that of -1


def _placed(gaussians: Gaussians, to_world: Matrix4) -> Gaussians:
    """Return Gaussians where a matrix puts them; those that it only moves keep their bits."""
    try:
        similarity = similarity_of(to_world)
    except InputError as error:
        raise FormatError(f"glTF: the node of the splats: {error}: apply the transform before exporting") from None
    if np.array_equal(similarity.rotation, np.eye(3)) and similarity.scale == 1:
        counted = replace(gaussians, origin=gaussians.origin + similarity.translation)
        if (
            len(counted) < MIN_SIZED_GAUSSIANS
            or not similarity.translation.any()
            or local_origin(counted.positions).any()
        ):
            return counted
    moved = similarity.moved(gaussians)
    checked(moved.means, moved.quats.copy(), moved.scales, moved.opacities, moved.sh)  # or the error that names a row
    return moved
