"""The way of a verb from its arguments to the kernel: few functions, each in a room that is entered once."""

import sys
from itertools import groupby
from pathlib import Path
from types import FrameType

import pytest

import drsplat
from drsplat.cli import main
from toy_capture import write_toy_capture

HOME = Path(drsplat.__file__).parent
AROUND = {"kinds"}  # checks the arguments of a public call, and hands on
Stop = tuple[str, str]


def stop(frame: FrameType) -> Stop | None:
    """The module and the function of a frame of the package."""
    path, name = Path(frame.f_code.co_filename), frame.f_code.co_name
    if not path.is_relative_to(HOME) or name.startswith("<"):
        return None
    module = path.relative_to(HOME).with_suffix("").as_posix()
    return None if module in AROUND else (module, name)


def way(argv: list[str], kernel: str) -> list[Stop]:
    """The functions that are entered and not left again when a verb first calls a kernel."""
    found: list[Stop] = []

    def look(frame: FrameType | None, event: str, _: object) -> None:
        assert frame is not None
        at = stop(frame)
        if found or event != "call" or at is None or not (at[0].startswith("kernels/") and at[1] == kernel):
            return
        while frame is not None:
            found.extend(filter(None, [stop(frame)]))
            frame = frame.f_back

    sys.setprofile(look)
    try:
        code = main(argv)
    finally:
        sys.setprofile(None)
    assert code == 0
    return found[[name for _, name in found].index("main") :: -1] if found else []


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_toy_capture(tmp_path_factory.mktemp("way"))


def test_few_functions_lie_between_the_arguments_and_the_kernel(
    capture: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, field = str(capture / "scene.ply"), str(capture / "room.field")
    options = ["--features", str(capture / "capture/language_features"), "--encoder-name", "drsplat-words"]
    register = ["register", scene, str(capture / "capture"), *options, "--output", field, "--code", "pq", "--json"]
    locate = ["locate", field, "red mug", "--scene", scene, "--json"]
    for argv, kernel in ((register, "view_weights"), (locate, "scan_scores")):
        stops = way(argv, kernel)
        rooms = [module.partition("/")[0] for module, _ in stops]
        assert stops[0] == ("cli", "main")
        assert stops[-1][1] == kernel
        assert len(set(stops)) == len(stops) <= 10
        entered = [room for room, _ in groupby(rooms)]
        assert len(set(entered)) == len(entered) <= 6, entered
    capsys.readouterr()
