"""Run every command of README and docs/, each page in a folder of its own, and print what ran.

usage: python -m scripts.docs_commands [--demo DIR] [PAGE...]

A page's folder has what `drsplat demo` writes, its photos as photos/, and a toy scene, its capture and texts under the
names that pages have for a reader's own. Real code with small random weights answers to CLIP's name, colours stand in
for SAM, training is cut short. Services are started, asked and stopped.
"""

import argparse
import contextlib
import io
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import traceback
import urllib.error
import urllib.request
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest import mock

from scripts.docs_blocks import PAGES, ROOT, Piece, pieces
from scripts.docs_not_run import Reason, reason

sys.path[:0] = [str(ROOT / "tests/support")]

CLIP = "laion/CLIP-ViT-B-16-laion2B-s34B-b88K"
UNTRAINED = {"docs/tour.md", "docs/embedding.md", "docs/neighbours.md"}
"""Pages whose capture has no features yet: they are embedded there."""
BARE = {"docs/capture.md", "docs/photograph.md", "docs/training.md"}
"""Pages that make a capture or a model of their own, which must not be there yet."""
MADE_THERE = {
    "docs/tutorials/scene_and_features.md": ("scene.field",),
    "docs/tutorials/without_a_model.md": ("scene.field", "capture/language_features"),
}
"""What a reader has already on other pages, and a page makes."""
SHORT = {"train": ["--iterations", "30"], "scan": ["--iterations", "60", "--segmenter", "graph"]}
"""What is added to a verb that takes minutes."""
UNTAUGHT = {"when": ["--threshold", "-1"], "edit": ["--threshold", "-1"]}
"""What is added where an encoder with random weights would find nothing."""
NUM_PHOTOS = 30  # of the demo's 48, whose pairs are matched in 2.5 times less time
LASTING = {"view": 8080, "serve": 8765}
"""Services, and the ports that pages name."""
OTHERS = ("colmap", "ns-export", "blender", "curl", "openssl")
"""Programs of others that pages call."""


@dataclass(frozen=True)
class Outcome:
    piece: Piece
    state: str  # "run", "not run", "failed"
    why: str = ""
    seconds: float = 0.0


