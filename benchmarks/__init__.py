"""One script per question, and the suite: rendered scenes, all methods, all protocols (`benchmarks.suite`)."""
