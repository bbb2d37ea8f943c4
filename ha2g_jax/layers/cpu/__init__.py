"""Programs that make training on CPUs faster than those of XLA, with the same results.

Layers call `convolution.conv` and `recurrence.gru_scan`, and know nothing else of this folder. What these run depends
on the shapes and on one choice, `Compute.onednn`, which `methods.networks.apply` makes for each run of a network.
"""
