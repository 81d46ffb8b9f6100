"""Numbers that all ways of asking share."""

RELEVANCY_THRESHOLD = 0.5
MIN_GAUSSIANS = 40  # smaller things are specks where masks met
AUTO, NEVER = "auto", "never"
ENCODER, GIVEN, LIST, SHARE, DEFAULT, OBJECT, LABEL = (
    "encoder", "given", "list", "top share", "default", "object", "label",
)  # fmt: skip
COSINE, RELEVANCY = "cosine", "relevancy"
SURE, MAYBE, NOTHING = "sure", "maybe", "nothing"
