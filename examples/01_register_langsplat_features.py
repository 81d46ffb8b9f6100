"""Register a folder of LangSplat features (`_s.npy`, `_f.npy`) onto a scene, and save the field.

Needs the Gaussians, the posed photos and the features; without arguments, what `drsplat demo` wrote. Usage:
python examples/01_register_langsplat_features.py [SCENE.ply CAPTURE FEATURES OUTPUT.field ENCODER_NAME]
"""

import sys

import numpy as np
from PIL import Image

import drsplat as ds


def main(
    scene: str = "drsplat-demo/scene.compressed.ply",
    capture: str = "drsplat-demo",
    features: str = "drsplat-demo/language_features",
    output: str = "registered.field",
    encoder_name: str = "",
) -> None:
    # %% Masks with embeddings, the photos that have some, and the scene.
    # LangSplat's files do not say who embedded them: "ViT-B-16/laion2b_s34b_b88k" if LangSplat did
    encoder = ds.EncoderIdentity(encoder_name, dim=512) if encoder_name else None
    masks = ds.read_features(features, level="large", encoder=encoder)
    views = [view for view in ds.read_views(capture) if view.name in masks]
    gaussians = ds.read_gaussians(scene)

    # %% The masks of the first photo, each in a colour.
    ids = masks[views[0].name].mask_ids
    colors = np.random.default_rng(0).integers(0, 256, (ids.max() + 2, 3), np.uint8)
    Image.fromarray(colors[ids]).save("masks.png")

    # %% Registration gives each Gaussian the mean of the embeddings of the masks that show it, weighted by how much of
    # the pixels it makes up. The field keeps them as codes of a few bytes, and answers queries.
    registration = ds.register(gaussians, views, masks)
    field = registration.to_field()  # of a scene's masks, ds.Mixture(), takes longer, and often less space
    field.save(output, overwrite=True)
    print(f"{registration}\n{field}\nwritten to {output}")


if __name__ == "__main__":
    main(*sys.argv[1:])
