"""HA2G written with `torch.nn`, to compare the time of a training step with ours; see `step.py`.

The networks have the names and shapes of `ha2g_jax/methods/ha2g/model.py` and the layers that it uses, so that a
parameter of one has the same name in the other but for the conventions of the libraries, such as kernel and weight.
"""

from torch_peer.process import Choice, TorchProcess
from torch_peer.step import TorchStep, check

__all__ = ["Choice", "TorchProcess", "TorchStep", "check"]
