"""Metrics of motion: pure numpy functions of arrays, and the table of all registered metrics.

Motion with values that are not numbers scores NaN; functions that detect beats raise a ValueError.
A new metric is one file that defines a `Metric`, an import here, and one line in `_REGISTERED`.
"""

from ha2g_jax.errors import UserError
from ha2g_jax.metrics import (
    causes,
    diversity,
    frechet,
    giveaway,
    hands,
    kinematics,
    legacy,
    reconstruction,
    seams,
    takes,
)
from ha2g_jax.metrics.beats import rests, row_alignment, strokes
from ha2g_jax.metrics.metric import Metric, Section

# All metrics, in the order of the columns.
_REGISTERED: tuple[Metric, ...] = (
    *row_alignment.BEAT_METRICS,
    frechet.FGD,
    frechet.FGD_SEEDED,
    frechet.FGD_EXTRAPOLATED,
    diversity.DIVERSITY_L1,
    diversity.DIVERSITY_L2,
    diversity.MULTIMODALITY,
    kinematics.L1_DIVERSITY,
    kinematics.SPEED_HELLINGER,
    kinematics.ACCELERATION,
    kinematics.ACCELERATION_RATIO,
    kinematics.JERK,
    kinematics.JERK_RATIO,
    kinematics.LIMITS_MEAN,
    kinematics.LIMITS_WORST,
    kinematics.LIMITS_ANY,
    seams.SEAM_VELOCITY,
    seams.SEAM_VELOCITY_P,
    seams.SEAM_ACCELERATION,
    seams.SEAM_ACCELERATION_P,
    *hands.HAND_METRICS,
    *giveaway.GIVEAWAY_METRICS,
    reconstruction.JOINT_MAE,
    reconstruction.ACCELERATION_ERROR,
    reconstruction.PCK,
    reconstruction.CCA,
    *legacy.LEGACY_METRICS,
    *causes.CAUSE_METRICS,
    *takes.TAKE_METRICS,
    causes.PROBE_ACCURACY,
    *strokes.RECORDING_METRICS,
    *hands.RECORDING_HAND_METRICS,
    *rests.BEAT2_METRICS,
)
METRICS: dict[str, Metric] = {metric.name: metric for metric in _REGISTERED}
if len(METRICS) < len(_REGISTERED):
    raise ValueError("two metrics have one name")


def lookup(name: str) -> Metric:
    """Return the registered metric with a name.

    Raises:
        UserError: no metric is registered under that name.
    """
    if name not in METRICS:
        raise UserError(f"no metric is registered as {name!r}; add it to _REGISTERED in ha2g_jax/metrics/__init__.py")
    return METRICS[name]


def of_section(section: Section) -> dict[str, Metric]:
    """Return the metrics whose scores belong to one section of the results, in the order of the columns."""
    return {name: metric for name, metric in METRICS.items() if metric.section == section}
