"""Convolutions and GRUs of oneDNN for training on CPUs, which the extra `ha2g-jax[onednn]` adds.

`library` compiles the C++ of this folder and registers it with JAX, `calls` has the functions with their gradients.
Without the extra, and on accelerators, `layers.conv` and `layers.gru_scan` keep their programs of XLA.
"""
