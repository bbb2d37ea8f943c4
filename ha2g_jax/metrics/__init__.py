"""Scores of motion: pure numpy functions of arrays; nothing here knows a model or a file."""
