"""Register any splat file and ask it for colours: no photos, no weights, no download needed.

    python examples/register_a_splat.py scene.ply colours/

A trained scene usually comes with its photos, and masks and embeddings come from SAM and CLIP. Here
all three are made from the scene itself, so that every step can be tried and seen on any splat:

1. Photos: 60 cameras orbit the scene and render it.
2. Masks: patches of one colour. Embeddings: a vector for the patch's mean colour, such that the
   cosine of two vectors falls with the distance of their colours. "red" has a vector of the same
   space, as a text has with CLIP.
3. From here on all is as with a real capture: photos, cameras.json and LangSplat's features are
   read from disk, registered, and the field is saved, loaded and queried.

Pictures of the answers are written as well: OUTPUT/answers.jpg shows all of them. What is smaller
than a few dozen pixels gets no mask and is not found: --size 1600 finds smaller things.

The cameras look at the scene from outside: right for an object, not for a room.
"""

import argparse
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64, Int32
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

import drsplat as ds
from drsplat.pictures import (
    Pixels,
    as_pixels,
    best_views,
    contact_sheet,
    highlighted,
    titled,
    visible_share,
    write_picture,
)

BACKDROP = 0.93  # grey level of the studio behind the object
ELEVATIONS = (-12.0, 14.0, 40.0)  # degrees; views take them in turn
FIELD_OF_VIEW = 40.0  # degrees, along the photo's longer side
SMOOTHING = 1.0  # pixels, before colours are told apart
COLOUR_STEP = (24.0, 24.0, 24.0)  # L, a, b: one mask holds colours within one such cell
MIN_PIXELS = 40  # smaller patches get no mask
COLOUR_WIDTH = 30.0  # colours this far apart in Lab are at cosine exp(-1/2) = 0.61
THRESHOLD = 0.5
UPS = {"x": (1, 0, 0), "-x": (-1, 0, 0), "y": (0, 1, 0), "-y": (0, -1, 0), "z": (0, 0, 1), "-z": (0, 0, -1)}  # fmt: skip
COLOURS = {
    "red": (165, 35, 45),
    "orange": (225, 125, 40),
    "yellow": (215, 180, 80),
    "green": (50, 140, 60),
    "blue": (40, 80, 180),
    "brown": (95, 55, 30),
    "skin": (180, 130, 110),
    "white": (230, 228, 222),
    "grey": (120, 120, 120),
    "black": (22, 22, 24),
}
"""sRGB of what is asked for. Nothing is learnt from it: any other list will do."""


# --- 1. cameras and photos ----------------------------------------------------------------------


def orbit(
    gaussians: ds.Gaussians, up: Float64[np.ndarray, " 3"], num_views: int, long_side: int = 800
) -> list[ds.View]:
    """Cameras around the scene that show all of it; portrait format for tall scenes."""
    middle, half_height, radius = upright_cylinder(gaussians, up)
    tall = half_height > radius
    short_side = long_side * 3 // 4
    width, height = (short_side, long_side) if tall else (long_side, short_side)
    focal = 0.5 * long_side / np.tan(np.radians(FIELD_OF_VIEW) / 2)
    fits = 2.0 * focal * max(half_height / height, radius / width)
    side = np.cross(up, np.roll(up, 1))
    views = []
    for index in range(num_views):
        azimuth = 2 * np.pi * index / num_views
        elevation = np.radians(ELEVATIONS[index % len(ELEVATIONS)])
        level = np.cos(azimuth) * side + np.sin(azimuth) * np.cross(up, side)
        away = np.cos(elevation) * level + np.sin(elevation) * up
        pose = look_at(middle + (fits + radius) * away, middle, up)
        K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
        views.append(ds.View(f"photo_{index:03d}.png", K, pose, width, height))
    return views


def upright_cylinder(
    gaussians: ds.Gaussians, up: Float64[np.ndarray, " 3"]
) -> tuple[Float64[np.ndarray, " 3"], float, float]:
    """Middle, half height and radius of the scene, whatever few Gaussians float far off."""
    points, mass = gaussians.means.astype(np.float64), gaussians.opacities
    low, high = (
        np.array([weighted_quantile(axis, mass, q) for axis in points.T]) for q in (0.002, 0.998)
    )
    middle = (low + high) / 2
    heights = (points - middle) @ up
    across = np.linalg.norm(points - middle - heights[:, None] * up, axis=1)
    return (
        middle,
        weighted_quantile(np.abs(heights), mass, 0.998),
        weighted_quantile(across, mass, 0.998),
    )


def weighted_quantile(values: np.ndarray, weights: np.ndarray, q: float) -> float:
    """The value below which a share q of the weight lies."""
    order = np.argsort(values)
    cumulated = np.cumsum(weights[order], dtype=np.float64)
    return float(values[order][np.searchsorted(cumulated, q * cumulated[-1])])


