"""Write a scene and its answers as one HTML file, to send to anybody who has a browser.

Needs a folder with a field and its scene, such as `drsplat demo` writes; the page itself needs nothing. Usage:
python examples/10_a_page_to_send.py [FOLDER PAGE.html WORDS...]
"""

import sys
from pathlib import Path

from PIL import Image

import drsplat as ds


def main(folder: str = "drsplat-demo", page: str = "page.html", *words: str) -> None:
    scene, queries = ds.open_scene(folder), words or ("red vase", "couch", "laptop")
    # %% The page holds the scene, the answers to these queries, and words for what is clicked.
    known = (*queries, "table", "shelf", "wall", "floor")  # what a click on the page can say
    content = ds.export_page(page, scene, queries, words=known, title="A room, asked in words", overwrite=True)

    # %% What it will show, and how large it is.
    Image.fromarray(scene.picture(shown=scene.ask(queries[0]))).save("page.png")
    for answer in content.answers:
        print(f"{answer.text}: {len(answer.matches) or 'nothing'} found")
    print(f"{page}: {Path(page).stat().st_size / 1e6:.1f} MB; open it in a browser")


if __name__ == "__main__":
    main(*sys.argv[1:])
