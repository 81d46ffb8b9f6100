"""What a scan keeps and decides beside its stages: its record, its input, its models, one display for all.

The stages are verbs of `commands`, and run as such.

Imports `formats`, `models` and `capture`.
"""
