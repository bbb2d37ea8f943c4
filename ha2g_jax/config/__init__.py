"""Settings of a run: their names, defaults, meanings and checks, and the presets of data sets and methods."""
