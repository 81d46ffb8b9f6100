"""Models of other libraries as our encoders and segmenters; each is imported when it is asked for."""
