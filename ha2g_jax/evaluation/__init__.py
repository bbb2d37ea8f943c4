"""Scores of any motion, read or generated, next to reference rows that show what each score is worth."""
