"""Which words a query is contrasted with."""

from collections.abc import Collection, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from weakref import WeakKeyDictionary

import numpy as np

from ...base.arrays import Embeddings, Float32
from ...errors import InputError
from ...formats.vocabulary import VocabularyEncoder, spellings
from ...scene.encoders import Encoder

LARGEST_KIND = 40  # names that a kind has at most which says what a word means; "furniture" has 36
LARGEST_NEAR_KIND = 22  # the same of a kind whose names have to stand for each other
MAX_TEXTS = 2000  # of a vocabulary: more make a first question slow
_THINGS = """
apple, banana, orange, pear, lemon, grapes, strawberry, watermelon, tomato, carrot, potato, onion, pepper, cucumber,
lettuce, mushroom, bread, cake, cookie, cheese, egg, meat, fish, rice, noodles, soup, pizza, sandwich, salad, chocolate,
ice cream, coffee, tea, juice, milk, water, wine, beer,
cup, mug, glass, bowl, plate, pan, pot, kettle, teapot, jug, bottle, can, jar, spoon, fork, knife, chopsticks, tray,
cutting board, ladle, spatula, napkin, lid, basket, bucket, bin, box, carton, crate, bag, backpack, suitcase, purse,
stove, oven, microwave, refrigerator, dishwasher, toaster, blender, sink, faucet, bathtub, shower, toilet, towel, soap,
toothbrush, sponge, broom, mop, vacuum cleaner, washing machine, iron, hanger,
bed, mattress, pillow, blanket, quilt, sheet, crib, sofa, armchair, chair, stool, bench, table, desk, counter, shelf,
bookshelf, cabinet, wardrobe, dresser, drawer, nightstand, lamp, chandelier, candle, curtain, blinds, rug, carpet, mat,
cushion, mirror, picture, painting, poster, clock, vase, statue, fireplace, radiator, fan, heater,
window, door, doorway, handle, stairs, railing, ceiling, wall, floor, tiles, bricks, pipe, cable, socket, switch, sign,
computer, laptop, keyboard, mouse, monitor, television, printer, telephone, remote control, camera, speaker, headphones,
radio, tablet, projector, whiteboard, robot,
book, magazine, newspaper, paper, notebook, envelope, map, calendar, pen, pencil, ruler, scissors, tape, glue, stapler,
toy, doll, teddy bear, stuffed animal, puppet, action figure, ball, balloon, puzzle, playing cards, dice, toy blocks,
kite,
toy car, rubber duck, guitar, piano, violin, drum, trumpet,
shirt, dress, trousers, jacket, coat, sweater, skirt, sock, shoe, boot, sandal, hat, cap, helmet, glove, scarf, tie,
belt,
glasses, sunglasses, watch, ring, necklace, umbrella, wallet, key, button,
hammer, screwdriver, wrench, pliers, saw, drill, nail, screw, rope, chain, ladder, paint, brush, toolbox,
person, man, woman, child, baby, face, hand, foot, hair, eye, skull, skeleton, mask,
dog, cat, horse, cow, sheep, pig, rabbit, bear, elephant, lion, monkey, mouse trap, bird, chicken, duck, fish tank,
frog,
turtle, snake, insect, butterfly, spider, shell, feather, bone,
tree, bush, flower, rose, leaf, branch, trunk, cactus, potted plant, grass, moss, root, log,
car, truck, bus, van, motorcycle, bicycle, scooter, train, airplane, boat, tractor, wheel, tyre, seat, engine,
house, building, tower, bridge, roof, chimney, balcony, garage, shed, tent, fence, gate, column, arch, fountain,
monument, church, shop, market stall, street lamp, traffic light, traffic cone, hydrant, mailbox, billboard, flag,
road, pavement, path, parking lot, rails, field, garden, lawn, forest, hill, mountain, rock, stone, gravel, sand, soil,
mud, beach, sea, lake, river, waterfall, sky, cloud, sun, moon, snow, ice, fire, smoke, shadow, light, reflection,
wood, metal, plastic, glass pane, leather, cloth, fur, wool, cardboard, concrete, plaster, marble, rubber, foam
"""

NOUNS = tuple(dict.fromkeys(word.strip() for word in _THINGS.replace("\n", " ").split(",")))


