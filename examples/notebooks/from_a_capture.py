"""From a capture to an answer: posed photos and a scene become a field that words are asked of.

It runs on what `drsplat demo` writes, without a download and without a GPU. With your own photos, `drsplat capture`
finds the poses and `drsplat train` makes the scene; `drsplat scan` does all of it in one command.
"""

# %% A capture is photos with their poses, here those of a made room; the scene was trained from them.

from PIL import Image

import drsplat as ds
from drsplat.field.objects.finding import find_objects

views = ds.read_views("drsplat-demo")
gaussians = ds.read_gaussians("drsplat-demo/scene.compressed.ply")
print(f"{len(views)} photos, {len(gaussians):,} Gaussians")

# %% Each photo is cut into masks, and each mask is embedded. The models are built in and know rooms like this one; for
# your own photos name SAM and CLIP: `ds.load_segmenter("facebook/sam2.1-hiera-tiny")`, `ds.load_encoder(...)`.

encoder = ds.MiniEncoder()
report = ds.embed(views[::3], "features", ds.load_segmenter("graph"), encoder, overwrite=True)
print(report)

# %% The embeddings go onto the Gaussians that the masks show: each pixel's ray says how much each Gaussian counts.

features = ds.read_features("features", encoder=encoder.identity)
field = ds.register(gaussians, views[::3], features).to_field()
field = field.with_objects(find_objects(field, gaussians))
field.save("room.field", overwrite=True)
scene = ds.Scene(field, gaussians, views, encoder)

# %% Ask. An answer is sure, maybe or nothing; a match has a place, a size and the photos that show it.

for text in ("red vase", "yellow apple", "laptop"):
    answer = scene.ask(text)
    places = ", ".join(str(match.center.round(2)) for match in scene.locate(answer))
    print(f"{text}: {answer.certainty} {places}")

# %% The answer in the photo that shows most of it.

Image.fromarray(scene.picture(shown=scene.ask("red vase"), photo=True)).reduce(2).save("answer.png")
