"""Submission files of the GENEA leaderboard: written from a model or from motion of any system, and checked."""
