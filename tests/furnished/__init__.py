"""A furnished room whose every object is known: to see the whole pipeline, and to measure it."""
