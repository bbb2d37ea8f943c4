"""The exception for mistakes of the user, and checks of numbers and of installed packages that raise it."""

import importlib
import math
from typing import Any


class UserError(Exception):
    """An input from outside, such as a file, a flag or a checkpoint, that cannot be used.

    The message is one line: what was found, what was expected, what to do. The command line prints it without a
    traceback and exits with code 2.
    """


def check_number(value: Any, least: float, most: float, message: str) -> float:
    """Return a number of Python, NumPy or JAX as a plain Python number.

    Raises:
        UserError: the value is not a finite number from `least` to `most`; the text is `message`.
    """
    try:
        number = math.nan if isinstance(value, bool | str | bytes) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not (math.isfinite(number) and least <= number <= most):
        raise UserError(message)
    return number


def require(module: str, extra: str, *, by: str = "this", package: str = "", library: str = "") -> Any:
    """Import a module that one of the extras of ha2g-jax installs.

    Args:
        by: what needs the module, for the message.
        package: name of its package, if it differs from that of the module.
        library: how to install a system library that the package loads.

    Raises:
        UserError: the package, or a library that it needs, is missing.
    """
    try:
        return importlib.import_module(module)
    except (ImportError, OSError) as error:  # OSError: a library of the system
        missing = package or module.partition(".")[0].replace("_", "-")
        if isinstance(error, ModuleNotFoundError):
            raise UserError(f"{by} needs {missing}: pip install 'ha2g-jax[{extra}]'") from error
        why = " ".join(str(error).split())
        install = library or f"pip install --force-reinstall {missing}"
        raise UserError(f"{by} needs {missing}, which is installed but does not load ({why}): {install}") from error
