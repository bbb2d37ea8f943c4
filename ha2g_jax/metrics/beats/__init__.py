"""Beats of a motion and onsets of speech: detectors, alignment, chance levels, and the registered beat metrics.

There are three definitions of a motion beat: stops (minima of the angle change rate, HA2G) for any motion, downward
strokes of the hands where the strokes that speech causes are known, and the rests of `rests` (the BEAT data sets).
`legacy_bc` follows the rules of the public release.
"""
