"""Answers of the demo as a page for a browser, beside its pictures."""

import os
from collections.abc import Sequence
from html import escape
from pathlib import Path

from ...formats.replacing import replacing
from ...scene.views import View
from .album import note
from .story import Story, Verdict

PAGE = "index.html"
_STYLE = """
:root { color-scheme: light dark; --paper: #fff; --soft: #f3f4f7; --ink: #1c1e24; --faint: #565b66; --line: #d6d9df;
  --right: #1d7a41; --miss: #b3261e }
@media (prefers-color-scheme: dark) { :root { --paper: #1c1e24; --soft: #262a33; --ink: #e6e8ee; --faint: #b6bac5;
  --line: #434752; --right: #6fd398; --miss: #ff8f85 } }
body { font: 16px/1.5 system-ui, sans-serif; margin: 0 auto; max-width: 76rem; padding: 2rem 1rem 4rem;
  color: var(--ink); background: var(--paper) }
h1 { font-size: clamp(1.8rem, 5vw, 2.6rem); line-height: 1.15; letter-spacing: -.02em; margin: 0 0 .5rem }
h2 { font-size: 1.3rem; margin: 2.5rem 0 .5rem } p { max-width: 48rem }
dl { display: grid; grid-template-columns: repeat(auto-fit, minmax(9rem, 1fr)); gap: 1rem; margin: 1.5rem 0 }
dl div { background: var(--soft); border-top: 3px solid #b3126b; padding: .6rem 1rem }
dt { color: var(--faint); font-size: .9rem } dd { margin: 0; font-size: 1.6rem; font-weight: 600 }
.room, .answers { display: grid; gap: 1rem }
.room { grid-template-columns: repeat(auto-fit, minmax(min(20rem, 100%), 1fr)) }
.answers { grid-template-columns: repeat(auto-fill, minmax(min(17rem, 100%), 1fr)) }
figure { margin: 0; background: var(--soft); border: 1px solid var(--line) }
img { width: 100%; height: auto; display: block } figcaption { padding: .6rem .8rem }
figcaption b { display: flex; justify-content: space-between; gap: 1rem }
figcaption i { font-style: normal; color: var(--right) } .miss figcaption i { color: var(--miss) }
pre { background: var(--soft); padding: .8rem 1rem; overflow-x: auto } small { color: var(--faint) }
"""


def write_page(folder: Path, story: Story, pictures: Sequence[Path], *, overwrite: bool = False) -> Path:
    """Write folder/index.html. pictures: one per answer, in folder."""
    pairs = zip(story.verdicts, pictures, strict=True)
    shown = "\n".join(_figure(verdict, path.relative_to(folder).as_posix()) for verdict, path in pairs)
    text = f"""<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>drsplat: a room, searched in words</title><style>{_STYLE}</style>
<h1>A room, searched in words</h1>
<p>Masks that no person drew were embedded and registered onto the Gaussians of a room; then it was asked
{len(story.verdicts)} questions. No model here has learned from it.</p>
<dl>{_tiles(story)}</dl>
<div class="room">{"".join(_photo(folder, view) for view in (story.held_out[0], story.held_out[-1]))}</div>
<h2>Answers</h2>
<p>An answer is right where the selected and the true pixels overlap by more than half (IoU) in {len(story.held_out)}
photos that neither the scene nor the field was made from, or where there is nothing of the kind and no match.</p>
<div class="answers">
{shown}
</div>
<h2>Go on</h2>
<p>Ask something else, open the room in a browser, or see what is in it; here, in this folder:</p>
<pre>drsplat locate . "red vase"
drsplat view .
drsplat objects . --views . --picture objects.jpg</pre>
<p><small>Rendered photos of a made-up room; the masks are of the built-in segmenter, the words of a built-in encoder
that knows this kind of room only.</small></p>
</html>
"""
    with replacing(folder / PAGE, overwrite) as file:
        file.write(text.encode())
    return folder / PAGE


def _tiles(story: Story) -> str:
    right = sum(verdict.is_right for verdict in story.verdicts)
    tiles = (
        ("answers are right", f"{right} of {len(story.verdicts)}"), ("photos", len(story.views)),
        ("masks", f"{story.num_masks:,}"), ("Gaussians", f"{len(story.gaussians):,}"),
    )  # fmt: skip
    return "".join(f"<div><dt>{name}</dt><dd>{value}</dd></div>" for name, value in tiles)


def _photo(folder: Path, view: View) -> str:
    source = escape(Path(os.path.relpath(view.image_path or "", folder)).as_posix(), quote=True)
    return f'<figure><img src="{source}" alt="The room, in a photo that was held out"></figure>'


def _figure(verdict: Verdict, picture: str) -> str:
    title, result = escape(verdict.probe.text), escape(note(verdict).removeprefix("miss: "))
    kind = "right" if verdict.is_right else "miss"
    selected = f"; {len(verdict.gaussian_ids):,} Gaussians" if verdict.found else ""
    words = f"<b>{title} <i>{kind}</i></b><small>{result}{selected}</small>"
    source = escape(picture, quote=True)
    return (
        f'<figure class="{kind}"><img src="{source}" alt="{title}: {result}"><figcaption>{words}</figcaption></figure>'
    )
