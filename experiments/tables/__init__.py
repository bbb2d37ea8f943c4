"""Reproduction of the paper's tables: plans of runs, training and scoring in processes, and pages with both numbers."""
