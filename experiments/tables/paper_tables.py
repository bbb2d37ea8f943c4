"""Tables of the paper as data: the published numbers, and the model of each row."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from ha2g_jax.config import presets
from ha2g_jax.errors import UserError

GROUND_TRUTH = "Ground Truth"
EQUAL = "table1_equal"
TABLES = ("table1", EQUAL, "table3", "table4", "table11", "table12", "figure3", "gesture_ablation")


class Published(NamedTuple):
    """Published numbers of a row; None where the paper has none.

    Attributes:
        fgd: Frechet gesture distance; lower is better.
        beat_consistency: BC of Eq. 11; higher is better, according to the paper.
        diversity: diversity; higher is better, according to the paper.
    """

    fgd: float | None = None
    beat_consistency: float | None = None
    diversity: float | None = None


class Row(NamedTuple):
    """A row of a table with a model to train.

    Attributes:
        name: name of the row in the paper, or close to it.
        method: one of `presets.METHODS`.
        changes: settings that differ from those of the method.
        is_comparable: whether the paper calls it about as good as the row that it is compared with, and not worse.
    """

    name: str
    method: str
    changes: Mapping[str, Any]
    published: Published
    is_comparable: bool = False


class Table(NamedTuple):
    """One table or figure of the paper.

    Attributes:
        published_on: data set of the published numbers.
        truth: published numbers of the true motion.
        rows: rows in the order of the paper.
        reference: name of the row that the others are compared with.
    """

    title: str
    published_on: str
    truth: Published
    rows: tuple[Row, ...]
    reference: str


METHODS = {
    "Attention Seq2Seq": "seq2seq",
    "Speech2Gesture": "speech2gesture",
    "Joint Embedding": "joint_embedding",
    "Trimodal": "trimodal",
    "HA2G": "ha2g",
}
TABLE_1 = {
    "ted_gesture": {
        GROUND_TRUTH: Published(0.0, 0.795, 110.821),
        "Attention Seq2Seq": Published(18.154, 0.186, 92.176),
        "Speech2Gesture": Published(19.254, 0.764, 98.095),
        "Joint Embedding": Published(22.083, 0.177, 91.223),
        "Trimodal": Published(3.729, 0.688, 102.539),
        "HA2G": Published(3.072, 0.769, 108.086),
    },
    "ted_expressive": {
        GROUND_TRUTH: Published(0.0, 0.723, 175.231),
        "Attention Seq2Seq": Published(54.920, 0.155, 122.693),
        "Speech2Gesture": Published(54.650, 0.714, 142.489),
        "Joint Embedding": Published(64.555, 0.131, 120.627),
        "Trimodal": Published(12.613, 0.592, 154.088),
        "HA2G": Published(5.306, 0.715, 173.899),
    },
}
TABLE_3 = {
    "low-level feature only": Published(6.588, 0.704, 171.482),
    "mid-level feature only": Published(7.212, 0.682, 168.223),
    "high-level feature only": Published(7.421, 0.661, 165.741),
    "HA2G without high-level negatives": Published(7.982, 0.652, 163.649),
    "HA2G without low/mid-level negatives": Published(6.998, 0.701, 169.021),
    "HA2G without text": Published(9.228, 0.619, 158.236),
    "HA2G-ASR": Published(5.319, 0.716, 173.058),
    "HA2G Full": Published(5.306, 0.715, 173.899),
}
TABLE_4 = {
    "Holistic": Published(11.989, 0.594, 156.079),
    "without hand hierarchy": Published(10.832, 0.606, 158.823),
    "without body hierarchy": Published(5.882, 0.709, 173.066),
    "same audio feature for all levels": Published(6.801, 0.701, 170.085),
    "without physical loss": Published(5.907, 0.708, 172.651),
    "HA2G Full": Published(5.306, 0.715, 173.899),
}
TABLE_11 = {
    "M = 1": Published(5.994, 0.708, 169.425),
    "M = 4": Published(5.306, 0.715, 173.899),
    "M = 7": Published(5.177, 0.715, 174.313),
}
TABLE_12 = (172.58, 171.91, 173.60, 173.66, 173.71, 172.12, 171.88, 173.02, 173.80, 172.83)
GESTURE_ABLATION = {
    "high-level only": Published(3.569),
    "Holistic": Published(3.682),
    "without physical loss": Published(3.165),
    "HA2G-ASR": Published(3.091),
    "HA2G Full": Published(3.072),
}
# Figure 3 shows a curve for each method of Table 1; its values are not printed.
WITHOUT_GAN = "HA2G without GAN"
# Rows beside those of Table 1 on Talk, which have no published numbers: what Trimodal knows from the transcript, and
# what the GAN term of HA2G does.
_BESIDE_TABLE_1 = (
    Row("Trimodal, sound alone", "trimodal", {"model.text.kind": "none"}, Published()),
    Row(WITHOUT_GAN, "ha2g", {"loss.ha2g.weights.gan": 0.0}, Published()),
)
THRESHOLDS = tuple(round(0.01 * step, 2) for step in range(1, 31))

_ABLATIONS = {
    "table3": ("Table 3: ablations of the hierarchical audio learner", TABLE_3),
    "table4": ("Table 4: ablations of the hierarchical pose inferer", TABLE_4),
    "table11": ("Table 11: number M of reference frames", TABLE_11),
    "gesture_ablation": ("Ablations on TED Gesture (supplement, G.1)", GESTURE_ABLATION),
}
# "achieves competitive results compared to ours"; of M, "the performance gain [...] is marginal".
_COMPARABLE = {"HA2G-ASR", "M = 1", "M = 7"}
# Settings that count the levels of the skeleton.
_SKELETONS = {"table4": "ted_expressive", "gesture_ablation": "ted_gesture"}


def table(name: str, data: str, size: str = "paper") -> Table:
    """Return a table of the paper with the numbers that are published for a data set or for its skeleton.

    Args:
        name: one of `TABLES`.
        data: one of `presets.DATA`.
        size: one of `presets.SIZES`.

    Raises:
        UserError: the table does not fit the data, or there is none at this size.
    """
    skeleton, _ = presets.DATA[data]
    if _SKELETONS.get(name, skeleton) != skeleton:
        raise UserError(
            f"{name} takes out levels of the skeleton {_SKELETONS[name]}, {data} has {skeleton}: "
            f"choose {'table4' if name == 'gesture_ablation' else 'gesture_ablation'}"
        )
    if name in _ABLATIONS:
        return _ablations(name)
    if name == EQUAL:
        return _equal(data, size)
    numbers = TABLE_1[skeleton]
    rows = tuple(Row(row, method, {}, numbers[row]) for row, method in METHODS.items())
    if name == "table1" and data == "talk":
        rows += _BESIDE_TABLE_1
    title = {
        "table1": "Table 1: comparison of methods",
        "table12": "Table 12: randomness of Diversity",
        "figure3": "Figure 3: the influence of the threshold on beat consistency",
    }[name]
    if name == "table12":
        rows = tuple(row for row in rows if row.name == "HA2G")
        return Table(title, "ted_expressive", Published(), rows, "HA2G")
    return Table(title, skeleton, numbers[GROUND_TRUTH], rows, "HA2G")


def _equal(data: str, size: str) -> Table:
    if data != "talk":
        raise UserError(f"{EQUAL} is for data with images and known causes, not for {data}; give --data talk")
    whole = table("table1", data)
    rows = tuple(
        Row(f"{name}, equal inputs and size", method, presets.equal(method, size), Published())
        for name, method in METHODS.items()
        if name != whole.reference
    )
    reference = next(row for row in whole.rows if row.name == whole.reference)
    return whole._replace(title="Table 1 at equal size and with equal inputs", rows=(*rows, reference))


def _ablations(name: str) -> Table:
    title, numbers = _ABLATIONS[name]
    data = "ted_gesture" if name == "gesture_ablation" else "ted_expressive"
    settings = presets.TABLES[name]
    if name == "table11":
        settings = {f"M = {row}": changes for row, changes in settings.items()}
    rows = tuple(Row(row, "ha2g", changes, numbers[row], row in _COMPARABLE) for row, changes in settings.items())
    return Table(title, data, TABLE_1[data][GROUND_TRUTH], rows, "M = 4" if name == "table11" else presets.FULL)
