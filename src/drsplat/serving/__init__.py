"""Scenes for programs and language models: an HTTP service and an MCP server over `drsplat.query`.

Imports `catalogue`, `encoders`, `field`, `scene`, `formats`, `models` and `query`.
"""