@dataclass
class Place:
    """A folder in which a page's commands run, with the services that they have started."""

    folder: Path
    names: dict[str, Any] = field(default_factory=lambda: {"__name__": "page"})
    added: dict[str, list[str]] = field(default_factory=dict)
    said: str = ""
    services: dict[int, tuple[subprocess.Popen[str], int]] = field(default_factory=dict)

    def run(self, piece: Piece) -> Outcome:
        """Run a command. What it prints is kept; a failure is an outcome, not an error."""
        begun = time.monotonic()
        fault, absent = self._fault(piece)
        state = "not run" if absent else "failed" if fault else "run"
        return Outcome(piece, state, absent or fault, time.monotonic() - begun)

    def _fault(self, piece: Piece) -> tuple[str, str]:
        """What went wrong, and what is not installed here, as far as either is."""
        if piece.language == "python":
            return self._python(piece), ""
        words = piece.words
        if words[0] in OTHERS and shutil.which(words[0]) is None:
            return "", f"needs {words[0]}, which is not on this machine"
        if words[0] == "drsplat" and not {"|", ">"} & set(words):
            return self._drsplat(words[1:])
        return self._shell(piece), ""

    def _drsplat(self, words: list[str]) -> tuple[str, str]:
        if words[0] == "demo":
            # made once for all pages
            return "" if (self.folder / "drsplat-demo/room.field").exists() else "no demo", ""
        if words[0] == "mcp":
            return self._greeted(words), ""
        if words[0] in LASTING and "--export" not in words:
            return self._served(words), ""
        from drsplat.cli import main

        printed, told = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(told):
            code = main([*words, *SHORT.get(words[0], []), *(self.added.get(words[0], []))])
        self.said += printed.getvalue()
        message = told.getvalue().strip().splitlines()[-1:]
        if code and "pip install" in told.getvalue():
            return "", f"needs an extra: {message[0]}"
        return ("", "") if not code else (f"exit {code}: {' '.join(message)}", "")

    def _python(self, piece: Piece) -> str:
        code = self._at_ports(piece.text)
        printed = io.StringIO()
        try:
            with contextlib.redirect_stdout(printed), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                exec(compile("\n" * (piece.line - 1) + code, piece.page, "exec"), self.names)
        except Exception as error:  # whatever a page's code raises
            last = traceback.extract_tb(error.__traceback__)[-1]
            return f"{type(error).__name__}: {error} ({last.filename}:{last.lineno})"
        self.said += printed.getvalue()
        return ""

    def _shell(self, piece: Piece) -> str:
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        text = self._at_ports(piece.text).replace("curl -s ", "curl -sf ")  # which fails where it is refused
        done = subprocess.run(
            ["bash", "-euc", text], cwd=self.folder, capture_output=True, text=True, check=False, timeout=300,
            env={**os.environ, "PATH": path, "HOME": str(self.folder)},
        )  # fmt: skip
        self.said += done.stdout
        return "" if done.returncode == 0 else f"exit {done.returncode}: {done.stderr.strip()[-200:]}"

    def _at_ports(self, text: str) -> str:
        for port, (_, own) in self.services.items():
            text = text.replace(f"localhost:{port}", f"127.0.0.1:{own}")
        return text

    def _served(self, words: list[str]) -> str:
        """Start a service, and ask it. It stays until the page ends or starts another."""
        named = LASTING[words[0]]
        self.stop(named)
        own = free_port()
        service = self._started([*words, "--port", str(own)])
        self.services[named] = service, own
        assert service.stdout is not None
        line = service.stdout.readline()
        address = re.search(r"http://\S+:\d+(?:/scenes)?", line)
        if not address:
            return f"no address: {line}"
        return asked(address[0])

    def _greeted(self, words: list[str]) -> str:
        with self._started(words) as service:
            said, _ = service.communicate(json.dumps(HELLO) + "\n", timeout=60)
        name = json.loads(said.splitlines()[0])["result"]["serverInfo"]["name"]
        return "" if "drsplat" in name else f"answered as {name}"

    def _started(self, words: list[str]) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-m", "drsplat", *words], cwd=self.folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, text=True,
        )  # fmt: skip

    def stop(self, *ports: int) -> None:
        """Interrupt services. Raises: AssertionError: one ended otherwise."""
        for port in ports or tuple(self.services):
            service, _ = self.services.pop(port, (None, 0))
            if service is None:
                continue
            service.send_signal(signal.SIGINT)
            try:
                assert service.wait(60) in (0, 130), f"the service of {port} ended with {service.returncode}"
            finally:
                service.kill()
                for pipe in (service.stdin, service.stdout):
                    assert pipe is not None
                    pipe.close()


HELLO = {
    "jsonrpc": "2.0", "id": 1, "method": "initialize",
    "params": {"protocolVersion": "2025-03-26", "capabilities": {}, "clientInfo": {"name": "docs", "version": "1"}},
}  # fmt: skip


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


def asked(address: str) -> str:
    """Ask a service for its first page; it says where it is a moment before it listens. Returns what is wrong."""
    for _ in range(100):
        try:
            with urllib.request.urlopen(address, timeout=60) as answer:
                return "" if answer.read() else "an empty answer"
        except urllib.error.HTTPError as refused:
            return "" if refused.code == 401 else str(refused)  # it asks for its key
        except urllib.error.URLError:
            time.sleep(0.2)
    return f"nobody answers at {address}"


