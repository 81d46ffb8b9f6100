"""Schema of queries: each field of a `Query` once, for the command line, HTTP, MCP and the viewer.

Fronts make their options, models, arguments and messages of these rows, and read values by their kind: a front has a
row for each kind, none for a field. `tests/fronts/test_schema.py` holds the fronts and `Query` to it. The command line
reads this module before NumPy, so it imports nothing heavy.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

from .defaults import AUTO, NEVER

Kind = Literal[
    "text", "texts", "negatives", "vector", "picture", "point", "pixel", "threshold", "share", "flag", "span", "choice"
]


class Place(StrEnum):
    """Front, or sort of query, that offers fields.

    CATALOGUE: queries to many scenes. WORDS: queries that are texts beside something else, such as two and a relation.
    """

    COMMAND_LINE = "command line"
    HTTP = "http"
    MCP = "mcp"
    VIEWER = "viewer"
    CATALOGUE = "catalogue"
    WORDS = "words"


PROGRAMS = (Place.COMMAND_LINE, Place.HTTP)
FRONTS = (*PROGRAMS, Place.MCP, Place.VIEWER)


@dataclass(frozen=True)
class QueryField:
    """Field of a `Query`.

    kind: what its values are. value: a value as messages and help spell it. meaning: the help of every front, without
    words of one. places: the fronts that offer it, and in which sorts of queries. most: texts at most. choices: all
    values that there are. group: fields of one group exclude each other. default: value where it is left out.
    """

    name: str
    kind: Kind
    value: str
    meaning: str
    places: tuple[Place, ...] = PROGRAMS
    default: object = None
    most: int = 1
    choices: tuple[str, ...] = ()
    group: str = ""


SUBJECTS = (
    QueryField(
        "text", "text", "WORDS", "query in words; 'mug, not red' excludes what 'red mug' fits as well",
        (*FRONTS, Place.CATALOGUE),
    ),
    QueryField("vector", "vector", "VECTOR", "embedding to search for instead of words", (*PROGRAMS, Place.CATALOGUE)),
    QueryField(
        "image", "picture", "PICTURE",
        "picture to search for instead of words; best cut out, on black or transparent, like masks",
        (*PROGRAMS, Place.CATALOGUE),
    ),
    QueryField(
        "point", "point", "X,Y,Z", "point of the world to search for more of, in scene units; needs no encoder"
    ),
    QueryField("click", "pixel", "VIEW:X,Y", "pixel of a photo to search for more of; needs no encoder"),
)  # fmt: skip
"""Subjects of a query, which has exactly one."""

EXCLUDE = QueryField(
    "exclude", "texts", "WORDS", "words to exclude, as ', not WORDS' in the text does", (*PROGRAMS, Place.CATALOGUE),
    default=(), most=16,
)  # fmt: skip

CUT = (
    QueryField(
        "threshold", "threshold", "T|auto",
        "select scores above this (default: auto, where words must fit better than a list of words or, with a "
        "built-in encoder, exceed its own threshold)",
        (*PROGRAMS, Place.CATALOGUE, Place.WORDS), group="cut",
    ),
    QueryField(
        "top_share", "share", "S",
        "select this share of the Gaussians with a feature, e.g. 0.02, whatever their scores", group="cut",
    ),
    QueryField(
        "relevancy", "flag", "True",
        "measure LERF's relevancy instead of cosine: how much better the query fits than any negative; 0.5 is a tie",
        default=False,
    ),
    QueryField(
        "negatives", "negatives", "WORDS",
        "texts to measure relevancy against; implies relevancy (default: those stored in the field, else object, "
        "things, stuff, texture)", most=32,
    ),
    QueryField(
        "during", "span", "START END",
        "start and end of a time span of a moving scene: search only what its photos in this span show (default: all "
        "times)", FRONTS,
    ),
    QueryField(
        "objects", "choice", "auto|never",
        "auto: select whole objects if the field has them; never: select single Gaussians (default: "
        "auto)", (*PROGRAMS, Place.MCP, Place.WORDS), AUTO, choices=(AUTO, NEVER),
    ),
    QueryField(
        "present", "flag", "True",
        "find the best place of an object that is known to be there, even where other words fit better",
        (*FRONTS, Place.WORDS), default=False,
    ),
)  # fmt: skip
"""How scores are measured and cut."""

FIELDS = (*SUBJECTS, EXCLUDE, *CUT)


def fields(*places: Place, of: Sequence[QueryField] = FIELDS) -> list[QueryField]:
    """Return the fields that are offered in all of some places."""
    return [field for field in of if {*places} <= {*field.places}]
