"""The paper's tables made anew: planned as runs, trained and scored by processes, written beside its numbers."""
