"""Objects: what belongs together in a scene, found across photos, with or without words."""
