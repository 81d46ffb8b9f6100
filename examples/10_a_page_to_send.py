"""Write a scene and its answers as one HTML file, to send to anybody who has a browser.

Needs a folder with a field and its scene, such as `drsplat demo` writes; the page itself needs nothing. Usage:
python examples/10_a_page_to_send.py [FOLDER PAGE.html WORDS...]
"""

import sys

import drsplat as ds
from drsplat.viewing.cameras import first_look, up_direction
from drsplat.viewing.exporting import page_of
from drsplat.viewing.page import MOST, write_page
from drsplat.viewing.session import Session


def main(folder: str = "drsplat-demo", page: str = "page.html", *words: str) -> None:
    scene, texts = ds.open_scene(folder), words or ("red vase", "couch", "laptop")
    # of the largest Gaussians as many as a page holds; words: what a click on the page can say
    session = Session(scene, MOST, words=(*texts, "table", "shelf", "wall", "floor"))
    up = up_direction(scene.views)
    look = first_look(scene.views, session.shown.frame, up)

    content = page_of(session, texts, look, up, title="A room, asked in words")
    size = write_page(page, content, overwrite=True)
    for answer in content.answers:
        print(f"{answer.text}: {len(answer.matches) or 'nothing'} found")
    print(f"{page}: {size / 1e6:.1f} MB; open it in a browser")


if __name__ == "__main__":
    main(*sys.argv[1:])
