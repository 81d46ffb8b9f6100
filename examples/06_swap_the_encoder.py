"""Give a registered scene another encoder: its masks are embedded again, but no photo is registered again.

Needs the folder that `drsplat demo` wrote. This encoder knows colours; `ds.load_encoder` loads CLIP. Usage:
python examples/06_swap_the_encoder.py [FOLDER COLOUR]
"""

import sys

import numpy as np
from PIL import Image
from PIL.ImageColor import getrgb
from scipy.ndimage import find_objects

import drsplat as ds


# %% An encoder of our own
class ColorEncoder:  # an encoder is any object like this: pictures and words to unit vectors
    identity, threshold = ds.EncoderIdentity("mean colour", dim=4), 0.95  # of cosines

    def encode_images(self, images: list[np.ndarray]) -> np.ndarray:
        means = np.array([image.mean((0, 1)) for image in images])
        light = means.mean(1, keepdims=True)
        vectors = np.hstack([means - light, 0.1 * light + 1])  # grey is the last axis
        return np.float32(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))

    def encode_texts(self, texts: list[str]) -> np.ndarray:
        return self.encode_images([np.array([[getrgb(text)]]) for text in texts])


def main(folder: str = "drsplat-demo", color: str = "red") -> None:
    scene, encoder, crops = ds.open_scene(folder), ColorEncoder(), []
    # %% What lies in each mask of each photo, embedded anew.
    masks = ds.read_features(f"{folder}/language_features")
    old = ds.Registration.from_field(scene.field)
    for name in old.masks.view_names:  # the masks in the order of the registration's columns
        photo, ids = ds.load_image(scene.view(name)), masks[name].mask_ids
        for number, box in enumerate(find_objects(ids + 1)):
            crops.append(photo[box] * (ids[box] == number)[..., None])  # on black
    # %% Which Gaussians each mask shows has not changed, so the new embeddings take the place of the old ones.
    new = old.with_embeddings(encoder.encode_images(crops), encoder.identity)
    field = new.to_field(ds.PQ(subvectors=4))  # as many as divide the dimension; 128 by default
    field.save("colors.field", overwrite=True)
    colors = ds.Scene(field, scene.gaussians, scene.views, encoder)
    print(*colors.locate(color), sep="\n")
    Image.fromarray(colors.picture(shown=colors.ask(color), photo=True)).save("color.png")


if __name__ == "__main__":
    main(*sys.argv[1:])
