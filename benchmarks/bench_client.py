"""How fast the client draws without a graphics card, beside Spark in the same run: the reason to draw by ourselves.

    npm install --prefix tests/foreign
    python benchmarks/bench_client.py SCENE.ply PAGE.html [--turns 3] [--seconds 12] [--chromium PROGRAM]

PAGE.html: a page of SCENE.ply, as `drsplat view --export` writes it. Each picture is of all Gaussians, 900 x 640
pixels, while the camera turns: Spark on WebGL in software, the client's own shaders there, and its rasteriser, which is
what it takes where no card is found. Then what each draws while somebody moves: Spark by its own levels of detail, of
as many splats as the client draws then, and the client's rasteriser, coarser and with the least significant Gaussians
left out. Needs playwright and a Chromium.
"""

import argparse
import functools
import http.server
import json
import shutil
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

from playwright.sync_api import sync_playwright

ROOT = Path(__file__).resolve().parent.parent
SIZE, PANEL, PATIENCE_MS = (900, 640), 372, 300_000
MOVING_SPLATS = 20_000  # what the client's rasteriser draws of 100,000 while the camera moves
SOFTWARE = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
CARD = (
    "WebGL2RenderingContext.prototype.getExtension = () => null; const own = WebGL2RenderingContext.prototype;"
    "const get = own.getParameter; own.getParameter = function (what) {"
    " return what === 7937 ? 'a card' : get.call(this, what); };"
)
TURN = "() => { drsplat.camera.fly(() => { drsplat.camera.yaw += 0.02; return false; }); }"
ALL = (
    "() => { drsplat.stage.pace = () => {};"
    " Object.defineProperty(drsplat.stage, 'share', { get: () => 1, set() {} }); }"
)
SPARK = """<!doctype html>
<style>body { margin: 0 }</style>
<script type="importmap">{"imports": {
"three": "/node_modules/three/build/three.module.js", "three/addons/": "/node_modules/three/examples/jsm/",
"@sparkjsdev/spark": "/node_modules/@sparkjsdev/spark/dist/spark.module.js"}}</script><script type="module">
import { SparkRenderer, SplatMesh } from "@sparkjsdev/spark"; import * as THREE from "three";
const renderer = new THREE.WebGLRenderer({ antialias: false }), scene = new THREE.Scene();
renderer.setSize(innerWidth, innerHeight); document.body.append(renderer.domElement);
const camera = new THREE.PerspectiveCamera(55, innerWidth / innerHeight, 0.05, 100); camera.up.set(0, 0, 1);
const count = Number(new URLSearchParams(location.search).get("lod")) || undefined;
const splats = new SplatMesh({ url: "/scene.ply", lod: count !== undefined });
scene.add(new SparkRenderer({ renderer, lodSplatCount: count }), splats);
await splats.initialized; window.frames_ = 0; let turn = 0;
renderer.setAnimationLoop(() => { turn += 0.02; camera.position.set(2 * Math.cos(turn), 2 * Math.sin(turn), 1.6);
camera.lookAt(0, 0, 0.6); renderer.render(scene, camera); window.frames_ += 1; });
</script>"""


class Files(http.server.SimpleHTTPRequestHandler):
    """The packages of tests/foreign, the scene and the page."""

    scene: Path
    page: Path

    def do_GET(self) -> None:
        own = {"/scene.ply": self.scene, "/page.html": self.page}
        is_spark = self.path.partition("?")[0] == "/spark.html"
        if is_spark or self.path in own:
            body = SPARK.encode() if is_spark else own[self.path].read_bytes()
            self.send_response(200)
            self.send_header("content-type", "text/html" if "html" in self.path else "application/octet-stream")
            self.end_headers()
            self.wfile.write(body)
        else:
            super().do_GET()

    def log_message(self, *_: Any) -> None:
        pass


@contextmanager
def served(scene: Path, page: Path) -> Iterator[str]:
    handler = type("Handler", (Files,), {"scene": scene, "page": page})
    server = http.server.ThreadingHTTPServer(
        ("127.0.0.1", 0), functools.partial(handler, directory=str(ROOT / "tests/foreign"))
    )
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()


def rate(page: Any, counter: str, seconds: float) -> float:
    """Return the pictures a second, after what the first ones cost."""
    page.wait_for_function(f"() => {counter} > 1")
    begin, first = time.perf_counter(), page.evaluate(f"() => {counter}")
    page.wait_for_timeout(1000 * seconds)
    while page.evaluate(f"() => {counter}") < first + 2:
        page.wait_for_timeout(500)
    return float((page.evaluate(f"() => {counter}") - first) / (time.perf_counter() - begin))


def client(opened: Any, address: str, seconds: float, card: bool, every: bool) -> float:
    page = opened.new_page(viewport={"width": SIZE[0] + PANEL, "height": SIZE[1]})
    page.set_default_timeout(PATIENCE_MS)
    if card:
        page.add_init_script(CARD)
    page.goto(f"{address}/page.html")
    page.wait_for_function("() => window.drsplat && drsplat.stage.frames > 0")
    if every:
        page.evaluate(ALL)
    page.evaluate(TURN)
    found = rate(page, "drsplat.stage.frames", seconds)
    page.close()
    return found


def spark(opened: Any, address: str, seconds: float, splats: int = 0) -> float:
    page = opened.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
    page.set_default_timeout(PATIENCE_MS)
    page.goto(f"{address}/spark.html?lod={splats}")
    found = rate(page, "(window.frames_ ?? 0)", seconds)
    page.close()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("page", type=Path)
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=12)
    parser.add_argument("--chromium", default=shutil.which("chromium"))
    given = parser.parse_args()
    rates: dict[str, list[float]] = {}
    with sync_playwright() as driver, served(given.scene, given.page) as address:
        opened = driver.chromium.launch(executable_path=given.chromium, args=SOFTWARE)
        for _ in range(given.turns):
            for name, run in {
                "Spark, WebGL in software": lambda: spark(opened, address, given.seconds),
                "client's shaders, WebGL in software": lambda: client(opened, address, given.seconds, True, True),
                "client's rasteriser": lambda: client(opened, address, given.seconds, False, True),
                "Spark's levels of detail": lambda: spark(opened, address, given.seconds, MOVING_SPLATS),
                "client's rasteriser, while moved": lambda: client(opened, address, given.seconds, False, False),
            }.items():
                rates.setdefault(name, []).append(run())
        opened.close()
    package = ROOT / "tests/foreign/node_modules/@sparkjsdev/spark/dist/spark.module.min.js"
    own = ROOT / "src/drsplat/fronts/viewing/client.js"
    for file in (package, own):
        print(f"{file.name}: {file.stat().st_size / 1e6:.2f} MB")
    base = median(rates["Spark, WebGL in software"])
    for name, found in rates.items():
        print(f"{name:38} {median(found):6.2f} pictures a second ({median(found) / base:5.1f} times Spark), {found}")
    print(json.dumps({name: median(found) for name, found in rates.items()}))


if __name__ == "__main__":
    main()
