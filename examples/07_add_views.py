"""Add photos to a scene that is registered already: only the new ones are looked at.

Needs a folder with a field, its scene and its photos; of what `drsplat demo` wrote, the six photos that it held out are
added. Usage: python examples/07_add_views.py [FOLDER WORDS]
"""

import sys

from PIL import Image

import drsplat as ds


def main(folder: str = "drsplat-demo", words: str = "red vase") -> None:
    scene = ds.open_scene(folder)
    # %% The photos that the field has not seen.
    before = ds.Registration.from_field(scene.field)
    known = set(before.masks.view_names)
    new = [view for view in scene.views if view.name not in known]
    if not new:
        raise SystemExit("all photos are registered already")

    # %% Only these are embedded and registered; the sum is the same to the bit as of all photos at once.
    ds.embed(new, "new_features", ds.load_segmenter("graph"), ds.MiniEncoder())
    after = before.merged(ds.register(scene.gaussians, new, ds.read_features("new_features")))
    field = after.to_field()
    field.save("more.field", overwrite=True)
    print(f"before: {before}\nafter:  {after}")

    # %% The answer of the field that has seen more, in one of the new photos.
    more = ds.Scene(field, scene.gaussians, scene.views)
    print(*more.locate(words), sep="\n")
    Image.fromarray(more.picture(new[0], more.ask(words), photo=True)).save("more.png")


if __name__ == "__main__":
    main(*sys.argv[1:])
