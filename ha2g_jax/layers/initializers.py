"""Initial values as in PyTorch's layers, so that both frameworks start from the same distributions."""

from flax import linen as nn

# Uniform in +-1/sqrt(fan in): the kernel of torch.nn.Linear and of its one-dimensional convolutions.
LINEAR = nn.initializers.variance_scaling(1 / 3, "fan_in", "uniform")

# Kaiming normal, fan out, gain of ReLU: the convolutions of the ResNets.
RESNET = nn.initializers.variance_scaling(2.0, "fan_out", "normal")
