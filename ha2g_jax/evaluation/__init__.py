"""Scores of any motion, read or generated, beside rows that show what each score is worth."""
