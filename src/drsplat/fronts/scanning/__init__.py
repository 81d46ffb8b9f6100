"""Records and choices of a scan beside its stages: its record, its input, its models, one display for all.

The stages are verbs of `commands`, and run as such.
"""
