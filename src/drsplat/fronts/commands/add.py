"""drsplat add: more views for a field that is there already; and what `drsplat remove` has in common with it."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ...errors import InputError
from .declaring import Facts, argument, declaration, finite, flag, option, part, words
from .options import Photos, Verb, capture, features, invert_masks
from .query_options import FIELD_HELP

if TYPE_CHECKING:
    from ...field.growing import Change
    from ...formats.langsplat import FeatureFolder
    from ...scene.gaussians import Gaussians
    from ...scene.moving import Moving
    from ...scene.views import View


@declaration
class FieldToChange:
    """The field of a scene that registered it."""

    field: str = argument(FIELD_HELP)
    scene: str | None = option("scene that was registered (default: the one beside the field in its folder)")


def field_and_scene(given: FieldToChange) -> tuple[Path, Gaussians | Moving]:
    """Return the field's folder and its Gaussians.

    Raises: InputError: no such field, or no scene is given or beside it; as `read_scene`.
    """
    from ...formats.moving_scenes import read_scene
    from ...query.opening import registered_scene, scene_files

    files = scene_files(given.field, given.scene)
    if not files.scenes:
        raise InputError("scene: expected the Gaussians that were registered: pass scene=SCENE")
    if given.scene is not None:
        return files.field, read_scene(files.scenes[0])
    return files.field, registered_scene(files)[1]


def answer_of(change: Change, path: Path) -> Facts:
    """Return what has changed, and the new totals."""
    from ...base.system import folder_bytes, peak_memory_bytes
    from ...field.labels import LabelFile, matched

    field = change.field
    evidence = field.evidence
    assert evidence is not None
    orphans = matched(LabelFile.beside(path).read(), field).orphans if field.objects is not None else ()
    return {
        "field": str(path),
        "added": list(change.added),
        "replaced": list(change.replaced),
        "removed": list(change.removed),
        "left_out": list(change.left_out),
        "num_views_unchanged": len(change.unchanged),
        "num_views": len(evidence.masks.view_names),
        "num_masks": len(evidence.masks),
        "num_weights": int(evidence.weights.nnz),
        "num_gaussians": field.num_gaussians,
        "num_registered": len(field),
        "num_touched": change.num_touched,
        "num_coded": change.num_coded,
        "num_objects": None if field.objects is None else len(field.objects),
        "labels_of_none": [label.name for label in orphans],
        "seconds": sum(change.seconds.values()),
        "stage_seconds": dict(change.seconds),
        "field_bytes": folder_bytes(path),
        "peak_memory_bytes": peak_memory_bytes(),
    }


def show_change(answer: Facts, title: str) -> None:
    from .tables import show_facts, size_text, text_of

    stages = ", ".join(f"{name} {seconds:.1f}" for name, seconds in answer["stage_seconds"].items())
    facts = {name: _listed(answer[name]) for name in ("added", "replaced", "removed", "left_out") if answer[name]}
    if facts.keys() - {"left_out"}:
        facts["Gaussians seen by them"] = (
            f"{text_of(answer['num_touched'])}; {text_of(answer['num_coded'])} coded again"
        )
    facts |= {
        "views": answer["num_views"],
        "masks": answer["num_masks"],
        "Gaussians": f"{text_of(answer['num_registered'])} of {text_of(answer['num_gaussians'])}",
        "field": size_text(answer["field_bytes"]),
        "time": f"{answer['seconds']:.1f} s ({stages})",
    }
    if answer["num_objects"] is not None:
        facts["objects"] = f"{text_of(answer['num_objects'])}, found again" if answer["num_touched"] else "as before"
    show_facts(title, facts)
    for name in answer["labels_of_none"]:
        print(f"the label '{name}' names nothing in this field; it is kept")


def _listed(names: list[str]) -> str:
    from ...base.terminal import counted
    from ...formats.photo_files import listed

    return f"{counted(len(names), 'view')}: {listed(names)}"


EXAMPLES = """\
  drsplat add room.field capture --features capture/language_features --scene scene.ply
  drsplat add room.field new_photos --features new_photos/language_features --scene scene.ply --json
  drsplat add room.field capture --features capture/language_features --scene scene.ply --replace
  drsplat add room.field capture --features capture/language_features --scene scene.ply --watch
  drsplat add room.field capture --features capture/language_features --scene scene.ply --views IMG_0017

