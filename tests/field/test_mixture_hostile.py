"""Damaged and hostile mixture codes: sound objects or a precise error."""

from collections.abc import Callable

import numpy as np
import pytest

from drsplat.field.codes.mixture import encode_mixture, mixture_from_tensors
from drsplat.formats.tensors import map_tensors, write_tensors
from fields import random_evidence
from mutations import quota, seeded, survivors
from refusing import malformed

MUTANTS = quota(2_000)
QUERIES = np.eye(4, dtype=np.float32)
Arrays = dict[str, np.ndarray]


def tensors() -> Arrays:
    rng = np.random.default_rng(0)
    found = encode_mixture(random_evidence(rng, rows=70, columns=8, dim=4), 3, scene_atoms=2)
    return {name: array.copy() for name, array in found.tensors().items()}


def use(arrays: Arrays) -> None:
    """What a user would do with a code that was read."""
    code = mixture_from_tensors(arrays, "file")
    with np.errstate(all="ignore"):
        code.scores(QUERIES, threads=1)
        code.best(QUERIES, threads=1)
        code.select(QUERIES[0], 0.1, threads=1)
        code.top(QUERIES[0], 5, threads=1)
        code.decode(slice(None))
        if len(code):
            code.parts(0, QUERIES[0])


def put(name: str, index: object, value: object) -> Callable[[Arrays], None]:
    def change(arrays: Arrays) -> None:
        arrays[name][index] = value

    return change


def replaced(name: str, make: Callable[[np.ndarray], np.ndarray]) -> Callable[[Arrays], None]:
    def change(arrays: Arrays) -> None:
        arrays[name] = make(arrays[name])

    return change


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (put("mixture_ids", (0, 0, 0), 60_000), "atom 60000"),
        (put("mixture_ids", (1, 2, 63), 9999), "atom 9999"),  # in the padding: it is looked up too
        (put("mixture_scales", 5, np.nan), "finite"),
        (put("mixture_scales", 5, np.inf), "finite"),
        (put("mixture_scales", 5, -1), "not negative"),
        (put("atom_scales", 0, np.nan), "between 0 and 1"),
        (put("atom_scales", 0, -0.1), "between 0 and 1"),
        (put("atom_scales", 0, 1.5), "between 0 and 1"),
        (put("atom_segments", 0, -2), "mask -2"),
        (replaced("mixture_ids", lambda a: a[:1]), "mixture_weights"),
        (replaced("mixture_scales", lambda a: a[:60]), "for 60 rows"),
        (replaced("mixture_scales", lambda a: np.ones(10**6, a.dtype)), "for 1000000 rows"),
        (replaced("mixture_scales", lambda a: a.astype(np.float32)), "float16"),
        (replaced("mixture_weights", lambda a: a[:, :2]), "mixture_weights"),
        (replaced("atoms", lambda a: a[:2]), "atom_scales"),
        (replaced("atoms", lambda a: a.astype(np.int16)), "int8"),
        (replaced("atoms", lambda a: a[:, :0]), "one scale and one mask"),
    ],
)
def test_what_does_not_fit_is_refused(change, complaint):
    arrays = tensors()
    use(arrays)
    change(arrays)
    with malformed(complaint):
        use(arrays)


def test_blocks_of_another_size_or_too_many_atoms_per_row_are_refused():
    for per_row, rows in ((0, 64), (17, 64), (3, 32)):
        arrays = tensors()
        for name in ("mixture_ids", "mixture_weights"):
            arrays[name] = np.zeros((2, per_row, rows), arrays[name].dtype)
        with malformed("1 to 16"):
            use(arrays)


def test_no_atoms_and_too_many_are_refused():
    for count in (0, 65_537):
        arrays = tensors()
        for name in ("atoms", "atom_scales", "atom_segments"):
            arrays[name] = np.zeros((count, *arrays[name].shape[1:]), arrays[name].dtype)
        with malformed("65,536 atoms"):
            use(arrays)


def test_a_code_of_no_rows_is_one():
    arrays = tensors()
    for name in ("mixture_ids", "mixture_weights", "mixture_scales"):
        arrays[name] = arrays[name][:0]
    use(arrays)


def test_extreme_but_legal_numbers_are_searched():
    arrays = tensors()
    arrays["atoms"][:], arrays["atom_scales"][:] = -128, 1
    arrays["mixture_weights"][:], arrays["mixture_scales"][:] = 255, 65504
    use(arrays)


@pytest.mark.slow
def test_damaged_files(tmp_path, bounded_memory):
    def read(path):
        arrays = map_tensors(path)[0]
        if arrays.get("atoms", np.zeros((1, 4))).shape[-1:] == (4,):
            use(arrays)
        else:
            mixture_from_tensors(arrays, "file")

    write_tensors(tmp_path / "a", tensors())
    assert 0 < survivors(tmp_path / "a", read, seeded(1), MUTANTS) < MUTANTS
