"""Ways in: the command line, HTTP and MCP services, the viewer, and the scan that chains verbs. They hold no rule.

Each turns what somebody gave into a call of the rooms below, and shows what comes back. Begin with
`commands/locate.py`.

Imports `scene`, `formats`, `kernels`, `field`, `photos`, `drawing`, `query`, `authoring`, `training` and `evaluation`.
"""
