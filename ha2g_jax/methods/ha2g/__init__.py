"""HA2G (Liu et al., CVPR 2022): read `model.py`, `losses.py` and `method.py`, in this order.

`release.py` has the networks of the authors' public code, for the weights that were released.
"""
