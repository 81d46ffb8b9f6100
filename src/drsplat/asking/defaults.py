"""Numbers that all ways of asking share."""

RELEVANCY_THRESHOLD, COSINE_THRESHOLD = 0.5, 0.5
MIN_GAUSSIANS = 40  # smaller things are specks where masks met
AUTO, ENCODER, GIVEN, SHARE, DEFAULT = "auto", "encoder", "given", "top share", "default"
