"""Scores of a model against the known causes of the motion of the Talk corpus."""
