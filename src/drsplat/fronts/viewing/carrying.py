"""Content for files of other programs: the shown scene as edited, with objects, answers and annotations."""

from dataclasses import replace

import numpy as np

from ...authoring.editing.draft import OBJECT_ID
from ...authoring.exporting.placing import After, Placing, groups_of, match_thing, only_used, rows_of, things_of
from ...authoring.filming.looking import up_direction
from ...base.arrays import Bool
from ...scene.gaussians import Gaussians
from ...scene.labelled import LabelledScene
from . import results
from .session import Session


def carried(session: Session, *, selected_only: bool = False) -> LabelledScene:
    """Return what is not hidden with all that is known of it; the answers are those that are shown, together.

    Raises: InputError: nothing is selected where `selected_only`, or nothing is left.
    """
    scene = session.scene
    gaussians, ids = session.edited(selected_only=selected_only)
    placing = Placing(scene.gaussians, _after(session), scene.up)
    things = placing.objects(things_of(scene))
    owners = gaussians.extra.get(OBJECT_ID) if things else None
    found = [(result, match) for result in session.results for match in result.matches]
    matches = [match_thing(scene, number, match) for number, (_, match) in enumerate(found)]
    up = up_direction(scene)
    whole = LabelledScene(
        _without_objects(gaussians),
        scene.name,
        tuple(things),
        groups_of(scene),
        None if owners is None else rows_of(things, owners),
        "; ".join(result.label for result in session.results),
        _relevancy(session, ids) if session.results else None,
        placing.matches([match for _, match in found], matches),
        session.edits.annotations,
        (float(up[0]), float(up[1]), float(up[2])),
        num_edits=session.edits.listed.done,
    )
    return only_used(whole) if selected_only else whole


def _after(session: Session) -> After:
    """Return all rows of the edits on show, those that they added behind the scene's own."""
    everything, rows = session.edits.part(np.arange(len(session.edits.opacities)))
    present: Bool[np.ndarray, " d"] = np.zeros(len(rows), bool)
    present[session.edited()[1]] = True
    owners = everything.extra.get(OBJECT_ID)
    known = len(session.scene.field.objects or ())
    added = [] if owners is None else np.unique(owners[owners >= known]).tolist()
    return After(everything, present, dict.fromkeys(added, -1))


def _relevancy(session: Session, ids: np.ndarray) -> np.ndarray:
    """Return the highest relevancy of the answers on show; 0 of what edits added."""
    values = np.zeros(len(ids), np.float32)
    own = ids < len(session.scene.gaussians)
    values[own] = results.relevancy(session.results, len(session.scene.gaussians))[ids[own]]
    return values


def _without_objects(gaussians: Gaussians) -> Gaussians:
    return replace(gaussians, extra={name: own for name, own in gaussians.extra.items() if name != OBJECT_ID})