def list_vectors(encoder: Encoder) -> Embeddings:
    """Return the vectors of all texts of a vocabulary, of the encoder's own nouns, or of those that ship."""
    return listed_words(encoder)[1]


def listed_words(encoder: Encoder) -> tuple[Sequence[str], Embeddings]:
    """Return the texts of `list_vectors`, and these."""
    if encoder not in _EMBEDDED:
        if isinstance(encoder, VocabularyEncoder):
            texts: Sequence[str] = encoder.texts
            known = set(NOUNS)
            if len(texts) > MAX_TEXTS:  # the nouns of the list and others spread over the vocabulary
                nouns, others = ([text for text in texts if (text in known) == of_list] for of_list in (True, False))
                spread = np.linspace(0, len(others) - 1, MAX_TEXTS - len(nouns)).astype(int)
                texts = [*nouns, *(others[at] for at in np.unique(spread))]
            _EMBEDDED[encoder] = texts, np.asarray(encoder.encode_texts(texts), np.float32)
        else:
            _EMBEDDED[encoder] = known_words(encoder, getattr(encoder, "nouns", None) or broad_list())
    return _EMBEDDED[encoder]


def rival_vectors(encoder: Encoder, text: str | None) -> Embeddings | None:
    """Return the vectors of the few words that a text competes with; None: those of the list.

    text: None for a query that is no text. An encoder of few words may have `rivals`, see `MiniEncoder.rivals`.
    """
    rivals = getattr(encoder, "rivals", None)
    return None if rivals is None or text is None else rivals(text)


_EMBEDDED: "WeakKeyDictionary[Encoder, tuple[Sequence[str], Float32[np.ndarray, 'n D']]]" = WeakKeyDictionary()


def known_words(encoder: Encoder, words: Sequence[str]) -> tuple[list[str], Embeddings]:
    """Return those of some words that an encoder can read, and their vectors."""
    try:
        return list(words), np.asarray(encoder.encode_texts(words), np.float32)
    except InputError:  # an encoder of some words, or of short ones
        known: dict[str, Embeddings] = {}
    for word in words:
        with suppress(InputError):
            known[word] = encoder.encode_texts([word])
    rows = np.asarray(list(known.values()), np.float32)
    return list(known), rows.reshape(len(known), encoder.identity.dim)


def broad_list() -> tuple[str, ...]:
    """Return the nouns above and the 1,203 names of LVIS, none twice: structures and ground, and many small things.

    Source: the names of LVIS 1.0 (Gupta, Dollar, Girshick, CVPR 2019), CC BY 4.0; `lvis_names.txt` says so too.
    """
    lines = Path(__file__).with_name("lvis_names.txt").read_text(encoding="utf-8").splitlines()
    return tuple(dict.fromkeys((*NOUNS, *(line for line in lines if not line.startswith("#")))))


@cache
def _kinds() -> dict[str, frozenset[str]]:
    lines = Path(__file__).with_name("kinds.txt").read_text(encoding="utf-8").splitlines()
    pairs = (line.split(": ", 1) for line in lines if not line.startswith("#"))
    return {kind: frozenset(names.split(", ")) for kind, names in pairs}


def names_under(text: str) -> frozenset[str]:
    """Return the names of the list above that are of a kind: canoes and ferries of "boat", none of most texts.

    Source: the hypernyms of WordNet 3.0; `kinds.txt`, made by scripts/make_kinds.py, has its licence.
    """
    return next((_kinds()[one] for one in spellings(text) if one in _kinds()), frozenset())


def nearest_in_meaning(word: str, known: Collection[str]) -> list[str]:
    """Return the known words of the smallest kind that a word is of: "toy" for "doll", "knife" for "scissors".

    known: where the kind itself is one of them, it is all that is returned. [] where no small kind has any.
    """
    meant = set(spellings(word))
    for kind, names in sorted(_kinds().items(), key=lambda one: (len(one[1]), one[0] not in known)):
        near = [kind] if kind in known else sorted(names.intersection(known))
        if near and len(names) <= (LARGEST_KIND if kind in known else LARGEST_NEAR_KIND) and meant & names:
            return near
    return []
