"""The way of a verb from its arguments to the kernel: few functions, in few rooms."""

import sys
from pathlib import Path
from types import FrameType

import drsplat
from drsplat.cli import main

HOME = Path(drsplat.__file__).parent
AROUND = {"base/kinds", "errors", "base/terminal", "base/progress"}  # hands on, and says
PLAIN = {"__init__", "__post_init__", "__len__", "__iter__", "__getattr__"}  # makes or counts a value
OPTIMISED = 0x1  # the bodies of modules and classes are not
Stop = tuple[str, str]


def stop(frame: FrameType) -> Stop | None:
    """The module and the function of a frame of the package."""
    path, name = Path(frame.f_code.co_filename), frame.f_code.co_name
    if not path.is_relative_to(HOME) or name.startswith("<") or name in PLAIN or not frame.f_code.co_flags & OPTIMISED:
        return None
    module = path.relative_to(HOME).with_suffix("").as_posix()
    return None if module in AROUND else (module, name)


def caller(frame: FrameType | None) -> FrameType | None:
    """The function of the package that called; None of what runs while a module is imported."""
    while frame is not None and stop(frame) is None:
        frame = None if frame.f_code.co_name == "<module>" else frame.f_back
    return frame


def way(argv: list[str], kernel: str) -> list[Stop]:
    """What the functions that end in a verb's first call of a kernel call in other modules, in order."""
    calls: list[tuple[FrameType, Stop]] = []
    ending: list[FrameType] = []

    def look(frame: FrameType, event: str, _: object) -> None:
        at = None if ending or event != "call" else stop(frame)
        above = None if at is None else caller(frame.f_back)
        if at is None or above is None:
            return
        calls.append((above, at))
        if at[0].startswith("kernels/") and at[1] == kernel:
            while above is not None:
                ending.append(above)
                above = caller(above.f_back)

    sys.setprofile(look)
    try:
        code = main(argv)
    finally:
        sys.setprofile(None)
    assert code == 0
    called = [(stop(above), at) for above, at in calls if any(above is one for one in ending)]
    verb = f"fronts/commands/{argv[0]}"  # before it runs, all verbs add their options
    first = next(number for number, (_, at) in enumerate(called) if at == (verb, "run"))
    return list(dict.fromkeys(at for above, at in called[first:] if above and above[0] != at[0]))


def test_few_functions_lie_between_the_arguments_and_the_kernel(room, capsys):
    features = f"--features {room}/capture/language_features --encoder-name drsplat-words"
    register = f"register {room}/scene.ply {room}/capture {features} --output {room}/new.field --code pq --json"
    locate = f"locate {room}/new.field mug --scene {room}/scene.ply --json"
    for line, kernel, most in ((register, "view_weights", 12), (locate, "scan_scores", 10)):
        stops = way(line.split(), kernel)
        assert stops[-1][1] == kernel
        assert len(stops) <= most, stops
        assert len({module.partition("/")[0] for module, _ in stops}) <= 6, stops
    capsys.readouterr()
