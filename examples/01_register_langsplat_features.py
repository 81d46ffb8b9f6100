"""Register a folder of LangSplat features (`_s.npy`, `_f.npy`) onto a scene, and save the field.

Needs the Gaussians, the posed photos and the features; without arguments, what `drsplat demo` wrote. Usage:
python examples/01_register_langsplat_features.py [SCENE.ply CAPTURE FEATURES OUTPUT.field ENCODER_NAME]
"""

import sys

import drsplat as ds


def main(
    scene: str = "drsplat-demo/scene.compressed.ply",
    capture: str = "drsplat-demo",
    features: str = "drsplat-demo/language_features",
    output: str = "registered.field",
    encoder_name: str = "",
) -> None:
    # LangSplat's files do not say who embedded them: "ViT-B-16/laion2b_s34b_b88k" if LangSplat did
    encoder = ds.EncoderIdentity(encoder_name, dim=512) if encoder_name else None
    masks = ds.read_features(features, level="large", encoder=encoder)
    views = [view for view in ds.read_views(capture) if view.name in masks]
    gaussians = ds.read_gaussians(scene)

    registration = ds.register(gaussians, views, masks)
    field = registration.to_field()  # of a scene's masks, ds.Mixture(), takes longer, and often less space
    field.save(output, overwrite=True)
    print(f"{registration}\n{field}\nwritten to {output}")


if __name__ == "__main__":
    main(*sys.argv[1:])
