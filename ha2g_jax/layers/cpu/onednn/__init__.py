"""Convolutions and GRUs of oneDNN for training on CPUs, installed with the extra `ha2g-jax[onednn]`.

The functions have gradients of any order in reverse mode. Arrays are float32; `cpu.convolution` and `gru_scan`
explain the arguments. `library` compiles the C++ of this folder and registers it with JAX; `methods.networks.apply`
chooses oneDNN for a run of a network (`Compute.onednn`).
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


@functools.partial(jax.custom_vjp, nondiff_argnums=(2, 3))
def conv(x: jax.Array, kernel: jax.Array, stride: tuple[int, int], padding: int) -> jax.Array:
    """Convolve images (B, H, W, inputs) with a kernel (height, width, inputs, channels)."""
    edges = zip(x.shape[1:3], kernel.shape[:2], stride, strict=True)
    size = ((edge + 2 * padding - width) // step + 1 for edge, width, step in edges)
    return _convolution("Ha2gConv", (len(x), *size, kernel.shape[3]), x, kernel, stride, padding)


@functools.partial(jax.custom_vjp, nondiff_argnums=(2, 3, 4))
def conv_input_gradient(
    kernel: jax.Array, cotangent: jax.Array, size: tuple[int, int], stride: tuple[int, int], padding: int
) -> jax.Array:
    """Return the gradient of `conv` with respect to the images, whose height and width are `size`."""
    shape = (len(cotangent), *size, kernel.shape[2])
    return _convolution("Ha2gConvInputGradient", shape, kernel, cotangent, stride, padding)


@functools.partial(jax.custom_vjp, nondiff_argnums=(2, 3, 4))
def conv_kernel_gradient(
    x: jax.Array, cotangent: jax.Array, size: tuple[int, int], stride: tuple[int, int], padding: int
) -> jax.Array:
    """Return the gradient of `conv` with respect to the kernel, whose height and width are `size`."""
    if size == (1, 1) and stride != (1, 1):
        # oneDNN writes past its memory where such a kernel strides over few channels, so pass only the pixels in use.
        edges = ((0, 0), (padding, padding), (padding, padding), (0, 0))
        rows, columns = cotangent.shape[1:3]
        x = jnp.pad(x, edges)[:, :: stride[0], :: stride[1]][:, :rows, :columns]
        stride, padding = (1, 1), 0
    shape = (*size, x.shape[3], cotangent.shape[3])
    return _convolution("Ha2gConvKernelGradient", shape, x, cotangent, stride, padding)


def _convolution(
    target: str, shape: tuple[int, ...], first: jax.Array, second: jax.Array, stride: tuple[int, int], padding: int
) -> jax.Array:
    call = jax.ffi.ffi_call(target, jax.ShapeDtypeStruct(shape, jnp.float32), vmap_method="sequential")
    rows, columns = stride
    return call(first, second, row_stride=np.int64(rows), column_stride=np.int64(columns), padding=np.int64(padding))


# Each function is linear in either argument, so that its gradients are again among the three functions.
conv.defvjp(
    lambda x, kernel, stride, padding: (conv(x, kernel, stride, padding), (x, kernel)),
    lambda stride, padding, arguments, cotangent: (
        conv_input_gradient(arguments[1], cotangent, arguments[0].shape[1:3], stride, padding),
        conv_kernel_gradient(arguments[0], cotangent, arguments[1].shape[:2], stride, padding),
    ),
)
conv_input_gradient.defvjp(
    lambda kernel, y, *settings: (conv_input_gradient(kernel, y, *settings), (kernel, y)),
    lambda size, stride, padding, arguments, x: (
        conv_kernel_gradient(x, arguments[1], arguments[0].shape[:2], stride, padding),
        conv(x, arguments[0], stride, padding),
    ),
)
conv_kernel_gradient.defvjp(
    lambda x, y, *settings: (conv_kernel_gradient(x, y, *settings), (x, y)),
    lambda size, stride, padding, arguments, kernel: (
        conv_input_gradient(kernel, arguments[1], arguments[0].shape[1:3], stride, padding),
        conv(arguments[0], kernel, stride, padding),
    ),
)


def gru_states(gates: Sequence[jax.Array], kernels: Sequence[jax.Array], bias: jax.Array) -> jax.Array:
    """Return the states (N, B, h) of one GRU from a zero state.

    Gates (N, B, h) and hidden kernels (h, h) are those of reset, update and new; the hidden bias (h,) is that of new.
    """
    like = jax.ShapeDtypeStruct(gates[0].shape, jnp.float32)
    return jax.ffi.ffi_call("Ha2gGruStates", like, vmap_method="sequential")(*gates, *kernels, bias)


def gru_sums(
    cotangents: jax.Array, slopes: Sequence[jax.Array], kernels: Sequence[jax.Array]
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return the gradients of the sums inside the gates of one GRU: reset, update, new, each (N, B, h).

    `cotangents` are the gradients of the states; the slopes are new, update, reset, inner and kept, each (N, B, h), and
    the hidden kernels (h, h).
    """
    like = jax.ShapeDtypeStruct(cotangents.shape, jnp.float32)
    call = jax.ffi.ffi_call("Ha2gGruSums", [like] * 3, vmap_method="sequential")
    reset, update, new = call(cotangents, *slopes, *kernels)
    return reset, update, new


def count_operations(target: str, shapes: Sequence[tuple[int, ...]]) -> int:
    """Return the floating-point operations of the products of a call, from the shapes of its arguments and results."""
    match target:
        case "Ha2gConv":
            _, kernel, y = shapes
        case "Ha2gConvInputGradient":
            kernel, y, _ = shapes
        case "Ha2gConvKernelGradient":
            _, y, kernel = shapes
        case "Ha2gGruStates" | "Ha2gGruSums":
            steps, batch, width = shapes[0]
            return 2 * 3 * steps * batch * width**2
        case _:
            return 0
    return 2 * math.prod(y) * math.prod(kernel[:3])


def differentiated_as(program: Callable[..., Any], call: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that computes `call` but has the gradients of `program`, which computes the same values."""

    @jax.custom_vjp
    def function(*arguments: Any) -> Any:
        return call(*arguments)

    function.defvjp(
        lambda *arguments: (call(*arguments), arguments),
        lambda arguments, cotangent: jax.vjp(program, *arguments)[1](cotangent),
    )
    return function
