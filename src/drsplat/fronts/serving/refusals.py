"""Requests of the wrong shape, in words for whoever sent them."""

from collections.abc import Mapping, Sequence
from typing import Any

MAX_FAULTS, MAX_CHARACTERS = 5, 1000
_FAULT_TEXTS = {"extra_forbidden": "there is no such field; /openapi.json lists those there are"}


def faults_of(errors: Sequence[Mapping[str, Any]], worded: Mapping[str, str] = _FAULT_TEXTS) -> str:
    """Return where each fault that pydantic found is, and what was expected there; no values, which may be large.

    worded: what is said instead of pydantic's words, by its names of faults.
    """
    faults = [f"{'.'.join(map(str, fault['loc']))}: {worded.get(fault['type'], fault['msg'])}" for fault in errors]
    return "; ".join(faults[:MAX_FAULTS])[:MAX_CHARACTERS]
