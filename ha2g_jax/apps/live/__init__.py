"""Gestures while someone speaks: sound of a source goes through a model, and each frame to sinks at its time."""
