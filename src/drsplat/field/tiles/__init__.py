"""Huge scenes: tiles on disk, registered a photo at a time by any number of processes, in the memory of a few tiles."""
