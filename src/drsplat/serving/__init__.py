"""Scenes for programs and language models: an HTTP service and an MCP server over `drsplat.query`.

Imports `catalogue`, `editing`, `encoders`, `exporting`, `field`, `scene`, `formats`, `kernels`, `models` and `query`.
"""
