"""Scores of any motion: read or generated, measured beside rows that show what each score is worth, and printed."""
