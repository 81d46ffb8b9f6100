"""Words that `mini` knows, and the objects, colours and materials they stand for."""

import re
from collections.abc import Sequence
from pathlib import Path

NAMES = (
    "apple", "ball", "banana", "basket", "book", "bottle", "bowl", "box", "bread", "candle", "carrot",
    "chair", "clock", "cushion", "fork", "knife", "lamp", "laptop", "mug", "orange", "pan", "pear",
    "picture", "plant", "plate", "pot", "shelf", "sofa", "spoon", "stacking toy", "stool", "table",
    "teapot", "teddy bear", "toy car", "toy duck", "vase",
)  # fmt: skip
COLORS = ("black", "blue", "brown", "green", "grey", "orange", "pink", "purple", "red", "white", "yellow")
MATERIALS = (
    "cardboard", "ceramic", "fabric", "glass", "leather", "metal", "paper", "plastic", "plush",
    "rubber", "wax", "wicker", "wood",
)  # fmt: skip

STRUCTURES = ("floor", "rug", "wall", "window")
"""Parts of a room; their colours and materials are not taught."""

GROUPS: dict[str, tuple[str, ...]] = {
    "cup": ("mug",), "drink": ("mug", "bottle"), "coffee": ("mug",), "tea": ("mug", "teapot"), "kettle": ("teapot",),
    "crockery": ("mug", "bowl", "plate", "teapot"), "tableware": ("mug", "bowl", "plate", "teapot"),
    "dish": ("bowl", "plate"), "cutlery": ("fork", "knife", "spoon"), "cut": ("knife",), "cookware": ("pan", "pot"),
    "cook": ("pan", "pot"), "skillet": ("pan",), "saucepan": ("pot",),
    "food": ("apple", "banana", "bread", "carrot", "orange", "pear"),
    "eat": ("apple", "banana", "bread", "carrot", "orange", "pear"), "fruit": ("apple", "banana", "orange", "pear"),
    "vegetable": ("carrot",), "loaf": ("bread",), "furniture": ("chair", "shelf", "sofa", "stool", "table"),
    "seat": ("chair", "sofa", "stool"), "sit": ("chair", "sofa", "stool"), "couch": ("sofa",), "desk": ("table",),
    "bookcase": ("shelf",), "bookshelf": ("shelf",), "pillow": ("cushion",), "light": ("candle", "lamp"),
    "toy": ("ball", "stacking toy", "teddy bear", "toy car", "toy duck"),
    "play": ("ball", "stacking toy", "teddy bear", "toy car", "toy duck"), "teddy": ("teddy bear",),
    "bear": ("teddy bear",), "car": ("toy car",), "vehicle": ("toy car",), "duck": ("toy duck",),
    "stacking": ("stacking toy",), "ring": ("stacking toy",), "animal": ("teddy bear", "toy duck"),
    "computer": ("laptop",), "notebook": ("laptop",), "read": ("book",), "novel": ("book",), "time": ("clock",),
    "painting": ("picture",), "frame": ("picture",), "flower": ("vase", "plant"), "houseplant": ("plant",),
    "carton": ("box",), "ground": ("floor",), "carpet": ("rug",),
    "container": ("basket", "bottle", "bowl", "box", "pot", "vase"),
}  # fmt: skip
"""Words that stand for one or several names: synonyms, kinds, uses."""

ORANGE = "orange (colour)"
"""Name of the colour, which has a vector of its own; "orange" is the fruit."""
PAINTS = tuple(ORANGE if color == "orange" else color for color in COLORS)
"""Word of each of COLORS."""

TONES = {"gray": "grey", "violet": "purple", "golden": "yellow", "dark": "black", "rose": "pink"}
STUFFS = {
    "wooden": "wood", "cloth": "fabric", "textile": "fabric", "metallic": "metal", "steel": "metal",
    "porcelain": "ceramic", "woven": "wicker", "fluffy": "plush", "soft": "plush",
}  # fmt: skip
SYNONYMS = {
    word: name
    for name, words in {
        "sofa": "settee loveseat divan", "chair": "armchair rocker", "stool": "footstool barstool", "rug": "doormat",
        "bottle": "flask carafe", "plate": "saucer platter", "pot": "casserole stockpot", "pan": "wok frypan",
        "spoon": "teaspoon tablespoon ladle", "book": "paperback textbook tome", "lamp": "lantern nightlight",
        "picture": "photograph poster artwork print", "bread": "baguette toast bun", "ball": "football basketball",
        "orange": "tangerine mandarin clementine", "basket": "hamper", "candle": "candlestick", "vase": "urn",
        "mug": "beaker tankard", "clock": "alarm", "bear": "teddybear", "car": "automobile", "duck": "duckling",
        "shelf": "shelving", "box": "crate chest", "plush": "stuffed",
    }.items()
    for word in words.split()
}  # fmt: skip
"""Words that are read as one that was taught, of which the singular counts."""

ANYTHING = ("object", "thing", "stuff", "texture", "item")
"""Words that fit everything alike: LERF's negatives, and the noun of "a red thing"."""

