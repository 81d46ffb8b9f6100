"""Objects of a field with the votes of its photos, which are looked at again: what most outline as one is one.

What is kept of each photo, its regions and their weights, depends on no other photo. So photos come and go, and the
objects are those of all at once.
"""

import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array

from ...errors import InputError, warn
from ...field import LanguageField
from ...field.codes import Track, untracked
from ...field.evidence.aggregation import Sampling
from ...field.evidence.columns import ColumnMaker, Columns, is_finished, part_name, scenery_of
from ...field.forest import VOTED, Objects
from ...field.objects.describing import describe
from ...field.objects.finding import cameras_of, find_tree
from ...field.objects.voting import Vote, with_voted
from ...formats.photo_files import listed
from ...formats.tensors import hash_file, read_tensors, write_tensors
from ...scene.gaussians import Gaussians
from ...scene.masks.features import ViewFeatures
from ...scene.masks.region_tree import RegionTree
from ...scene.photos import load_image
from ...scene.views import View
from ..models.outlines import identity, region_tree


def votes_beside(path: str | os.PathLike[str]) -> Path:
    """Return the folder of what is kept of the photos that voted for the objects of a field."""
    return Path(f"{os.path.realpath(path)}.votes")


def vote_for_objects(
    field: LanguageField,
    gaussians: Gaussians,
    views: Sequence[View],
    *,
    kept: str | Path,
    threads: int = 0,
    track: Track = untracked,
) -> Objects:
    """Find the objects of a field as `find_objects` does, and join the pieces that its photos outline as one thing.

    Masks may be anyone's; docs/measured/objects.md says what it gains.

    Args:
        field: with evidence.
        gaussians: its scene, which stands still.
        views: its photos; those without a view here vote where they are kept.
        kept: folder for each photo's regions and their weights, which later runs go on from.
        threads: 0 for all cores; the same bits at any number.
        track: shows the progress.

    Warns: DrSplatWarning: photos of the field that do not vote.
    Raises: InputError: no evidence, a moving scene, or none of the field's photos is there. MismatchError: another
    scene. FormatError: a damaged photo.
    """
    field.check_scene(gaussians)
    if field.evidence is None or field.times is not None:
        raise InputError("photos vote for objects of a scene that stands still, in a field that keeps its evidence")
    photos = {view.name: view for view in views if view.image_path is not None}
    electorate = _Electorate(field, gaussians, Path(kept), threads)
    electorate.look([photos[name] for name in field.evidence.masks.view_names if name in photos], track)
    silent = sorted({*field.evidence.masks.view_names} - {*electorate.names})
    if not electorate.names:
        raise InputError(
            f"none of {len(photos)} photos is of this field, whose photos are named like '{silent[0]}': give its photos"
            ", or find its objects again without votes"
        )
    if silent:
        warn(f"{len(silent)} photos of the field do not vote, as they are neither given nor kept: {listed(silent)}", 1)
    found = find_tree(field.evidence, gaussians, field.gaussian_ids, cameras_of(field), threads=threads)
    voted = with_voted(found, electorate.votes)
    return replace(describe(field, gaussians, voted, threads=threads), votes=VOTED)


class _Electorate:
    """Photos of a field with their regions, one at a time: each is kept in a folder once it is looked at."""

    def __init__(self, field: LanguageField, gaussians: Gaussians, folder: Path, threads: int) -> None:
        self.field, self.folder, self.threads = field, folder, threads
        sampling = field.aggregator.sampling or Sampling()
        self.maker = ColumnMaker(scenery_of(gaussians, sampling.near), folder, sampling, threads)

    @cached_property
    def names(self) -> list[str]:
        """Photos of the field that are kept whole, in its order."""
        assert self.field.evidence is not None
        kept = []
        for name in self.field.evidence.masks.view_names:
            regions, columns = self._paths(name)
            if is_finished(regions, self._marks) and is_finished(columns, {"view": name}):
                kept.append(name)
        return kept

    def look(self, views: Sequence[View], track: Track) -> None:
        """Look at the photos that are not kept, or are others now; before `names` are asked for."""
        self.folder.mkdir(parents=True, exist_ok=True)
        for view in track(views, "regions of photos"):
            assert view.image_path is not None
            path, columns = self._paths(view.name)
            marks = self._marks | {"photo": hash_file(view.image_path)}
            if not is_finished(path, marks):
                columns.unlink(missing_ok=True)  # those of other regions
                tree = region_tree(load_image(replace(view, distortion=None)), both=True, threads=self.threads)
                write_tensors(path, vars(tree), marks, overwrite=True)
            tree = RegionTree(**read_tensors(path)[0])
            height, width = tree.labels.shape
            features = ViewFeatures(tree.labels, np.ones((len(tree), 1), np.float32))
            self.maker.columns(view.resized(width, height), features)

    def votes(self) -> Iterator[Vote]:
        for name in self.names:
            regions, columns = self._paths(name)
            tree = RegionTree(**read_tensors(regions)[0])
            triples = Columns(name, columns, np.empty((0, 1), np.float32), b"").triples()
            rows = self.field.rows_of(triples.gaussian_ids)
            known = rows >= 0
            places = rows[known], triples.mask_ids[known].astype(np.int32)
            shape = len(self.field), len(tree)
            yield Vote(name, tree, csr_array((triples.weights[known], places), shape=shape))

    @property
    def _marks(self) -> dict[str, str]:
        return {"outlines": identity(), "scene": self.field.scene}

    def _paths(self, name: str) -> tuple[Path, Path]:
        columns = self.folder / part_name(name)
        return columns.with_name(columns.name.replace(".columns.", ".regions.")), columns
