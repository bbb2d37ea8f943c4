"""Programs that make training on CPUs faster than those of XLA, with the same results.

Layers call `convolution.conv`, and `gru_scan` the recurrences of `onednn`; they know nothing else of this folder. What
runs depends on the shapes and on one choice, `Compute.onednn`, which `methods.networks.apply` makes for each run of a
network.
"""
