"""Implementations of layers that train faster on CPUs than those of XLA, with the same results.

Layers call only `convolution.conv`, and `gru_scan` only the recurrences of `onednn`. Which implementation runs depends
on the shapes and on `Compute.onednn`, which `methods.networks.apply` applies to each run of a network.
"""
