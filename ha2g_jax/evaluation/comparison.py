"""Two evaluations side by side, where they can be compared."""

from collections.abc import Mapping
from typing import Any

from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.intervals import number


def compare(first: Mapping[str, Any], second: Mapping[str, Any]) -> dict[str, Any]:
    """Compare two results of `evaluate`.

    Args:
        first, second: sections of results.

    Returns:
        {row: {metric: {"first", "second", "difference"}}} of the rows and metrics that both have.

    Raises:
        UserError: both have an FGD, but of two auto-encoders; or they are of two skeletons or frame rates.
    """
    ids = [results["autoencoder"] and results["autoencoder"]["id"] for results in (first, second)]
    if None not in ids and ids[0] != ids[1]:
        raise UserError(
            f"one FGD is of the pose auto-encoder {ids[0][:16]}, the other of {ids[1][:16]}: distances in two latent "
            "spaces cannot be compared; evaluate both with one --autoencoder"
        )
    for key in ("skeleton", "fps"):
        if first["data"][key] != second["data"][key]:
            raise UserError(
                f"one evaluation is of {key} {first['data'][key]}, the other of {second['data'][key]}; scores of two "
                "kinds of motion cannot be compared"
            )
    return {
        row: {
            metric: _side_by_side(first["rows"][row][metric], second["rows"][row][metric])
            for metric in first["rows"][row]
            if metric in second["rows"][row]
        }
        for row in first["rows"]
        if row in second["rows"]
    }


def _side_by_side(first: dict[str, Any], second: dict[str, Any]) -> dict[str, Any]:
    values = (first["value"], second["value"])
    difference = None if None in values else number(values[1] - values[0])
    return {"first": first, "second": second, "difference": difference}
