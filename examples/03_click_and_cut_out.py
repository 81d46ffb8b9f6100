"""Click on a thing in a photo, cut it out of the scene, and save it and the rest as two PLYs.

Needs a folder with a field, its scene and its photos, such as `drsplat demo` writes. Usage:
python examples/03_click_and_cut_out.py [FOLDER PHOTO X Y]
"""

import sys

import numpy as np
from PIL import Image

import drsplat as ds


def main(folder: str = "drsplat-demo", photo: str = "frame_00014", x: str = "365", y: str = "255") -> None:
    scene, click = ds.open_scene(folder), (photo, float(x), float(y))
    # %% What is at a pixel of a photo, and what is like it anywhere in the scene.
    print("this is:", ", ".join(word.text for word in scene.what_is(click, top=3)))

    places = scene.locate(ds.Query(click=click))  # all that is like it
    if not places:
        raise SystemExit("nothing large enough to be a thing is there: click elsewhere")
    # %% The place nearest to the click, and only its Gaussians.
    positions, clicked = scene.gaussians.positions, scene.point_at(click)

    def distance(place: ds.Match) -> float:
        return float(np.linalg.norm(positions[place.gaussian_ids] - clicked, axis=1).min())

    thing = min(places, key=distance)
    Image.fromarray(scene.picture(photo, thing.gaussian_ids)).save("thing.png")

    # %% One scene becomes two, which any viewer opens.
    is_thing = np.zeros(len(scene.gaussians), bool)
    is_thing[thing.gaussian_ids] = True
    ds.write_gaussians("thing.ply", scene.gaussians.subset(is_thing), overwrite=True)
    ds.write_gaussians("rest.ply", scene.gaussians.subset(~is_thing), overwrite=True)
    print(f"{thing} is in thing.ply, all else in rest.ply")


if __name__ == "__main__":
    main(*sys.argv[1:])
