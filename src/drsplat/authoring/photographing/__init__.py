"""Pictures of a splat without photos: poses planned from the scene, and renderings of them as a capture."""
