"""drsplat add: more views for a field that is there already; and what `drsplat remove` has in common with it."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from ...base.system import folder_bytes, peak_memory_bytes
from ...base.terminal import counted
from ...errors import InputError
from .declaring import Facts, argument, declaration, finite, flag, option, part, words
from .options import Photos, Verb, capture, features, invert_masks
from .query_options import FIELD_HELP
from .tables import show_facts, size_text, text_of

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

    def read(self) -> tuple[Path, Gaussians | Moving]:
        """Return the field's folder and its Gaussians.

        Raises: InputError: no such field, or no scene is given or beside it; as `read_scene`.
        """
        from ...formats.moving_scenes import read_scene
        from ...query.opening import registered_scene, scene_files

        files = scene_files(self.field, self.scene)
        if not files.scenes:
            raise InputError("scene: expected the Gaussians that were registered: pass scene=SCENE")
        return files.field, registered_scene(files)[1] if self.scene is None else read_scene(files.scenes[0])


def answer_of(change: Change, path: Path) -> Facts:
    """Return what has changed, and the new totals."""
    from ...field.labels import LabelFile, matched

    field = change.field
    evidence = field.evidence
    assert evidence is not None
    orphans = matched(LabelFile.beside(path).read(), field).orphans if field.objects is not None else ()
    return {
        "field": path,
        "added": change.added,
        "replaced": change.replaced,
        "removed": change.removed,
        "left_out": change.left_out,
        "num_views_unchanged": len(change.unchanged),
        "num_views": len(evidence.masks.view_names),
        "num_masks": len(evidence.masks),
        "num_weights": evidence.weights.nnz,
        "num_gaussians": field.num_gaussians,
        "num_registered": len(field),
        "num_touched": change.num_touched,
        "num_coded": change.num_coded,
        "num_objects": None if field.objects is None else len(field.objects),
        "labels_of_none": [label.name for label in orphans],
        "seconds": sum(change.seconds.values()),
        "stage_seconds": change.seconds,
        "field_bytes": folder_bytes(path),
        "peak_memory_bytes": peak_memory_bytes(),
    }


def show_change(answer: Facts, title: str) -> None:
    from ...formats.photo_files import listed

    stages = ", ".join(f"{name} {seconds:.1f}" for name, seconds in answer["stage_seconds"].items())
    changes = {name: answer[name] for name in ("added", "replaced", "removed", "left_out") if answer[name]}
    facts: Facts = {name: f"{counted(len(names), 'view')}: {listed(names)}" for name, names in changes.items()}
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

    def inputs(self, field: Path) -> tuple[Sequence[View], FeatureFolder]:
        """Return the views, and their features of the level and by the encoder that the field says."""
        from ... import load_field, read_features

        known = load_field(field)
        level = known.growth.provenance.level if known.growth else None
        views = self.photos.views(self.capture, self.invert_masks)
        return views, read_features(self.features, level=level or "large", encoder=known.encoder)


def run(options: Options) -> Facts:
    from ...field.growing.naming import views_named
    from ...field.registration import with_features

    if options.watch and options.replace:
        raise InputError("--watch adds views and compares none: drop --replace, and give it afterwards")
    if options.watch and options.views:
        raise InputError("--watch waits for views that nobody knows yet: drop --views, or --watch")
    if options.idle is not None and not options.watch:
        raise InputError("--idle is for --watch: pass both, or none")
    path, scene = options.of.read()
    if options.watch:
        return _watched(options, path, scene)
    views, features = options.inputs(path)
    if options.views:
        names = set(views_named(options.views, [view.name for view, _ in with_features(views, features)]))
        views = [view for view in views if view.name in names]
    return answer_of(_added(options, path, scene, views, features), path)


def show(answer: Facts) -> None:
    changed = answer["added"] or answer["replaced"]
    show_change(answer, f"{'added to' if changed else 'nothing to add to'} {answer['field']}")
    if not changed and answer["num_views_unchanged"]:
        others = "other " if answer["left_out"] else ""
        print(f"All {others}views with features are in it already; --replace takes over those that have become others.")
    if answer["left_out"]:
        print("Views that were removed or kept out stay out; --views NAME... brings them back.")


def _added(
    options: Options, path: Path, scene: Gaussians | Moving, views: Sequence[View], features: FeatureFolder
) -> Change:
    from ...photos.embedding.growing import grow_field

    back = [view.name for view in views] if options.views else ()
    return grow_field(
        path, scene, views, features, Path(options.features), renew=options.replace, back=back,
        **options.running,
    )  # fmt: skip


def _watched(options: Options, path: Path, scene: Gaussians | Moving) -> Facts:
    """Add batch after batch; what is told in the end is of all together."""
    from ... import load_field
    from ...field.growing.changing import kept_out
    from ...field.growing.watching import Watch, together

    def say(line: str) -> None:
        if not options.json:
            print(line, file=sys.stderr, flush=True)

    field = load_field(path)
    known = {*(field.evidence.masks.view_names if field.evidence else ()), *kept_out(field)}
    watch = Watch(partial(options.inputs, path), known, options.idle)
    done: list[Change] = []
    try:
        for views, features in watch.batches():
            change = _added(options, path, scene, views, features)
            watch.known |= {view.name for view in views}
            done.append(change)
            if not change.is_empty:
                number = len(change.field.evidence.masks.view_names) if change.field.evidence else 0
                seconds = sum(change.seconds.values())
                say(f"+{len(change.added)}: {number} views, {change.num_touched:,} Gaussians seen, {seconds:.1f} s")
    except KeyboardInterrupt:
        say("stopped; what had come is added")
    return answer_of(together(done, path), path)
