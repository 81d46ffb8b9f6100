"""What is asked of the furnished room, and the names of the things that are meant."""

from drsplat.demo.questions import Question

QUESTIONS = (
    Question("red mug", ("red mug",)),
    Question("mug", ("red mug", "blue mug")),
    Question("something green", ("green sofa", "green apples")),
    Question("wooden table", ("wooden table",)),
    Question("couch", ("green sofa",)),
    Question("cat", ("grey cat",)),
    Question("yellow pillow", ("yellow cushion",)),
    Question("teddy bear", ("brown teddy",)),
    Question("ball", ("orange ball",)),
    Question("books", ("books",)),
    Question("plant", ("potted plant",)),
    Question("lamp", ("lamp",)),
    Question("guitar", ("guitar",)),
    Question("painting", ("painting",)),
    Question("bicycle", ()),
    Question("elephant", ()),
)
