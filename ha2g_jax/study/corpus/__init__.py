"""Pages about a corpus: how much there is of it, how people speak and move in it."""
