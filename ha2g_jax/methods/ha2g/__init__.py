"""HA2G (Liu et al., CVPR 2022): read `model.py`, `losses.py` and `method.py`, in this order.

`release.py` has the networks of the authors' public code, which run the released weights.
"""
