"""Ask a scene in words; save the answer as a scene for SuperSplat, as a picture and as row numbers.

Needs a folder with a field, its scene and its photos, such as `drsplat demo` writes. Usage:
python examples/02_ask_and_save.py [FOLDER WORDS]
"""

import sys

import numpy as np
from PIL import Image

import drsplat as ds


def main(folder: str = "drsplat-demo", words: str = "red vase") -> None:
    scene = ds.open_scene(folder)
    # %% An answer says how well each Gaussian fits; its matches are the places where enough of them fit.
    answer = scene.ask(words)
    matches = scene.locate(answer)
    if not matches:
        raise SystemExit(f"nothing found for '{words}'")
    for match in matches:
        photos = ", ".join(mask.view_name for mask in match.support)
        print(f"at {match.center.round(2)}, size {match.extent.round(2)}, seen in {photos}")

    # %% The answer as columns of the scene, as a picture over the photo that shows most of it, and as row numbers.
    match_ids = np.full(len(scene.gaussians), -1, np.int32)
    for number, match in enumerate(matches):
        match_ids[match.gaussian_ids] = number
    columns = {"relevancy": answer.dense, "match_id": match_ids}
    ds.write_gaussians("found.ply", scene.gaussians, columns, overwrite=True)
    Image.fromarray(scene.picture(shown=answer, photo=True)).save("found.png")
    np.save("found.npy", answer.gaussian_ids)
    print("written to found.ply, found.png and found.npy")


if __name__ == "__main__":
    main(*sys.argv[1:])
