"""drsplat add: more views for a field that is there already."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .changes import add_field_options, answer_of, field_and_scene, show_change
from .options import add_capture_options, add_features, add_invert_masks, finite, tracker, views_of, words

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
DAILY = ("scene", "features", "views", "watch")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_field_options(parser)
    add_features(parser)
    parser.add_argument(
        "--views", nargs="+", type=words, metavar="NAME",
        help="views to add, even if removed or left out before: names of photos, with or without suffix, or patterns "
        "with * and ? (default: all that were not removed or left out)",
    )  # fmt: skip
    parser.add_argument(
        "--replace", action="store_true",
        help="compare views already in the field too, and replace those whose masks, embeddings or poses have changed "
        "(default: skip them)",
    )  # fmt: skip
    parser.add_argument(
        "--watch", action="store_true",
        help="wait for new views while a capture is written, and add each once its pose and features are complete, "
        "until Ctrl-C",
    )  # fmt: skip
    parser.add_argument(
        "--idle", type=finite, metavar="SECONDS", help="with --watch: stop after this time without a new view"
    )
    add_capture_options(parser)
    add_invert_masks(parser)


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from ...errors import InputError

    if arguments.watch and arguments.replace:
        raise InputError("--watch adds views and compares none: drop --replace, and give it afterwards")
    if arguments.watch and arguments.views:
        raise InputError("--watch waits for views that nobody knows yet: drop --views, or --watch")
    if arguments.idle is not None and not arguments.watch:
        raise InputError("--idle is for --watch: pass both, or none")
    path, scene = field_and_scene(arguments)
    if arguments.watch:
        return _watched(arguments, path, scene)
    views, features = views_of(arguments, arguments.capture), _features(arguments, path)
    return answer_of(_added(arguments, path, scene, _views_to_add(arguments, views, features), features), path)


def show(answer: dict[str, Any]) -> None:
    changed = answer["added"] or answer["replaced"]
    show_change(answer, f"{'added to' if changed else 'nothing to add to'} {answer['field']}")
    if not changed and answer["num_views_unchanged"]:
        others = "other " if answer["left_out"] else ""
        print(f"All {others}views with features are in it already; --replace takes over those that have become others.")
    if answer["left_out"]:
        print("Views that were removed or kept out stay out; --views NAME... brings them back.")


def _views_to_add(arguments: argparse.Namespace, views: Sequence[View], features: FeatureFolder) -> Sequence[View]:
    """Return all views, or those that --views names. Raises: InputError: it names none that has features."""
    from ...field.growing.naming import views_named
    from ...field.registration import with_features

    if not arguments.views:
        return views
    names = set(views_named(arguments.views, [view.name for view, _ in with_features(views, features)]))
    return [view for view in views if view.name in names]


def _features(arguments: argparse.Namespace, path: Path) -> FeatureFolder:
    """Return the features of the level and by the encoder that the field says."""
    from ... import load_field, read_features

    field = load_field(path)
    level = field.growth.provenance.level if field.growth else None
    return read_features(arguments.features, level=level or "large", encoder=field.encoder)


def _added(
    arguments: argparse.Namespace, path: Path, scene: Gaussians | Moving, views: Sequence[View], features: FeatureFolder
) -> Change:
    from ...photos.embedding.growing import grow_field

    back = [view.name for view in views] if arguments.views else ()
    return grow_field(
        path, scene, views, features, Path(arguments.features), renew=arguments.replace, back=back,
        threads=arguments.threads, track=tracker(arguments),
    )  # fmt: skip


def _watched(arguments: argparse.Namespace, path: Path, scene: Gaussians | Moving) -> dict[str, Any]:
    """Add batch after batch; what is told in the end is of all together."""
    from ... import load_field
    from ...field.growing.changing import kept_out
    from ...field.growing.watching import Watch, together

    field = load_field(path)
    known = {*(field.evidence.masks.view_names if field.evidence else ()), *kept_out(field)}
    watch = Watch(lambda: (views_of(arguments, arguments.capture), _features(arguments, path)), known, arguments.idle)
    done: list[Change] = []
    try:
        for views, features in watch.batches():
            change = _added(arguments, path, scene, views, features)
            watch.known |= {view.name for view in views}
            done.append(change)
            _print_change(arguments, change)
    except KeyboardInterrupt:
        _say(arguments, "stopped; what had come is added")
    return answer_of(together(done, path), path)


def _print_change(arguments: argparse.Namespace, change: Change) -> None:
    if not change.is_empty:
        views = len(change.field.evidence.masks.view_names) if change.field.evidence else 0
        seconds = sum(change.seconds.values())
        _say(arguments, f"+{len(change.added)}: {views} views, {change.num_touched:,} Gaussians seen, {seconds:.1f} s")


def _say(arguments: argparse.Namespace, line: str) -> None:
    if not arguments.json:
        print(line, file=sys.stderr, flush=True)