def look_at(
    eye: Float64[np.ndarray, " 3"], target: Float64[np.ndarray, " 3"], up: Float64[np.ndarray, " 3"]
) -> Float64[np.ndarray, "4 4"]:
    """cam_from_world of a camera at `eye`, in OpenCV axes: +x right, +y down, +z forward."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ eye
    return pose


# --- 2. masks and embeddings by colour --------------------------------------------------------------


def srgb_to_lab(rgb: np.ndarray) -> Float64[np.ndarray, "*n 3"]:
    """sRGB in [0, 1] to CIE L*a*b* (D65), where distances are differences as people see them."""
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((np.maximum(rgb, 0) + 0.055) / 1.055) ** 2.4)
    to_xyz = [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]  # fmt: skip
    x, y, z = np.moveaxis(linear @ np.transpose(to_xyz) / (0.95047, 1.0, 1.08883), -1, 0)
    fx, fy, fz = (np.where(t > 0.008856, np.cbrt(t), 7.787 * t + 16 / 116) for t in (x, y, z))
    return np.stack([116 * fy - 16, 500 * (fx - fy), 200 * (fy - fz)], -1)


class ColourEncoder:
    """Colours to unit vectors, by random Fourier features of Lab: cosine = exp(-(d / width)^2 / 2).

    It stands where CLIP stands: it has `identity` and `encode_texts`, which is all that
    `drsplat.query` asks of an encoder. Source: Rahimi and Recht 2007.
    """

    identity = ds.EncoderIdentity("colour-512", 512, weights="lab-fourier-1")

    def __init__(self) -> None:
        shape = (3, self.identity.dim // 2)
        self._frequencies = np.random.default_rng(0).standard_normal(shape) / COLOUR_WIDTH

    def encode_lab(self, lab: Float64[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 512"]:
        phases = lab @ self._frequencies
        features = np.hstack([np.cos(phases), np.sin(phases)])
        features /= np.linalg.norm(features, axis=1, keepdims=True)
        return np.asarray(features, np.float32)

    def encode_texts(self, texts: Sequence[str]) -> Float32[np.ndarray, "t 512"]:
        """Vectors of colours by name."""
        return self.encode_lab(srgb_to_lab(np.array([COLOURS[text] for text in texts]) / 255))


def colour_patches(
    rgb: Float32[np.ndarray, "h w 3"], alpha: Float32[np.ndarray, "h w"]
) -> tuple[Int32[np.ndarray, "h w"], Float64[np.ndarray, "s 3"]]:
    """Segment map of connected patches of one colour, and the mean Lab colour of each.

    rgb is over black, so that rgb / alpha is the object's own colour. Pixels of alpha < 0.5 are -1.
    """
    smooth = ndimage.gaussian_filter(rgb, (SMOOTHING, SMOOTHING, 0))
    cover = ndimage.gaussian_filter(alpha, SMOOTHING)
    lab = srgb_to_lab(np.clip(smooth / np.maximum(cover, 1e-3)[..., None], 0, 1))
    cells = np.round(lab / COLOUR_STEP).astype(np.int64) @ (1 << 20, 1 << 10, 1)
    patches = connected_patches(np.where(alpha < 0.5, np.iinfo(np.int64).min, cells))
    sizes = np.bincount(patches.ravel())
    sizes[patches[alpha < 0.5]] = 0
    kept = np.flatnonzero(sizes >= MIN_PIXELS)
    renumbered = np.full(len(sizes), -1, np.int32)
    renumbered[kept] = np.arange(len(kept))
    sums = [np.bincount(patches.ravel(), channel.ravel()) for channel in np.moveaxis(lab, -1, 0)]
    return renumbered[patches], np.stack(sums, -1)[kept] / sizes[kept, None]


def connected_patches(values: np.ndarray) -> np.ndarray:
    """Label of each pixel: equal for neighbours of equal value."""
    index = np.arange(values.size).reshape(values.shape)
    across, down = values[:, 1:] == values[:, :-1], values[1:] == values[:-1]
    start = np.concatenate([index[:, 1:][across], index[1:][down]])
    end = np.concatenate([index[:, :-1][across], index[:-1][down]])
    edges = coo_array((np.ones(len(start), bool), (start, end)), shape=(values.size, values.size))
    return np.reshape(connected_components(edges, directed=False)[1], values.shape)


def write_capture(folder: Path, gaussians: ds.Gaussians, views: Sequence[ds.View]) -> None:
    """folder/images, folder/cameras.json and folder/features, as a user would have them."""
    (folder / "images").mkdir(parents=True, exist_ok=True)
    ds.write_cameras_json(folder / "cameras.json", views, overwrite=True)
    encoder, splats = ColourEncoder(), ds.splat_arrays(gaussians)
    for view in views:
        seen = ds.render(gaussians, view, splats=splats)
        photo = seen.rgb + (1 - seen.alpha[..., None]) * np.float32(BACKDROP)
        write_picture(folder / "images" / view.name, as_pixels(photo), overwrite=True)
        segment_ids, lab = colour_patches(seen.rgb, seen.alpha)
        stem = Path(view.name).stem
        ds.write_features(
            folder / "features", stem, segment_ids, encoder.encode_lab(lab), overwrite=True
        )


# --- 3. register and ask ---------------------------------------------------------------------------


def main() -> None:
    options = parsed_options()
    folder, encoder = options.output, ColourEncoder()
    with timed("reading the scene"):
        gaussians = ds.read_gaussians(options.scene)
    with timed(f"rendering and segmenting {options.views} photos"):
        up = np.array(UPS[options.up], np.float64)
        write_capture(folder, gaussians, orbit(gaussians, up, options.views, options.size))
    with timed("registering"):
        views = ds.read_views(folder)
        features = ds.read_features(folder / "features", encoder=encoder.identity)
        registration = ds.register(gaussians, views, features)
    with timed("building and saving the field"):
        registration.to_field().save(folder / "scene.field", overwrite=True)
    print(
        f"{len(gaussians):,} Gaussians, {registration.num_registered:,} of them registered "
        f"({registration.num_registered / len(gaussians):.1%}); {registration.weights.shape[1]:,} "
        f"masks, {registration.weights.nnz:,} weights\n"
    )
    field = ds.load_field(folder / "scene.field")
    answers = {name: ask(field, gaussians, encoder, name) for name in COLOURS}
    with timed("drawing the answers"):
        write_pictures(folder, gaussians, views, features, field, answers)


def ask(
    field: ds.LanguageField, gaussians: ds.Gaussians, encoder: ColourEncoder, name: str
) -> Float32[np.ndarray, " r"]:
    """Score of each registered Gaussian: high where the colour fits, and fits better than others."""
    began = time.perf_counter()
    answer = ds.query(field, encoder, name, negatives=[other for other in COLOURS if other != name])
    scores = np.asarray(np.minimum(answer.scores, answer.relevancy))
    things = ds.locate(field, gaussians, scores, THRESHOLD)
    seconds, found = time.perf_counter() - began, len(ds.select(field, scores, THRESHOLD))
    print(f"{name:>8}: {found:7,} Gaussians in {len(things):3} instances, {seconds:.2f} s")
    return scores


def write_pictures(
    folder: Path,
    gaussians: ds.Gaussians,
    views: Sequence[ds.View],
    features: Mapping[str, ds.ViewFeatures],
    field: ds.LanguageField,
    answers: dict[str, Float32[np.ndarray, " r"]],
) -> None:
    """Per colour found: photo, masks, score, selection, from the view that shows most of it."""
    selections = {name: ds.select(field, scores, THRESHOLD) for name, scores in answers.items()}
    found_ids = {name: ids for name, ids in selections.items() if len(ids)}
    rows, splats = [], ds.splat_arrays(gaussians)
    chosen_views = best_views(gaussians, views, list(found_ids.values()))
    for (name, ids), view in zip(found_ids.items(), chosen_views, strict=True):
        photo, scores = ds.load_image(view), answers[name]
        masks = painted(features[view.name].segment_ids)
        dense = field.dense(scores, fill=0.0)[:, None]
        seen = ds.render(gaussians, view, values=dense, splats=splats)
        score = heat(seen.channels[..., 0], seen.alpha)
        found = highlighted(photo, visible_share(gaussians, view, ids, splats=splats))
        titles = view.name, "masks", f"score of “{name}”", f"{len(ids):,} Gaussians"
        rows.append(
            [titled(p, t) for p, t in zip((photo, masks, score, found), titles, strict=True)]
        )
        write_picture(folder / f"{name}.png", contact_sheet(rows[-1], 4), overwrite=True)
    if rows:
        tiles = [tile for row in rows for tile in row]
        write_picture(folder / "answers.jpg", contact_sheet(tiles, 8, 300), overwrite=True)


def painted(segment_ids: Int32[np.ndarray, "h w"]) -> Pixels:
    """Each segment in a colour of its own, white where there is none."""
    palette = np.random.default_rng(1).integers(30, 226, (segment_ids.max() + 2, 3), np.uint8)
    palette[-1] = 255
    return np.asarray(palette[segment_ids])


def heat(score: Float32[np.ndarray, "h w"], alpha: Float32[np.ndarray, "h w"]) -> Pixels:
    """Blue is 0, red the threshold, yellow 1; white where there is no scene."""
    stops = {0.0: (40, 48, 110), THRESHOLD: (215, 45, 60), 1.0: (255, 235, 90)}
    value = score / np.maximum(alpha, 1e-3)
    channels = [
        np.interp(value, list(stops), levels) for levels in zip(*stops.values(), strict=True)
    ]
    cover = np.clip(alpha, 0, 1)[..., None]
    return as_pixels((np.stack(channels, -1) / 255 * cover + 1 - cover).astype(np.float32))


@contextmanager
def timed(what: str) -> Iterator[None]:
    """Say how long it took."""
    began = time.perf_counter()
    yield
    print(f"{what}: {time.perf_counter() - began:.1f} s")


def parsed_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("scene", type=Path, help="3DGS PLY, compressed PLY, SPZ or .splat")
    parser.add_argument("output", type=Path, help="folder for photos, features, field and pictures")
    parser.add_argument("--views", type=int, default=60)
    parser.add_argument("--size", type=int, default=800, help="longer side of a photo, in pixels")
    parser.add_argument("--up", choices=UPS, default="-y", help="3DGS scenes are mostly -y")
    return parser.parse_args()


if __name__ == "__main__":
    main()
