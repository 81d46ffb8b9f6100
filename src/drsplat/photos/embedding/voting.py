"""Objects of a field with the votes of its photos, which are looked at again: what most outline as one is one."""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array

from ...errors import FormatError, InputError
from ...field import LanguageField
from ...field.codes import Track, untracked
from ...field.evidence.aggregation import Sampling
from ...field.evidence.columns import ColumnMaker, Columns, is_finished, part_name, scenery_of
from ...field.forest import Objects
from ...field.objects.describing import describe
from ...field.objects.finding import cameras_of, find_tree
from ...field.objects.voting import Vote, with_voted
from ...formats.tensors import hash_file, read_tensors, write_tensors
from ...scene.gaussians import Gaussians
from ...scene.masks.features import ViewFeatures
from ...scene.masks.region_tree import RegionTree
from ...scene.photos import load_image
from ...scene.views import View
from ..models.outlines import identity, region_tree


def vote_for_objects(
    field: LanguageField,
    gaussians: Gaussians,
    views: Sequence[View],
    *,
    parts: str | Path,
    threads: int = 0,
    track: Track = untracked,
) -> Objects:
    """Find the objects of a field as `find_objects` does, and join the pieces that its photos outline as one thing.

    Masks may be anyone's; docs/measured/objects.md says what it gains.

    Args:
        field: with evidence.
        gaussians: its scene, which stands still.
        views: its photos; those without a view here do not vote.
        parts: folder for each photo's regions and their weights, which later runs go on from.
        threads: 0 for all cores; the same bits at any number.
        track: shows the progress.

    Raises: InputError: no evidence, a moving scene, or none of the field's photos is there. MismatchError: another
    scene. FormatError: a damaged photo.
    """
    field.check_scene(gaussians)
    if field.evidence is None or field.times is not None:
        raise InputError("photos vote for objects of a scene that stands still, in a field that keeps its evidence")
    by_name = {view.name: view for view in views if view.image_path is not None}
    names = [name for name in field.evidence.masks.view_names if name in by_name]
    if not names:
        example = field.evidence.masks.view_names[0]
        raise InputError(f"none of {len(by_name)} photos is of this field, whose photos are named like '{example}'")
    electorate = _Electorate(field, gaussians, [by_name[name] for name in names], Path(parts), threads)
    electorate.look(track)
    found = find_tree(field.evidence, gaussians, field.gaussian_ids, cameras_of(field), threads=threads)
    return describe(field, gaussians, with_voted(found, electorate.votes), threads=threads)


class _Electorate:
    """Photos with their regions, one at a time: each is kept in a folder once it is looked at."""

    def __init__(
        self, field: LanguageField, gaussians: Gaussians, views: Sequence[View], folder: Path, threads: int
    ) -> None:
        self.field, self.views, self.folder, self.threads = field, views, folder, threads
        sampling = field.aggregator.sampling or Sampling()
        self.maker = ColumnMaker(scenery_of(gaussians, sampling.near), folder, sampling, threads)
        folder.mkdir(parents=True, exist_ok=True)

    def look(self, track: Track) -> None:
        """Look at all photos that are not in the folder yet."""
        for view in track(self.views, "regions of photos"):
            self._columns(view, self._tree(view))

    def votes(self) -> Iterator[Vote]:
        for view in self.views:
            tree = self._tree(view)
            triples = self._columns(view, tree).triples()
            rows = self.field.rows_of(triples.gaussian_ids)
            known = rows >= 0
            places = rows[known], triples.mask_ids[known].astype(np.int32)
            shape = len(self.field), len(tree)
            yield Vote(view.name, tree, csr_array((triples.weights[known], places), shape=shape))

    def _columns(self, view: View, tree: RegionTree) -> Columns:
        height, width = tree.labels.shape
        features = ViewFeatures(tree.labels, np.ones((len(tree), 1), np.float32))
        return self.maker.columns(view.resized(width, height), features)

    def _tree(self, view: View) -> RegionTree:
        if view.image_path is None:
            raise InputError(f"view '{view.name}' has no photo")
        key = hashlib.blake2b(f"{identity()} {hash_file(view.image_path)}".encode(), digest_size=16).hexdigest()
        path = self.folder / part_name(view.name).replace(".columns.", ".regions.")
        if not is_finished(path, {"key": key}):
            tree = region_tree(load_image(replace(view, distortion=None)), threads=self.threads)
            write_tensors(path, vars(tree), {"key": key}, overwrite=True)
        try:
            return RegionTree(**read_tensors(path)[0])
        except TypeError:
            raise FormatError(f"{path}: not the regions of a photo: remove the file") from None
