"""Beats of a motion and onsets of speech: detectors, alignment, chance levels, and the registered beat metrics.

Three definitions of a motion beat have their place: stops (minima of the angle change rate, HA2G) for any
motion, strokes (downward, of the hands) where the strokes that speech causes are known, and the rests of
`rests` (the BEAT data sets). `legacy_bc` has the rules of the public release.
"""
