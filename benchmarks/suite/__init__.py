"""The benchmark that ships: rendered scenes, all aggregators, all protocols. See `__main__` and `page`."""