def furnish(folder: Path, page: str, demo: Path) -> None:
    """Put into a folder what a page's commands begin with."""
    from toured import write_lerf, write_own, write_peers, write_tour

    shutil.copytree(demo, folder / "drsplat-demo")
    (folder / "photos").mkdir()
    for photo in sorted((folder / "drsplat-demo/images").iterdir())[:NUM_PHOTOS]:
        shutil.copy(photo, folder / "photos")
    if page in BARE:
        return
    if page in UNTRAINED:
        write_tour(folder, CLIP)
        (folder / "room").symlink_to(folder / "capture")
    else:
        write_own(folder)
        for made in MADE_THERE.get(page, ()):
            shutil.rmtree(folder / made)
        write_lerf(folder)
        write_peers(folder)


def _stand_in() -> Callable[..., Any]:
    """Return what loads segmenters in place of the library: the built-in one, or colours for those of the hub."""
    from drsplat.photos.models.sam import load_segmenter
    from fake_models import ColorSegmenter, LargeSegmenter

    def load(name: str = "", device: str = "auto", settings: Any = None, **options: Any) -> Any:
        if name == "graph":
            return load_segmenter(name, device, settings, **options)
        return LargeSegmenter() if settings and settings.levels == ("large",) else ColorSegmenter()

    return load


@contextlib.contextmanager
def placed(page: str, demo: Path) -> Iterator[Place]:
    """A furnished folder to run a page in, with stand-ins for the models that are fetched."""
    before = Path.cwd()
    with tempfile.TemporaryDirectory(prefix="drsplat-docs-") as name, contextlib.ExitStack() as stack:
        place = Place(Path(name), added=UNTAUGHT if page in UNTRAINED else {})
        furnish(place.folder, page, demo)
        os.chdir(place.folder)
        stack.callback(os.chdir, before)
        stack.callback(place.stop)
        stack.enter_context(mock.patch("drsplat.photos.models.sam.load_segmenter", _stand_in()))
        yield place


def run_page(page: Path, place: Place) -> list[Outcome]:
    """Run a page's commands in order; those with a reason are not run, and the reason is checked."""
    return [_not_run(piece, why) if (why := reason(piece)) else place.run(piece) for piece in pieces(page)]


def _not_run(piece: Piece, why: Reason) -> Outcome:
    wrong = why.check(piece)
    return Outcome(piece, "failed" if wrong else "not run", wrong or why.text)


def table(outcomes: list[Outcome]) -> str:
    """Return the rows of all commands, and how many ran, did not run and failed."""
    lines = []
    for one in outcomes:
        first = one.piece.text.splitlines()[0][:70]
        lines.append(f"{one.piece.place:42} {one.state:8} {one.seconds:6.1f} s  {first}")
        if one.why:
            lines.append(f"{'':42} {one.why}")
    counts = Counter(one.state for one in outcomes)
    total = ", ".join(f"{state}: {counts[state]}" for state in ("run", "not run", "failed"))
    return "\n".join([*lines, f"{len(outcomes)} commands; {total}"])


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("pages", nargs="*", metavar="PAGE", help="such as docs/tasks.md (default: all)")
    parser.add_argument("--demo", type=Path, metavar="DIR", help="what `drsplat demo` has written (default: make it)")
    given = parser.parse_args(arguments)
    wanted = [page for page in PAGES if not given.pages or page.relative_to(ROOT).as_posix() in given.pages]
    outcomes = []
    with tempfile.TemporaryDirectory(prefix="drsplat-demo-") as folder:
        demo = given.demo.resolve() if given.demo else made_demo(Path(folder) / "drsplat-demo")
        for page in wanted:
            if pieces(page):
                with placed(page.relative_to(ROOT).as_posix(), demo) as place:
                    done = run_page(page, place)
                outcomes += done
                print(table(done).rpartition("\n")[0], flush=True)
    print(table(outcomes).rpartition("\n")[2])
    return int(any(one.state == "failed" for one in outcomes))


def made_demo(folder: Path) -> Path:
    """Run `drsplat demo`. Raises: RuntimeError: it failed."""
    from drsplat.cli import main as drsplat

    with contextlib.redirect_stdout(io.StringIO()):
        if drsplat(["demo", "--output-dir", str(folder)]):
            raise RuntimeError("drsplat demo failed")
    return folder


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
