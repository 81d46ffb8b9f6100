"""Photos that arrive while a scene is in use: checked and kept, then masked, embedded and added to its field."""
