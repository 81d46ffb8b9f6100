"""Write photos/models/kinds.txt: which names of the built-in list stand under which word in WordNet.

    python scripts/make_kinds.py WORDNET/data.noun WORDNET/index.noun

The files are those of WordNet 3.0 (Debian: wordnet-base). A word is a kind if one of its first two
senses has at least two names of the list below it. A name is meant in the sense that its bracket tells, else in its
first one that is a thing.
"""

import re
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "src"))

from drsplat.photos.models.word_list import broad_list

OUTPUT = Path(__file__).resolve().parent.parent / "src/drsplat/photos/models/kinds.txt"
THING = "00001930"  # physical entity
MOST = 120  # names of a kind: what has more is no word that anybody looks for
SENSES = 2
HEADER = """\
# Kinds of things and the names of the built-in list below them, made by scripts/make_kinds.py from WordNet 3.0.
# WordNet 3.0 Copyright 2006 by Princeton University. All rights reserved. Permission to use, copy, modify and
# distribute this software and database and its documentation for any purpose and without fee or royalty is hereby
# granted, provided that this notice appears on all copies. THIS SOFTWARE AND DATABASE IS PROVIDED "AS IS" AND PRINCETON
# UNIVERSITY MAKES NO REPRESENTATIONS OR WARRANTIES, EXPRESS OR IMPLIED.
"""


def read(data: Path, index: Path) -> tuple[dict[str, list[str]], dict[str, list[str]], dict[str, list[str]]]:
    """Words and kinds of each synset; synsets of each word, most frequent first."""
    words, above, senses = {}, {}, {}
    for line in data.read_text(encoding="latin-1").splitlines():
        if not line.startswith(" "):
            fields = line.split("|")[0].split()
            count = int(fields[3], 16)
            words[fields[0]] = [fields[4 + 2 * n].replace("_", " ").lower() for n in range(count)]
            at = 4 + 2 * count
            pointers = [fields[at + 1 + 4 * n : at + 5 + 4 * n] for n in range(int(fields[at]))]
            above[fields[0]] = [one[1] for one in pointers if one[0] in ("@", "@i") and one[2] == "n"]
    for line in index.read_text(encoding="latin-1").splitlines():
        if not line.startswith(" "):
            fields = line.split()
            senses[fields[0].replace("_", " ")] = fields[-int(fields[2]) :]
    return words, above, senses


def main() -> None:
    words, above, senses = read(Path(sys.argv[1]), Path(sys.argv[2]))

    def closure(synset: str) -> set[str]:
        return {synset}.union(*(closure(one) for one in above[synset]))

    def meant(name: str) -> str | None:
        plain, _, bracket = name.lower().partition("(")
        every = [one for one in senses.get(plain.strip(), ()) if THING in closure(one)]
        hint = set(re.findall(r"\w+", bracket))
        told = [one for one in every if hint & {word for s in closure(one) for word in words[s]}]
        return next(iter(told or ([] if hint else every)), None)

    below: dict[str, set[str]] = {}
    for name in broad_list():
        synset = meant(name)
        for kind in () if synset is None else closure(synset):
            below.setdefault(kind, set()).add(name)
    kinds: dict[str, set[str]] = {}
    for synset, names in below.items():
        for word in words[synset]:
            if synset in senses.get(word, ())[:SENSES] and len(names) <= MOST:
                kinds.setdefault(word, set()).update(names)
    lines = [f"{kind}: {', '.join(sorted(names))}" for kind, names in sorted(kinds.items()) if len(names - {kind}) >= 2]
    OUTPUT.write_text(HEADER + "\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
