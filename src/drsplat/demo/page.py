"""The demo's answers as a page for a browser, beside the pictures that it shows."""

from collections.abc import Sequence
from html import escape
from pathlib import Path

from ..formats.replacing import replacing
from .album import note
from .story import Story, Verdict

PAGE = "index.html"
_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 72rem; padding: 0 1rem; color: #1c1e24 }
.answers { display: grid; grid-template-columns: repeat(auto-fill, minmax(17rem, 1fr)); gap: 1rem; padding: 0 }
figure { margin: 0; border-top: 4px solid #2a9d55; background: #f6f7f9 } figure.miss { border-color: #c4342b }
img { width: 100%; display: block } figcaption { padding: .5rem .75rem }
code { background: #f0f1f4; padding: .1rem .3rem }
small { color: #5c6270 }
"""


def write_page(folder: Path, story: Story, pictures: Sequence[Path], *, overwrite: bool = False) -> Path:
    """folder/index.html. pictures: one per answer, in folder."""
    right = sum(verdict.is_right for verdict in story.verdicts)
    shown = [
        _figure(verdict, path.relative_to(folder).as_posix())
        for verdict, path in zip(story.verdicts, pictures, strict=True)
    ]
    text = f"""<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>drsplat: a room, searched in words</title><style>{_STYLE}</style>
<h1>A room, searched in words</h1>
<p>{len(story.views)} photos, {len(story.gaussians):,} Gaussians, {story.num_masks:,} masks that no person drew;
{right} of {len(story.verdicts)} answers are right. A green bar is a right answer: the selected and the
true pixels overlap by more than half (IoU) in {len(story.held_out)} photos that neither the scene nor the field was
made from, or there is nothing of the kind and no match. A red bar is a miss.</p>
<div class="answers">{"".join(shown)}</div>
<p>Try your own query: <code>drsplat locate . "red vase"</code>, or in a browser: <code>drsplat view .</code></p>
<p><small>Rendered photos of a made-up room; the masks are of the built-in segmenter, the words of a built-in encoder
that knows this kind of room only.</small></p>
</html>
"""
    with replacing(folder / PAGE, overwrite) as file:
        file.write(text.encode())
    return folder / PAGE


def _figure(verdict: Verdict, picture: str) -> str:
    title, said = escape(verdict.probe.text), escape(note(verdict))
    kind = "" if verdict.is_right else ' class="miss"'
    words = f"<b>{title}</b><br><small>{said}; {len(verdict.gaussian_ids):,} Gaussians</small>"
    source = escape(picture, quote=True)
    return f'<figure{kind}><img src="{source}" alt="{title}: {said}"><figcaption>{words}</figcaption></figure>'
