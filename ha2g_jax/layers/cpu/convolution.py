"""Two-dimensional convolutions that are faster on CPUs than those of XLA.

oneDNN (`onednn`) computes them where `library.is_used_for` says so. Otherwise wide 3 x 3 convolutions and their
gradients use Winograd's algorithm (`winograd`). For other wide kernels the gradient of the kernel is a matrix product:
XLA computes it as a convolution whose window is a whole image, which is 1.5 to 10 times slower at the size of the
paper. For small kernels and on accelerators XLA is used.
"""

import functools
import math

import jax
import jax.numpy as jnp

from ha2g_jax.layers.cpu import onednn, winograd
from ha2g_jax.layers.cpu.onednn import library

_LAYOUT = ("NHWC", "HWIO", "NHWC")
_ROWS = 1024  # least number of positions in one product: enough to be fast, few enough for the caches


def conv(x: jax.Array, kernel: jax.Array, stride: tuple[int, int], padding: int) -> jax.Array:
    """Convolve images with a kernel.

    This is `jax.lax.conv_general_dilated` with other implementations on CPUs. It has gradients of any order in reverse
    mode, but none in forward mode.

    Images (B, H, W, inputs) and a kernel (height, width, inputs, channels) must have the same type. The result is
    (B, (H + 2 padding - height) // stride + 1, ..., channels).
    """
    edges = [edge + 2 * padding - width for edge, width in zip(x.shape[1:3], kernel.shape[:2], strict=True)]
    if x.size and min(edges) >= 0 and library.is_used_for(x, kernel):
        return onednn.conv(x, kernel, stride, padding)
    return _conv(x, kernel, stride, padding)


def _native(x: jax.Array, kernel: jax.Array, stride: tuple[int, int], padding: int) -> jax.Array:
    pairs = ((padding, padding), (padding, padding))
    return jax.lax.conv_general_dilated(x, kernel, stride, pairs, dimension_numbers=_LAYOUT)


@functools.partial(jax.custom_vjp, nondiff_argnums=(2, 3))
def _conv(x: jax.Array, kernel: jax.Array, stride: tuple[int, int], padding: int) -> jax.Array:
    native = functools.partial(_native, stride=stride, padding=padding)
    if not is_faster_with_winograd(x, kernel, stride, padding):
        return native(x, kernel)
    return jax.lax.platform_dependent(x, kernel, cpu=functools.partial(winograd.conv, padding=padding), default=native)


def _forward(x, kernel, stride, padding):
    return _conv(x, kernel, stride, padding), (x, kernel)


def _backward(stride, padding, residuals, cotangent):
    x, kernel = residuals
    native = functools.partial(_native_kernel_gradient, kernel=kernel, stride=stride, padding=padding)
    if is_faster_with_winograd(x, kernel, stride, padding):
        x_gradient = _conv(cotangent, kernel[::-1, ::-1].swapaxes(2, 3), (1, 1), 2 - padding)
        program = functools.partial(winograd.kernel_gradient, padding=padding)
    else:
        (x_gradient,) = jax.linear_transpose(lambda x: _native(x, kernel, stride, padding), x)(cotangent)
        if not is_faster_with_products(x.shape, kernel.shape, cotangent.shape):
            return x_gradient, native(x, cotangent)
        program = functools.partial(kernel_gradient, size=kernel.shape[:2], stride=stride, padding=padding)
    return x_gradient, jax.lax.platform_dependent(x, cotangent, cpu=program, default=native)


_conv.defvjp(_forward, _backward)


def is_faster_with_winograd(x: jax.Array, kernel: jax.Array, stride: tuple[int, int], padding: int) -> bool:
    """Return whether Winograd's convolution is faster on a CPU than that of XLA for these arguments of `conv`.

    Its matrix products need 32 channels, and enough positions to outweigh the transform of the kernel. Its sums are
    exact enough in float32 but not in narrower types. `benchmarks/conv.py` measures both.
    """
    is_3x3 = kernel.shape[:2] == (3, 3) and stride == (1, 1) and padding <= 2
    is_wide = min(kernel.shape[2:]) >= 32 and math.prod(x.shape[:3]) >= 1 << 11
    return is_3x3 and is_wide and x.dtype.itemsize >= 4 and x.size * kernel.shape[3] >= 1 << 22


def is_faster_with_products(x: tuple[int, ...], kernel: tuple[int, ...], cotangent: tuple[int, ...]) -> bool:
    """Return whether `kernel_gradient` is faster on a CPU than the gradient of XLA for these shapes.

    Products are fast for wide matrices, XLA for small images; `benchmarks/conv.py` measures both.
    """
    rows, columns, inputs, channels = kernel
    if math.prod(cotangent[:-1]) * inputs * channels < 1 << 22:
        return False  # both take a few milliseconds, and XLA's compiles faster
    is_pointwise = rows == columns == 1
    return is_pointwise or inputs * channels >= 1 << 11 or math.prod(x[1:]) >= 1 << 17


def _native_kernel_gradient(
    x: jax.Array, cotangent: jax.Array, *, kernel: jax.Array, stride: tuple[int, int], padding: int
) -> jax.Array:
    return jax.linear_transpose(lambda kernel: _native(x, kernel, stride, padding), kernel)(cotangent)[0]


def kernel_gradient(
    x: jax.Array, cotangent: jax.Array, *, size: tuple[int, int], stride: tuple[int, int], padding: int
) -> jax.Array:
    """Return the gradient of a kernel as matrix products, one for each row of the kernel and chunk of images.

    The columns that a row of the kernel covers lie side by side on the channels, so that each product is that of
    (width inputs, positions) and (positions, channels). Sums are float32.

    The input of the convolution is (B, H, W, inputs), the gradient of its output (B, H', W', channels) and that of the
    kernel (height, width, inputs, channels), whose height and width are `size`.
    """
    inputs, (_, height, width, channels) = x.shape[-1], cotangent.shape
    rows, columns = size
    padded = jnp.pad(x, ((0, 0), (padding, padding), (padding, padding), (0, 0)))
    parts, cotangents = (winograd.split(array, math.ceil(_ROWS / (height * width))) for array in (padded, cotangent))

    def add(total: jax.Array, index: jax.Array) -> tuple[jax.Array, None]:
        image, out = winograd.take(parts, index), winograd.take(cotangents, index).reshape(-1, channels)
        # Updates in place copy faster than a concatenation, which XLA computes value by value.
        covered = jnp.zeros((*image.shape[:2], width, columns * inputs), image.dtype)
        for first in range(columns):
            column = _every(image, 2, first, width, stride[1])
            covered = jax.lax.dynamic_update_slice_in_dim(covered, column, first * inputs, axis=3)
        products = [
            jax.lax.dot_general(
                out,
                _every(covered, 1, first, height, stride[0]).reshape(-1, columns * inputs),
                (((0,), (0,)), ((), ())),
                preferred_element_type=jnp.float32,
            )
            for first in range(rows)
        ]
        return total + jnp.stack(products), None

    start = jnp.zeros((rows, channels, columns * inputs), jnp.float32)
    total, _ = jax.lax.scan(add, start, jnp.arange(parts.shape[1]))
    return total.reshape(rows, channels, columns, inputs).transpose(0, 2, 3, 1).astype(cotangent.dtype)


def _every(x: jax.Array, axis: int, first: int, count: int, stride: int) -> jax.Array:
    return jax.lax.slice_in_dim(x, first, first + (count - 1) * stride + 1, stride, axis)
