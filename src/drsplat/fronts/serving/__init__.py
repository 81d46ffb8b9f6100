"""Scenes for programs and language models: an HTTP service and an MCP server over `drsplat.query`."""
