"""Named and versioned protocols: predict to disk, score from disk, report."""
