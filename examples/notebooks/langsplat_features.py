"""Features as LangSplat's preprocessing writes them, registered without training, asked and compared.

For researchers who have such features. They are made here of the demo's photos by the built-in models, so that the
notebook runs anywhere; put your own folders in their place.
"""

# %% A pair of files for each photo: `NAME_s.npy`, the mask of each pixel at four levels, and `NAME_f.npy`, an embedding
# for each mask.

import json
from pathlib import Path

import numpy as np
from PIL import Image

import drsplat as ds

views = ds.read_views("drsplat-demo")
gaussians = ds.read_gaussians("drsplat-demo/scene.compressed.ply")
encoder = ds.MiniEncoder()
ds.embed(views[::3], "langsplat", ds.load_segmenter("graph"), encoder, form="langsplat", overwrite=True)
for path in sorted(Path("langsplat").glob("*.npy"))[:2]:
    array = np.load(path)
    print(path.name, array.shape, array.dtype)

# %% Registration is a weighted mean over the pixels' rays: no training, seconds on a CPU. LangSplat's files do not say
# who embedded them, so say it; `level` is small, medium or large, and levels are never mixed.

masks = ds.read_features("langsplat", level="large", encoder=encoder.identity)
registered = ds.register(gaussians, views[::3], masks)
field = registered.to_field()
print(field)

# %% A feature per Gaussian as an array, for your own code; what no photo shows has none.

features = field.feature(np.arange(3))
print(features.shape, np.linalg.norm(features, axis=1).round(3), field.gaussian_ids[:3])

# %% Words come from the encoder, or from a file of text vectors that you have made with yours. A query is told from the
# other texts, so name a hundred or more.

texts = ["red vase", *encoder.nouns, *(f"{color} mug" for color in ("red", "green", "blue", "white"))]
texts += [f"{color} {noun}" for color in ("red", "green", "yellow") for noun in encoder.nouns[:25]]
vectors = {text: vector.tolist() for text, vector in zip(texts, encoder.encode_texts(texts), strict=True)}
Path("texts.json").write_text(json.dumps(vectors))
words = ds.read_vocabulary("texts.json", name=field.encoder.name)
scene = ds.Scene(field, gaussians, views, words)
for match in scene.locate("red vase"):
    print(match.center.round(2), match.extent.round(2), f"score {match.score:.2f}")

# %% Another aggregation of the same weights: each Gaussian keeps a mixture of the embeddings that it was seen with.

mixture = ds.Scene(registered.to_field(ds.Mixture()), gaussians, views, words)
for name, one in (("one mean", scene), ("mixture", mixture)):
    print(f"{name}: {len(one.ask('red vase').gaussian_ids)} Gaussians selected")

# %% What is selected, in the photo that shows most of it. `drsplat evaluate lerf-ovs` scores a field on labelled
# photos.

Image.fromarray(scene.picture(shown=scene.ask("red vase"), photo=True)).reduce(2).save("selected.png")
