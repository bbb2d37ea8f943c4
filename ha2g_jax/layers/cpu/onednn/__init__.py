"""Convolutions and GRUs of oneDNN for training on CPUs, which the extra `ha2g-jax[onednn]` adds.

`library` compiles the C++ of this folder and registers it with JAX, `calls` has the functions with their gradients.
`methods.networks.apply` chooses it for a run of a network (`Compute.onednn`).
"""
