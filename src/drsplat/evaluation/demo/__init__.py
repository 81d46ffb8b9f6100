"""Demo: a small scene in the package, searched in words and compared with its truth."""
