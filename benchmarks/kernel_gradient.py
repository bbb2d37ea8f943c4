"""Time the kernel gradients of the convolutions of E_a: matrix products against XLA's own, in turns in one process.

python benchmarks/kernel_gradient.py
python benchmarks/kernel_gradient.py --batch-size 64 --size small --json

A ratio is the median time of XLA's gradient over that of the products; above 1 the products are faster. The last column
is what a training step takes, which follows from the shapes.
"""

import argparse
import functools
import json
import statistics
import time

import jax
import jax.numpy as jnp

from ha2g_jax.layers import conv

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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", choices=SHAPES, default="paper")
    parser.add_argument("--batch-size", type=int, default=32, metavar="B")
    parser.add_argument("--rounds", type=int, default=7, help="timed calls of each gradient (default: 7)")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    rows = [measure(arguments.batch_size, arguments.rounds, *shape) for shape in SHAPES[arguments.size]]
    print(json.dumps(rows, indent=1) if arguments.json else as_table(rows))


def measure(batch: int, rounds: int, height, width, inputs, channels, kernel, stride, padding) -> dict:
    """Return the medians in milliseconds for one shape, and their ratio."""
    x, zeros = jnp.ones((batch, height, width, inputs)), jnp.zeros((*kernel, inputs, channels))
    cotangent = jnp.ones_like(conv.conv(x, zeros, stride, padding))

    def xla(x, cotangent):
        def forward(kernel):
            pairs = [(padding, padding)] * 2
            return jax.lax.conv_general_dilated(x, kernel, stride, pairs, dimension_numbers=("NHWC", "HWIO", "NHWC"))

        return jax.linear_transpose(forward, zeros)(cotangent)[0]

    products = functools.partial(conv.kernel_gradient, size=kernel, stride=stride, padding=padding)
    programs = {"xla": jax.jit(xla), "products": jax.jit(products)}
    seconds: dict[str, list[float]] = {name: [] for name in programs}
    for number in range(rounds + 1):  # the first call of each compiles
        for name, program in programs.items():
            started = time.perf_counter()
            jax.block_until_ready(program(x, cotangent))
            if number:
                seconds[name].append(time.perf_counter() - started)
    xla_ms, products_ms = (1e3 * statistics.median(seconds[name]) for name in programs)
    shape = f"{height} x {width} x {inputs} to {channels}, {kernel[0]} x {kernel[1]}, stride {stride[0]}, {stride[1]}"
    used = "products" if conv.is_faster_with_products(x.shape, zeros.shape, cotangent.shape) else "XLA"
    return {"shape": shape, "xla_ms": xla_ms, "products_ms": products_ms, "ratio": xla_ms / products_ms, "used": used}


def as_table(rows: list[dict]) -> str:
    """Format the rows as an aligned table."""
    lines = [f"{'shape':44} {'XLA ms':>8} {'products ms':>12} {'ratio':>6} {'used':>9}"]
    lines += [
        f"{row['shape']:44} {row['xla_ms']:8.1f} {row['products_ms']:12.1f} {row['ratio']:6.2f} {row['used']:>9}"
        for row in rows
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    main()
