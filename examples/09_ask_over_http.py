"""Ask a scene over HTTP, as programs in any language can; this one starts and stops the service, too.

Needs `pip install ".[serve]"` and a folder with a field and its scene, such as `drsplat demo` writes. Usage:
python examples/09_ask_over_http.py [FOLDER WORDS PORT]
"""

import json
import subprocess
import sys
import time
from pathlib import Path
from urllib.error import HTTPError, URLError
from urllib.parse import quote
from urllib.request import Request, urlopen


# %% A question is a GET, or a POST with JSON
def fetch(address: str, **query: object) -> bytes:
    body = json.dumps(query).encode() if query else None  # with a body it is a POST
    while True:
        try:
            return bytes(urlopen(Request(address, body, {"content-type": "application/json"})).read())
        except HTTPError as error:
            if error.code != 503:
                raise
            error.close()
            time.sleep(int(error.headers["retry-after"]))  # too busy, or too slow this time: it says when to come again


def main(folder: str = "drsplat-demo", words: str = "red vase", port: str = "8765") -> None:
    # %% The service is started, asked where its scene has such a thing, and stopped.
    service = subprocess.Popen([sys.executable, "-m", "drsplat", "serve", folder, "--port", port])
    address, scenes = f"http://127.0.0.1:{port}/scenes", b""
    try:
        while not scenes and service.poll() is None:
            try:
                scenes = fetch(address)
            except URLError:  # it does not listen yet
                time.sleep(0.2)
        scene = f"{address}/{quote(json.loads(scenes)['scenes'][0]['name'])}"
        print(json.dumps(json.loads(fetch(f"{scene}/locate", text=words)), indent=1))
        Path("found_over_http.png").write_bytes(fetch(f"{scene}/picture", text=words))
    finally:
        service.terminate()
        service.wait()


if __name__ == "__main__":
    main(*sys.argv[1:])
