"""Numbers that all ways of asking share."""

RELEVANCY_THRESHOLD = 0.5
MIN_GAUSSIANS = 40  # smaller things are specks where masks met
AUTO, ENCODER, GIVEN, LIST, SHARE, DEFAULT = ("auto", "encoder", "given", "list", "top share", "default")
COSINE, RELEVANCY = "cosine", "relevancy"
