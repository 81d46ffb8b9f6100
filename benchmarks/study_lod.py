"""Which Gaussians to draw where there is no room for all: PSNR to the picture of all of them, by the client's own rule.

    npm ci --prefix web
    python benchmarks/study_lod.py SCENE [SCENE ...] [--up +z] [--shares 0.05 0.1 0.2]

The rule is that of web/src/drawing (`Chunks`, `Sorter`), which Node.js runs: of what a camera sees, opacity times
apparent size to a power. Beside it the same number of those most significant of all, as a browser gets them first.
Both are drawn by drsplat's renderer, in five pictures of 480 x 360 pixels: two of the whole scene and three inside it.
"""

import argparse
import json
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drsplat.authoring.filming.looking import looking_at, named_up
from drsplat.drawing.rendering import render
from drsplat.formats.scenes import read_gaussians
from drsplat.fronts.viewing.shown import Shown, frame_of, shown_of
from drsplat.scene.gaussians import Gaussians
from drsplat.scene.significance import significance
from drsplat.scene.views import View

WEB = Path(__file__).resolve().parent.parent / "web"
SIZE, FOV_DEGREES, HEIGHT = (480, 360), 55.0, 0.35
PLACES = ((0.3, 14, 0), (2.2, 14, 0), (4.0, 7, 0), (5.3, 6, 5), (1.2, 5, 4))  # angle, distance and target, in units
CLIENT = """
import { readFileSync, writeFileSync } from "node:fs";
import { Chunks } from "./src/drawing/chunks";
import { Sorter } from "./src/drawing/project";
const folder = process.argv[2], { count, asked } = JSON.parse(readFileSync(`${folder}/asked.json`, "utf8"));
const bytes = (name) => new Uint8Array(readFileSync(`${folder}/${name}`)).buffer;
const opacity = new Uint8Array(bytes("opacity")), rgba = new Uint8Array(4 * count), chunks = new Chunks();
for (let i = 0; i < count; i++) rgba[4 * i + 3] = opacity[i];
const held = { count, rgba, antialiased: false, centers: new Float32Array(bytes("centers")), covariances: new Float32Array(bytes("covariances")) };
chunks.build(held, opacity);
asked.forEach(({ lens, limit }, k) => writeFileSync(`${folder}/${k}.rows`, new Sorter().sorted(held, chunks, lens, limit)));
"""  # noqa: E501


def cameras(gaussians: Gaussians, up: np.ndarray) -> list[View]:
    frame, level = frame_of(gaussians), np.roll(np.eye(3)[np.abs(up).argmax()], 1)
    across, views = np.cross(up, level), []
    for angle, distance, away in PLACES:
        aside = np.cos(angle) * level + np.sin(angle) * across + HEIGHT * up
        eye, target = frame.world(distance * aside), frame.world(away * np.sin(angle) * across)
        views.append(looking_at(eye, target, up, SIZE, FOV_DEGREES))
    return views


def lens_of(shown: Shown, view: View) -> dict[str, object]:
    eye, rows = shown.frame.shown(view.center), view.cam_from_world[:3, :3]
    return {
        "eye": eye.tolist(), "rows": rows.ravel().tolist(), "focal": view.K[0, 0], "width": view.width,
        "height": view.height,
    }  # fmt: skip


def chosen(shown: Shown, order: np.ndarray, views: Sequence[View], limits: Sequence[int]) -> list[np.ndarray]:
    """Return the rows of `order` that the client draws, view by view and limit by limit."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        shown.centers[order].tofile(folder / "centers")
        shown.covariances[order].astype(np.float16).astype(np.float32).tofile(folder / "covariances")
        np.round(shown.opacities[order] * 255).astype(np.uint8).tofile(folder / "opacity")
        asked = [{"lens": lens_of(shown, view), "limit": limit} for view in views for limit in limits]
        (folder / "asked.json").write_text(json.dumps({"count": len(order), "asked": asked}))
        program = folder / "client.cjs"
        bundle = (
            WEB / "node_modules/.bin/esbuild",
            "--bundle",
            "--platform=node",
            "--loader=ts",
            f"--outfile={program}",
        )
        subprocess.run([*bundle, "--log-level=error"], input=CLIENT, text=True, cwd=WEB, check=True)
        subprocess.run(["node", program, folder], check=True)
        return [np.fromfile(folder / f"{k}.rows", np.uint32) for k in range(len(asked))]


def psnr(picture: np.ndarray, other: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((np.clip(picture, 0, 1) - np.clip(other, 0, 1)) ** 2)))


def study(scene: Path, up: np.ndarray, shares: Sequence[float]) -> None:
    gaussians = read_gaussians(scene)
    count, views = len(gaussians), cameras(gaussians, up)
    order = np.argsort(-significance(gaussians), kind="stable")
    limits = [int(share * count) for share in shares]
    looks = chosen(shown_of(gaussians, count), order, views, limits)
    scores = np.zeros((2, len(views), len(limits)))
    for v, view in enumerate(views):
        whole = render(gaussians, view).rgb
        for k, limit in enumerate(limits):
            for rule, rows in enumerate((np.arange(limit), looks[v * len(limits) + k])):
                part = gaussians.subset(np.sort(order[rows]))
                scores[rule, v, k] = psnr(render(part, view).rgb, whole)
    print(
        f"{scene.name}, {count:,} Gaussians, drawn of them {', '.join(f'{share:.0%}' for share in shares)}: PSNR in dB"
    )
    for name, means in zip(("most significant of all", "what looks most significant"), scores.mean(1), strict=True):
        print(f"  {name:28}", *(f"{mean:5.1f}" for mean in means), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--up", default="+z")
    parser.add_argument("--shares", type=float, nargs="+", default=[0.05, 0.1, 0.2])
    given = parser.parse_args()
    for scene in given.scenes:
        study(scene, named_up(given.up), given.shares)


if __name__ == "__main__":
    main()
