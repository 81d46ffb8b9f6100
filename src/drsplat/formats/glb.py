"""Reading Gaussians from glTF: a GLB or a `.gltf` with KHR_gaussian_splatting, in its own numbers or as SPZ within.

Axes: glTF has y up, a PLY y down, and what drsplat holds is a PLY's: after the transforms of nodes everything is turned
by half about x, as of SPZ; about z what splat-transform wrote, which turns so. What drsplat wrote itself comes back in
the world that it was written from, to the bit.

Source: as of `glb_layout`; KHR_gaussian_splatting_compression_spz_2 (draft).
"""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ..base.arrays import Arrays, Ids, Matrix4
from ..base.contents import file_bytes
from ..errors import FormatError, InputError
from ..scene.gaussians import MIN_SIZED_GAUSSIANS, Gaussians, concatenated, local_origin
from ..scene.similarity import similarity_of
from .activation import checked
from .axes import HALF_TURN
from .glb_tables import ObjectName, labels_of_tables, object_names, object_numbers
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


def read_glb(path: Path) -> Gaussians:
    """Read the Gaussians of a `.glb` or a `.gltf`, and files of buffers that lie right beside it.

    Raises: InputError: nothing at `path`. FormatError: as `parse_glb`.
    """
    return _gaussians(gltf_in(file_bytes(path).data, path.parent))


def names_in_glb(path: Path) -> list[ObjectName]:
    """Return the objects of a `.glb` or a `.gltf` with their names, [] where it has none.

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
    budget = _Budget(gltf.num_bytes)
    parts = [
        _placed(_of_primitive(gltf, primitive, budget), to_world)
        for mesh, to_world in placed_meshes(gltf)
        for primitive in listed(gltf.entry("meshes", mesh), "primitives", "a mesh")
        if SPLATTING in inner(primitive, "extensions")
    ]
    if not parts:
        raise FormatError(f"glTF has no primitive with {SPLATTING}: it is a mesh or points, and no Gaussians")
    try:
        return parts[0] if len(parts) == 1 else concatenated(parts)
    except InputError as error:
        raise FormatError(str(error)) from None


@dataclass
class _Budget:
    """How many rows a file may unfold to: the same bytes may be named many times over. size: bytes of all buffers."""

    size: int
    plain: int = 0
    unfolded: int = 0
    used: set[int] = field(default_factory=set)

    def add_plain(self, rows: int) -> None:
        """Count rows of plain numbers. Raises: FormatError: more than the bytes can hold."""
        self.plain += rows
        if self.plain * MIN_ROW_BYTES > self.size:
            raise FormatError(f"glTF: {self.plain:,} Gaussians do not fit into {self.size:,} bytes: damaged")

    def use(self, view: int) -> None:
        """Take note of an SPZ. Raises: FormatError: it is named twice."""
        if view in self.used:
            raise FormatError(f"glTF: bufferViews[{view}] is the SPZ of two primitives: expected one of each")
        self.used.add(view)

    def add_unfolded(self, rows: int) -> None:
        """Count rows of an SPZ. Raises: FormatError: more than are plausible of the bytes."""
        self.unfolded += rows
        if self.unfolded > FREE_SPZ_ROWS + SPZ_ROWS_PER_BYTE * self.size:
            raise FormatError(f"glTF: {self.unfolded:,} Gaussians of {self.size:,} bytes of SPZ: damaged")


def _of_primitive(gltf: Gltf, primitive: Entry, budget: _Budget) -> Gaussians:
    """Return the Gaussians of a primitive in its own axes."""
    extension = inner(primitive, "extensions", SPLATTING)
    _check_meaning(primitive, extension)
    attributes = inner(primitive, "attributes")
    compressed = inner(extension, "extensions", SPZ)
    gaussians = _of_spz(gltf, compressed, budget) if compressed else _of_attributes(gltf, attributes, budget)
    extra = _columns(gltf, primitive, attributes, len(gaussians))
    return replace(gaussians, extra=extra, antialiased=gaussians.antialiased or _is_antialiased(gltf))


def _is_antialiased(gltf: Gltf) -> bool:
    return any(inner(node, "extras", OURS).get("antialiased") is True for node in gltf.entries("nodes"))


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


def _of_spz(gltf: Gltf, compressed: Entry, budget: _Budget) -> Gaussians:
    view = whole_number(compressed.get("bufferView"), f"{SPZ}: bufferView")
    budget.use(view)
    gaussians = parse_spz(gltf.view(view))
    budget.add_unfolded(len(gaussians))
    matrix = np.eye(4)
    matrix[:3, :3] = HALF_TURN
    return similarity_of(matrix).moved(gaussians)  # the reader of SPZ turned it into a PLY's axes


def _of_attributes(gltf: Gltf, attributes: Entry, budget: _Budget) -> Gaussians:
    missing = [name for name in (POSITION, ROTATION, SCALE, OPACITY, HARMONICS[0]) if name not in attributes]
    if missing:
        raise FormatError(f"glTF: splats without {', '.join(missing)}: export it again with a newer program")
    budget.add_plain(whole_number(gltf.entry("accessors", attributes[POSITION]).get("count"), "count"))
    floats = (FLOAT,)
    means = gltf.values(attributes[POSITION], "VEC3", POSITION)
    quats = gltf.values(attributes[ROTATION], "VEC4", ROTATION, (FLOAT, BYTE, SHORT))[:, [3, 0, 1, 2]]
    scales = gltf.values(attributes[SCALE], "VEC3", SCALE, (FLOAT, UNSIGNED_BYTE, UNSIGNED_SHORT, BYTE, SHORT))
    opacities = gltf.values(attributes[OPACITY], "SCALAR", OPACITY, (FLOAT, UNSIGNED_BYTE, UNSIGNED_SHORT))[:, 0]
    lengths = {len(column) for column in (means, quats, scales, opacities)}
    # The names of the harmonics that are there
    there = [name in attributes for name in HARMONICS]
    count = sum(there)
    if count not in (1, 4, 9, 16) or not all(there[:count]):
        raise FormatError(f"glTF: {count} coefficients of harmonics: expected 1, 4, 9 or 16, the lowest degrees first")
    coefficients = HARMONICS[:count]
    sh = np.empty((len(means), len(coefficients), 3), np.float32)
    for number, name in enumerate(coefficients):
        values = gltf.values(attributes[name], "VEC3", name, floats)
        lengths.add(len(values))
        if len(values) == len(sh):
            sh[:, number] = values
    if len(lengths) > 1:
        raise FormatError(f"glTF: attributes of one primitive with {sorted(lengths)} rows: damaged")
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