CAPTURE may hold all views or only the new ones. Views that have features and are not in the field yet are added,
except those that were removed or left out before: --views adds them. The settings of the registration come from the
field. To resume a stopped run, give the same command again."""
DAILY = "scene features views watch"


@declaration
class Options(Verb):
    """Options of this verb."""

    of: FieldToChange = part(FieldToChange)
    capture: str = capture()
    features: str = features()
    views: list[str] | None = option(
        "views to add, even if removed or left out before: names of photos, with or without suffix, or patterns with * "
        "and ? (default: all that were not removed or left out)", "NAME", words, nargs="+",
    )  # fmt: skip
    replace: bool = flag(
        "compare views already in the field too, and replace those whose masks, embeddings or poses have changed "
        "(default: skip them)"
    )
    watch: bool = flag(
        "wait for new views while a capture is written, and add each once its pose and features are complete, until "
        "Ctrl-C"
    )
    idle: float | None = option("with --watch: stop after this time without a new view", "SECONDS", finite)
    photos: Photos = part(Photos)
    invert_masks: bool = invert_masks()

    def posed(self) -> Sequence[View]:
        return self.photos.views(self.capture, self.invert_masks)


def run(options: Options) -> Facts:

    if options.watch and options.replace:
        raise InputError("--watch adds views and compares none: drop --replace, and give it afterwards")
    if options.watch and options.views:
        raise InputError("--watch waits for views that nobody knows yet: drop --views, or --watch")
    if options.idle is not None and not options.watch:
        raise InputError("--idle is for --watch: pass both, or none")
    path, scene = field_and_scene(options.of)
    if options.watch:
        return _watched(options, path, scene)
    views, features = options.posed(), _features(options, path)
    return answer_of(_added(options, path, scene, _views_to_add(options, views, features), features), path)


def show(answer: Facts) -> None:
    changed = answer["added"] or answer["replaced"]
    show_change(answer, f"{'added to' if changed else 'nothing to add to'} {answer['field']}")
    if not changed and answer["num_views_unchanged"]:
        others = "other " if answer["left_out"] else ""
        print(f"All {others}views with features are in it already; --replace takes over those that have become others.")
    if answer["left_out"]:
        print("Views that were removed or kept out stay out; --views NAME... brings them back.")


def _views_to_add(options: Options, views: Sequence[View], features: FeatureFolder) -> Sequence[View]:
    """Return all views, or those that --views names. Raises: InputError: it names none that has features."""
    from ...field.growing.naming import views_named
    from ...field.registration import with_features

    if not options.views:
        return views
    names = set(views_named(options.views, [view.name for view, _ in with_features(views, features)]))
    return [view for view in views if view.name in names]


def _features(options: Options, path: Path) -> FeatureFolder:
    """Return the features of the level and by the encoder that the field says."""
    from ... import load_field, read_features

    field = load_field(path)
    level = field.growth.provenance.level if field.growth else None
    return read_features(options.features, level=level or "large", encoder=field.encoder)


def _added(
    options: Options, path: Path, scene: Gaussians | Moving, views: Sequence[View], features: FeatureFolder
) -> Change:
    from ...photos.embedding.growing import grow_field

    back = [view.name for view in views] if options.views else ()
    return grow_field(
        path, scene, views, features, Path(options.features), renew=options.replace, back=back,
        threads=options.threads, track=options.track,
    )  # fmt: skip


def _watched(options: Options, path: Path, scene: Gaussians | Moving) -> Facts:
    """Add batch after batch; what is told in the end is of all together."""
    from ... import load_field
    from ...field.growing.changing import kept_out
    from ...field.growing.watching import Watch, together

    field = load_field(path)
    known = {*(field.evidence.masks.view_names if field.evidence else ()), *kept_out(field)}
    watch = Watch(lambda: (options.posed(), _features(options, path)), known, options.idle)
    done: list[Change] = []
    try:
        for views, features in watch.batches():
            change = _added(options, path, scene, views, features)
            watch.known |= {view.name for view in views}
            done.append(change)
            _print_change(options, change)
    except KeyboardInterrupt:
        _say(options, "stopped; what had come is added")
    return answer_of(together(done, path), path)


def _print_change(options: Options, change: Change) -> None:
    if not change.is_empty:
        views = len(change.field.evidence.masks.view_names) if change.field.evidence else 0
        seconds = sum(change.seconds.values())
        _say(options, f"+{len(change.added)}: {views} views, {change.num_touched:,} Gaussians seen, {seconds:.1f} s")


def _say(options: Options, line: str) -> None:
    if not options.json:
        print(line, file=sys.stderr, flush=True)
