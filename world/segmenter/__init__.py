"""How the built-in segmenter `graph` is learned from this world and measured; needs scenes made by `python -m
world`."""
