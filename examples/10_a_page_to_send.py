"""Write a scene and its answers as one HTML file, to send to anybody who has a browser.

Needs a folder with a field and its scene, such as `drsplat demo` writes; the page itself needs nothing. Usage:
python examples/10_a_page_to_send.py [FOLDER PAGE.html WORDS...]
"""

import sys
from pathlib import Path

import drsplat as ds


def main(folder: str = "drsplat-demo", page: str = "page.html", *words: str) -> None:
    scene, queries = ds.open_scene(folder), words or ("red vase", "couch", "laptop")
    known = (*queries, "table", "shelf", "wall", "floor")  # what a click on the page can say
    content = ds.export_page(page, scene, queries, words=known, title="A room, asked in words", overwrite=True)

    for answer in content.answers:
        print(f"{answer.text}: {len(answer.matches) or 'nothing'} found")
    print(f"{page}: {Path(page).stat().st_size / 1e6:.1f} MB; open it in a browser")


if __name__ == "__main__":
    main(*sys.argv[1:])
