"""Answers have the same bytes at any number of threads, those of NumPy's library included."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ASKING = """
import sys
from drsplat.cli import main

folder, threads = sys.argv[1:]
texts = ("wooden table", "red vase", "something blue", "lamp, not red", "orange sofa", "floor")
queries = [(verb, folder, text) for verb in ("locate", "select") for text in texts]
queries += [("segment", folder, "--classes", "table,vase,floor,lamp"), ("objects", folder, "--all")]
queries += [("select", folder, "red vase", "--relevancy"), ("locate", folder, "wooden table", "--threshold", "auto")]
for query in queries:
    assert main([*query, "--json", "--threads", threads]) == 0  # the first one says so to NumPy's library, too

from drsplat.query import open_scene
from drsplat.query.regions import region
from drsplat.query.relations import RELATIONS, related

scene = open_scene(folder, threads=int(threads))
table = scene.locate("wooden table")[0]
for relation in RELATIONS[:4]:
    print(relation, [one.object_id for one in related(scene.rows, relation, scene.objects[:12], table, up=scene.up)])
print(scene.what_is(tuple(table.center.tolist()), top=20))
print(region(scene, tuple(table.center.tolist()), 1.0))
"""


def answers(folder: Path, threads: int) -> list[str]:
    environment = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    command = [sys.executable, "-W", "ignore", "-c", ASKING, str(folder), str(threads)]
    return subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout.splitlines()


@pytest.mark.slow
def test_answers_are_the_same_at_any_number_of_threads(
    household_story, household_folder
):  # fmt: skip
    first = answers(household_folder, 1)
    assert len(first) >= 22
    for threads in (2, 3, 8):
        assert answers(household_folder, threads) == first
