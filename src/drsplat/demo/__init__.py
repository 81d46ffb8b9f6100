"""A small scene that ships, asked in words and held against its truth."""
