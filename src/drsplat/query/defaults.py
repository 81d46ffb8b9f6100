"""Numbers that all ways of asking share."""

RELEVANCY_THRESHOLD = 0.5
MIN_GAUSSIANS = 40  # smaller things are specks where masks met
AUTO, ENCODER, GIVEN, LIST, SHARE, DEFAULT, OBJECT, LABEL = (
    "auto", "encoder", "given", "list", "top share", "default", "object", "label",
)  # fmt: skip
COSINE, RELEVANCY = "cosine", "relevancy"
