"""drsplat add: more views for a field that is there already."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ...errors import InputError
from .changes import FieldToChange, answer_of, field_and_scene, show_change
from .declaring import Facts, declaration, flag, option, part
from .kinds import finite, words
from .options import Photos, Verb, capture, features, invert_masks

if TYPE_CHECKING:
    from ...field.growing import Change
    from ...formats.langsplat import FeatureFolder
    from ...scene.gaussians import Gaussians
    from ...scene.moving import Moving
    from ...scene.views import View

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
