"""When photos were taken: from a transforms.json, by a pattern of names, from a table; and nothing is guessed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drsplat import View, read_views
from drsplat.errors import FormatError
from drsplat.formats.captures import with_times
from refusing import malformed, refused
from scenes import look_at_view
from written_captures import transforms_document, write_json, write_photos

NAMES = ("cam00/frame_0012.png", "cam00/frame_0013.png", "cam01/frame_0012.png")


def named(*names: str) -> list[View]:
    return [replace(look_at_view((3, 0, 1)), name=name) for name in names]


@pytest.mark.parametrize(
    ("pattern", "names", "times"),
    [
        ("cam*/frame_{time}.png", NAMES, [12, 13, 12]),
        ("cam*/frame_{time}", NAMES, [12, 13, 12]),
        ("*_{time}.png", ("a_0.25.png", "b_1.png"), [0.25, 1]),
        ("t{time}_cam*.jpg", ("t003_cam1.jpg", "t010_cam12.jpg"), [3, 10]),
    ],
)
def test_a_pattern_says_where_the_time_is(pattern, names, times):
    assert [view.time for view in with_times(named(*names), pattern)] == times


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        ("frame_{time}.png", "3 of 3 views have no time"),  # a folder in front is not guessed away
        ("cam00/frame_{time}.png", "1 of 3 views have no time by .*: cam01/frame_0012.png"),
        ("frame_*.png", "expected a table NAME.csv, or a pattern"),
        ("{time}/{time}", "once in"),
    ],
)
def test_names_that_do_not_fit_are_told(pattern, message):
    with refused(message):
        with_times(named(*NAMES), pattern)


def test_a_table_names_photos_with_or_without_suffix(tmp_path):
    table = tmp_path / "times.csv"
    table.write_text("name,time\ncam00/frame_0012.png,0.5\ncam00/frame_0013,1.5\ncam01/frame_0012,-2\n")
    assert [view.time for view in with_times(named(*NAMES), table)] == [0.5, 1.5, -2]
    table.write_text("name,time\ncam00/frame_0012.png,0.5\n")
    with refused("2 of 3 views have no time"):
        with_times(named(*NAMES), table)


@pytest.mark.parametrize(
    "text",
    ["", "name;time\n", "a,1\n", "name,time\na\n", "name,time\na,x\n", "name,time\na,nan\n", "name,time\na,1\na,2\n",
     "name,time\na,1,2\n", "name,time\na,1e999\n", 'name,time\n"a,1\n'],
)  # fmt: skip
def test_damaged_tables(tmp_path, text):
    table = tmp_path / "times.csv"
    table.write_text(text)
    with pytest.raises(FormatError):
        with_times(named("a.png"), table)
    table.write_bytes(b"name,time\n\xff\xfe,1\n")
    with malformed("UTF-8"):
        with_times(named("a.png"), table)
    with refused("no such file"):
        with_times(named("a.png"), tmp_path / "none.csv")


def test_transforms_json_has_times_of_frames(tmp_path):
    write_photos(tmp_path / "images")
    document = transforms_document()
    for number, frame in enumerate(document["frames"]):
        frame["time"] = number / 4
    document["time"] = 7.0  # of no frame
    del document["frames"][1]["time"]
    write_json(tmp_path / "transforms.json", document)
    by_name = {Path(frame["file_path"]).name: frame.get("time") for frame in document["frames"]}
    assert {Path(view.name).name: view.time for view in read_views(tmp_path)} == by_name
    assert None in by_name.values()
    document["frames"][0]["time"] = "soon"
    write_json(tmp_path / "transforms.json", document)
    with malformed("time: expected a"):
        read_views(tmp_path)


def test_times_that_are_given_take_the_place_of_those_of_the_file(tmp_path):
    write_photos(tmp_path / "images")
    document = transforms_document()
    for frame in document["frames"]:
        frame["time"] = 9.0
    write_json(tmp_path / "transforms.json", document)
    names = [view.name for view in read_views(tmp_path)]
    table = tmp_path / "times.csv"
    table.write_text("name,time\n" + "".join(f"{name},{number}\n" for number, name in enumerate(names)))
    assert [view.time for view in read_views(tmp_path, times=table)] == list(range(len(names)))
    assert read_views(tmp_path, max_side=32, times=table)[1].time == 1


@pytest.mark.parametrize("time", [np.nan, np.inf])
def test_a_time_is_finite(time):
    with refused("expected a finite time"):
        replace(look_at_view((3, 0, 1)), time=time)
