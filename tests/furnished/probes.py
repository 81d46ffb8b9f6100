"""What is asked of the furnished room, and the names of the things that are meant."""

from drsplat.evaluation.demo.story import Probe

PROBES = (
    Probe("red mug", ("red mug",)),
    Probe("mug", ("red mug", "blue mug")),
    Probe("something green", ("green sofa", "green apples")),
    Probe("wooden table", ("wooden table",)),
    Probe("couch", ("green sofa",)),
    Probe("cat", ("grey cat",)),
    Probe("yellow pillow", ("yellow cushion",)),
    Probe("teddy bear", ("brown teddy",)),
    Probe("ball", ("orange ball",)),
    Probe("lamp", ("lamp",)),
    Probe("bicycle", ()),
    Probe("elephant", ()),
)
