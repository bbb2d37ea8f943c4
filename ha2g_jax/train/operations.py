"""Count the floating-point operations of a traced function, to compare its speed with what a machine can do."""

import math
from typing import Any

from jax.extend import core

from ha2g_jax.layers.cpu.onednn import calls


def count_operations(jaxpr: core.Jaxpr) -> int:
    """Count the operations of the matrix products and convolutions of a traced function.

    A multiplication and the addition of its result are two operations. All other operations are left out: they are
    few, and limited by memory rather than by arithmetic. A loop counts as often as it runs, except a `while_loop`,
    whose number of runs is unknown and which counts once. Of the branches of a `cond` the most expensive one counts.

    Args:
        jaxpr: function as JAX traced it, such as `jax.jit(f).trace(x).jaxpr.jaxpr`.

    Returns:
        Number of operations of one call, on all devices together.
    """
    return sum(map(_of_equation, jaxpr.eqns))


def _of_equation(equation: core.JaxprEqn) -> int:
    match equation.primitive.name:
        case "dot_general":
            return _of_product(equation)
        case "conv_general_dilated":
            return _of_convolution(equation)
        case "ffi_call":
            shapes = [_shape(variable) for variable in (*equation.invars, *equation.outvars)]
            return calls.count_operations(equation.params["target_name"], shapes)
    counts = [count_operations(jaxpr) for jaxpr in core.jaxprs_in_params(equation.params)]
    if equation.primitive.name == "cond":
        return max(counts)
    return sum(counts) * equation.params.get("length", 1)


def _of_product(equation: core.JaxprEqn) -> int:
    (contracted, _), _ = equation.params["dimension_numbers"]
    left = _shape(equation.invars[0])
    return 2 * math.prod(_shape(equation.outvars[0])) * math.prod(left[axis] for axis in contracted)


def _of_convolution(equation: core.JaxprEqn) -> int:
    """Count a convolution; of one with a dilated input, as in a gradient, the products with its zeros are left out."""
    numbers, dilation = equation.params["dimension_numbers"], equation.params["lhs_dilation"]
    kernel = _shape(equation.invars[1])
    taps = math.prod(kernel[axis] for axis in numbers.rhs_spec[1:])  # inputs, height and width
    return 2 * math.prod(_shape(equation.outvars[0])) * taps // math.prod(dilation)


def _shape(variable: Any) -> tuple[int, ...]:
    return variable.aval.shape
