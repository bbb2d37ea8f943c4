"""Gated recurrent units of one or two directions, with the parameters of PyTorch: the only recurrence of the project.

Rows of the stacked weights are in the order reset r, update z, new n. `gru_cell` has the equations.
"""

import jax
import jax.numpy as jnp
from flax import linen as nn

from ha2g_jax.layers import initializers
from ha2g_jax.layers.gru_cell import Gates, gru_cell, sequence_scan
from ha2g_jax.layers.gru_scan import gru_scan
from ha2g_jax.layers.linear import Linear


def _weights(module: nn.Module, inputs: int, hidden_dim: int, suffix: str) -> tuple[jax.Array, ...]:
    """Return the parameters of one GRU, named as in `torch.nn.GRU`; their initial values are uniform in +-1/sqrt(h)."""
    uniform, width = initializers.uniform(hidden_dim**-0.5), 3 * hidden_dim
    return (
        module.param("weight_ih" + suffix, uniform, (width, inputs)),
        module.param("weight_hh" + suffix, uniform, (width, hidden_dim)),
        module.param("bias_ih" + suffix, uniform, (width,)),
        module.param("bias_hh" + suffix, uniform, (width,)),
    )


def _gates(x: jax.Array, weights: tuple[jax.Array, ...]) -> tuple[Gates, jax.Array]:
    """Return the gates and the hidden bias of one GRU on x (N, B, inputs), as `gru_scan` takes them."""
    input_weight, hidden_weight, input_bias, hidden_bias = weights
    # c_r and c_z can be added before the scan; c_n, the hidden bias, lies inside the product with r.
    outside, inside = jnp.split(hidden_bias, [2 * hidden_weight.shape[1]])
    bias = input_bias + jnp.concatenate([outside, jnp.zeros_like(inside)])
    # One matrix product for all frames instead of one in each step of the scan.
    gates = jnp.einsum("nbi,gi->nbg", x, input_weight) + bias[None, None]
    return Gates(*jnp.split(gates, 3, axis=-1)), inside


def _kernels(weights: tuple[jax.Array, ...]) -> Gates:
    """Return the hidden kernels of one GRU, as `gru_scan` takes them."""
    return Gates(*jnp.split(weights[1].T, 3, axis=-1))


class BiGRU(nn.Module):
    """A bidirectional GRU of several layers whose two directions are summed at the end.

    Between the layers the directions are concatenated, and dropout acts only there. Parameters have the names and
    shapes of `torch.nn.GRU`, such as `weight_ih_l0` (3 h, inputs) and `bias_hh_l1_reverse` (3 h,), where h is
    `hidden_dim`.
    """

    hidden_dim: int
    layers: int
    dropout: float = 0.0

    def __call__(self, x: jax.Array, *, train: bool) -> jax.Array:
        """Map (B, N, inputs) to (B, N, hidden_dim); uses the stream "dropout" in training."""
        forward, backward = self.states(x, train=train)[-1]
        return forward + backward

    @nn.compact
    def states(
        self, x: jax.Array, *, is_real: jax.Array | None = None, train: bool
    ) -> tuple[tuple[jax.Array, jax.Array], ...]:
        """Return the forward and the backward states of every layer, each (B, N, hidden_dim), from x (B, N, inputs).

        `is_real` (B, N) is False at steps after the end of a sequence. There the forward state does not change, so that
        the last one is the final state, and the backward state is 0.
        """
        x = jnp.swapaxes(x, 0, 1)
        if is_real is not None:
            is_real = is_real.T[..., None]
        layers: list[tuple[jax.Array, jax.Array]] = []
        for layer in range(self.layers):
            if layer:
                x = jnp.concatenate(layers[-1], axis=-1)
                x = nn.Dropout(self.dropout)(x, deterministic=not train)
            layers.append(self._layer(x, is_real, layer))
        return tuple((jnp.swapaxes(forward, 0, 1), jnp.swapaxes(backward, 0, 1)) for forward, backward in layers)

    def _layer(self, x: jax.Array, is_real: jax.Array | None, layer: int) -> tuple[jax.Array, jax.Array]:
        weights, back_weights = (
            _weights(self, x.shape[-1], self.hidden_dim, f"_l{layer}{suffix}") for suffix in ("", "_reverse")
        )
        (gates, bias), (back_gates, back_bias) = _gates(x, weights), _gates(x[::-1], back_weights)
        masks = None if is_real is None else (is_real, is_real[::-1])
        _, batch, _ = x.shape
        if batch == 1:
            # Each direction has its own scan: the weights of one fit the cache of a core, those of both do not.
            forward = sequence_scan(gates, weights[1], bias, masks and masks[0])
            backward = sequence_scan(back_gates, back_weights[1], back_bias, masks and masks[1])
        else:
            kernels = (_kernels(weights), _kernels(back_weights))
            forward, backward = gru_scan((gates, back_gates), kernels, (bias, back_bias), masks)
        return forward, backward[::-1]


class GRU(nn.Module):
    """A GRU of several layers that runs forward in time, without dropout and with the parameters of `torch.nn.GRU`."""

    hidden_dim: int
    layers: int

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        """Map (B, N, inputs) to the states of the last layer, (B, N, hidden_dim)."""
        x = jnp.swapaxes(x, 0, 1)
        for layer in range(self.layers):
            weights = _weights(self, x.shape[-1], self.hidden_dim, f"_l{layer}")
            gates, bias = _gates(x, weights)
            (x,) = gru_scan((gates,), (_kernels(weights),), (bias,))
        return jnp.swapaxes(x, 0, 1)


class GRUCells(nn.Module):
    """One step of a GRU of several layers that runs forward in time, with the parameters of `torch.nn.GRU`."""

    hidden_dim: int
    layers: int
    dropout: float = 0.0

    @nn.compact
    def __call__(self, states: tuple[jax.Array, ...], x: jax.Array, *, train: bool) -> tuple[jax.Array, ...]:
        """Compute the states h_t, for each layer (B, hidden_dim) float32, from h_(t-1) and x_t (B, inputs).

        Training uses the random stream "dropout".
        """
        after: list[jax.Array] = []
        for layer, state in enumerate(states):
            if layer:
                x = nn.Dropout(self.dropout)(after[-1].astype(x.dtype), deterministic=not train)
            weights = _weights(self, x.shape[-1], self.hidden_dim, f"_l{layer}")
            gates, bias = _gates(x[None], weights)
            after.append(gru_cell(state, jax.tree.map(lambda gate: gate[0], gates), _kernels(weights), bias))
        return tuple(after)


class FrameDecoder(nn.Module):
    """Decoder of the features of each frame to a pose: a bidirectional GRU and two linear maps.

    Joint Embedding, Trimodal and the release of HA2G share it (Yoon et al. 2020).

    Attributes:
        slope: slope of the activation for negative values. The release of Trimodal passes True as the slope, which
            counts as 1 and makes the activation the identity.
    """

    pose_dim: int
    hidden_dim: int
    layers: int
    dropout: float
    slope: float = 0.01

    @nn.compact
    def __call__(self, x: jax.Array, *, train: bool) -> jax.Array:
        """Map features (B, N, inputs) to poses (B, N, pose_dim)."""
        hidden = BiGRU(self.hidden_dim, self.layers, self.dropout, name="gru")(x, train=train)
        hidden = Linear(self.hidden_dim // 2, name="linear_1")(hidden)
        hidden = nn.leaky_relu(hidden, self.slope)
        return Linear(self.pose_dim, name="linear_2")(hidden)