IGNORED = frozenset(
    [
        "a", "an", "and", "any", "anything", "at", "by", "close", "color",
        "colored", "colour", "coloured", "find", "for", "from", "image", "in", "is", "it",
        "me", "my", "of", "on", "one", "ones", "or", "photo", "show", "some", "something", "that", "the", "this", "to",
        "up", "used", "where", "which", "with", "you", "your",
    ]
)  # fmt: skip

WORDS = tuple(
    sorted(
        {word for name in NAMES + STRUCTURES for word in name.split()}
        | {*PAINTS, *MATERIALS, *GROUPS, *TONES, *STUFFS, *ANYTHING}
    )
)
"""Rows of the text tower's table, in this order."""
_KNOWN = {*WORDS, *SYNONYMS}


def words_of(text: str) -> list[str]:
    """Return the meaningful words of a text, in singular; unknown ones are included.

    "orange" is the colour before another word, in "something orange", "the orange one" and "the colour orange", else
    the fruit.
    """
    spoken = re.findall(r"[^\W\d_]+", text.lower())
    counting = [(word, _singular(word)) for word in spoken if word not in IGNORED]
    painted = not {"something", "anything", "one", "ones", "color", "colour"}.isdisjoint(spoken)
    last = len(counting) - 1
    return [
        ORANGE if word == "orange" and (painted or at < last) else single for at, (word, single) in enumerate(counting)
    ]


def _singular(word: str) -> str:
    if word in WORDS:
        return word
    endings = [word[:-1], word[:-2], f"{word[:-3]}y", f"{word[:-3]}f", f"{word[:-3]}fe"]
    candidates = [word, *endings] if len(word) > 3 and word.endswith("s") else [word]
    single = next((one for one in candidates if one in _KNOWN), word)
    return SYNONYMS.get(single, single)


def nouns_in(text: str) -> list[str]:
    """Return the words that name an object or its material, without colours and "thing"."""
    return [word for word in words_of(text) if TONES.get(word, word) not in PAINTS and word not in ANYTHING]


def colors_in(text: str) -> list[str]:
    """Return those of COLORS that a text names, in its order: "violet" is purple, and "dark green" is green."""
    words = words_of(text)
    tones = [TONES.get(word, word) for word in words if word != "dark"]
    named = [COLORS[PAINTS.index(tone)] for tone in tones if tone in PAINTS]
    return named or [COLORS[PAINTS.index(TONES[word])] for word in words if word in TONES]


def from_other_language(words: Sequence[str]) -> tuple[str, str]:
    """Return a language in which words that were not taught mean some that were, and those: ("French", "red mug").

    Words of `words_of`; ("", "") if no language of languages.txt has all that are unknown. Of signs that are written
    without spaces, parts count.
    """
    for section in Path(__file__).with_name("languages.txt").read_text(encoding="utf-8").split("\n[")[1:]:
        language, *lines = section.splitlines()
        meaning = {word: line.split(":")[0] for line in lines for word in line.partition(":")[2].split()}
        signs = re.compile("|".join(sorted(meaning, key=len, reverse=True)))
        found = [[word] if word in _KNOWN or word in meaning else _signs(signs, word) for word in words]
        english = [meaning.get(word, word) for parts in found for word in parts]
        if all(found):
            english.sort(key=lambda word: word not in COLORS + MATERIALS)
            return language.rstrip("]"), " ".join(word for word in english if word not in IGNORED)
    return "", ""


def _signs(known: re.Pattern[str], word: str) -> list[str]:
    """Return the words that a run of signs without spaces consists of, [] if of letters or of others as well."""
    parts = known.findall(word)
    return parts if ord(word[0]) > 0x2E80 and "".join(parts) == word else []


def swapped(text: str) -> list[str]:
    """Return "blue mug", "red vase" ... of "red mug": all that has its colour or its thing, and not both.

    [] of a text that has not one colour and a thing.
    """
    nouns, colors = nouns_in(text), colors_in(text)
    if len(colors) != 1 or not nouns:
        return []
    names = [name for name in NAMES if any(fits(noun, name, "", "") is False for noun in nouns)]
    painted = [f"{color} {' '.join(nouns)}" for color in COLORS if color != colors[0]]
    return painted + [f"{colors[0]} {name}" for name in names]


def only_colors(text: str) -> bool:
    """Return whether a text asks for a colour and nothing else: "something red", "white", "a green thing"."""
    words = words_of(text)
    return not nouns_in(text) and any(word not in ANYTHING for word in words)


def fits(word: str, name: str, color: str, material: str) -> bool | None:
    """Return whether a word is true of an object; None where its colour or material is unknown ("")."""
    if word in ANYTHING or word in name.split() or name in GROUPS.get(word, ()):
        return True
    shade, stuff = TONES.get(word, word), STUFFS.get(word, word)
    if shade in PAINTS:
        return None if not color else color == COLORS[PAINTS.index(shade)]
    if stuff in MATERIALS:
        return None if not material else material == stuff
    return False
