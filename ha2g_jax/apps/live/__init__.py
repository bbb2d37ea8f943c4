"""Gestures while someone speaks: sound from a source goes through a model, whose frames go to sinks in time."""
