"""Initial values as in the layers of PyTorch, so that both frameworks start from the same distributions."""

from flax import linen as nn

# Uniform in +-1/sqrt(fan in): kernels of torch.nn.Linear and torch.nn.Conv1d.
LINEAR = nn.initializers.variance_scaling(1 / 3, "fan_in", "uniform")

# Kaiming normal, fan out, gain of ReLU: kernels of the convolutions of the ResNets.
RESNET = nn.initializers.variance_scaling(2.0, "fan_out", "normal")
