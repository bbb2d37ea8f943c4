"""Time the convolutions of E_a and the gradients of their kernels: XLA's programs against ours, in turns.

python benchmarks/conv.py
python benchmarks/conv.py --batch-size 64 --size small --json

A ratio is the median time of XLA's program over that of the program that a training step takes, which follows from the
shapes and is named in the last column; above 1 it is faster, and 1 where it is XLA's. The gradient of an input has the
time of a convolution. oneDNN is timed, and used, where the extra is installed.
"""

import argparse
import functools
import json
import statistics
import time
from collections.abc import Callable

import jax
import jax.numpy as jnp

from ha2g_jax.cli.parser import positive
from ha2g_jax.layers.cpu import convolution, onednn, winograd
from ha2g_jax.layers.cpu.onednn.library import used_version

# Height, width and inputs of the map, channels, kernel, stride and padding of each kind of convolution.
SHAPES = {
    "paper": [
        (128, 70, 1, 32, (3, 3), (1, 1), 1),
        (128, 70, 32, 32, (3, 3), (1, 1), 1),
        (128, 70, 32, 64, (3, 3), (2, 2), 1),
        (64, 35, 64, 64, (3, 3), (1, 1), 1),
        (32, 18, 128, 128, (3, 3), (1, 1), 1),
        (16, 9, 256, 256, (3, 3), (1, 1), 1),
    ],
    "small": [
        (128, 70, 1, 16, (3, 3), (4, 1), 1),
        (32, 70, 16, 16, (3, 3), (1, 1), 1),
        (32, 70, 16, 32, (3, 3), (2, 2), 1),
        (16, 35, 32, 32, (3, 3), (1, 1), 1),
        (8, 18, 64, 64, (3, 3), (1, 1), 1),
        (4, 9, 128, 128, (3, 3), (1, 1), 1),
    ],
}
PROGRAMS = ("XLA", "products", "Winograd", "oneDNN")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", choices=SHAPES, default="paper")
    parser.add_argument("--batch-size", type=positive, default=32, metavar="B")
    parser.add_argument("--rounds", type=positive, default=7, help="timed calls of each program (default: 7)")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    rows = [row for shape in SHAPES[arguments.size] for row in measure(arguments.batch_size, arguments.rounds, *shape)]
    print(json.dumps(rows, indent=1) if arguments.json else as_table(rows))


def measure(batch: int, rounds: int, height, width, inputs, channels, kernel, stride, padding) -> list[dict]:
    """Return the medians in milliseconds of both operations for one shape, and their ratios."""
    x, weights = jnp.ones((batch, height, width, inputs)), jnp.ones((*kernel, inputs, channels))
    native = functools.partial(
        jax.lax.conv_general_dilated,
        window_strides=stride,
        padding=[(padding, padding)] * 2,
        dimension_numbers=("NHWC", "HWIO", "NHWC"),
    )
    cotangent = jnp.ones_like(native(x, weights))
    convolutions: dict[str, Callable[..., jax.Array]] = {"XLA": native}
    gradients: dict[str, Callable[..., jax.Array]] = {
        "XLA": lambda x, cotangent: jax.linear_transpose(lambda kernel: native(x, kernel), weights)(cotangent)[0],
        "products": functools.partial(convolution.kernel_gradient, size=kernel, stride=stride, padding=padding),
    }
    if kernel == (3, 3) and stride == (1, 1):
        convolutions["Winograd"] = functools.partial(winograd.conv, padding=padding)
        gradients["Winograd"] = functools.partial(winograd.kernel_gradient, padding=padding)
    if used_version():
        settings = {"stride": stride, "padding": padding}
        convolutions["oneDNN"] = lambda x, weights: onednn.conv(x, weights, **settings)
        gradients["oneDNN"] = lambda x, cotangent: onednn.conv_kernel_gradient(x, cotangent, kernel, **settings)
    is_winograd = convolution.is_faster_with_winograd(x, weights, stride, padding)
    is_products = convolution.is_faster_with_products(x.shape, weights.shape, cotangent.shape)
    used = {
        "convolution": "Winograd" if is_winograd else "XLA",
        "kernel gradient": "Winograd" if is_winograd else "products" if is_products else "XLA",
    }
    if used_version():
        used = dict.fromkeys(used, "oneDNN")
    medians = {
        "convolution": time_in_turns(convolutions, rounds, x, weights),
        "kernel gradient": time_in_turns(gradients, rounds, x, cotangent),
    }
    shape = f"{height} x {width} x {inputs} to {channels}, {kernel[0]} x {kernel[1]}, stride {stride[0]}, {stride[1]}"
    return [
        {"shape": shape, "of": of, "ms": ms, "ratio": ms["XLA"] / ms[used[of]], "used": used[of]}
        for of, ms in medians.items()
    ]


def time_in_turns(programs: dict, rounds: int, *arguments: jax.Array) -> dict[str, float]:
    """Return the median milliseconds of each program."""
    programs = {name: jax.jit(program) for name, program in programs.items()}
    seconds: dict[str, list[float]] = {name: [] for name in programs}
    for number in range(rounds + 1):  # the first call of each compiles
        for name, program in programs.items():
            started = time.perf_counter()
            jax.block_until_ready(program(*arguments))
            if number:
                seconds[name].append(time.perf_counter() - started)
    return {name: 1e3 * statistics.median(values) for name, values in seconds.items()}


def as_table(rows: list[dict]) -> str:
    """Format the rows as an aligned table."""
    lines = [f"{'shape':44} {'of':>16} " + " ".join(f"{name + ' ms':>12}" for name in PROGRAMS) + "  ratio     used"]
    for row in rows:
        times = " ".join(f"{row['ms'][name]:12.1f}" if name in row["ms"] else 12 * " " for name in PROGRAMS)
        lines.append(f"{row['shape']:44} {row['of']:>16} {times} {row['ratio']:6.2f} {row['used']:>9}")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
