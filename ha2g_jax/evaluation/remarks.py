"""Sentences on the results of an evaluation: where a score is not reliable, and what was left out."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ha2g_jax import metrics
from ha2g_jax.data.records import WINDOW_FRAMES
from ha2g_jax.evaluation.rows import Rows
from ha2g_jax.metrics.frechet import SAMPLES_PER_DIMENSION
from ha2g_jax.metrics.giveaway import is_tested_by_time
from ha2g_jax.metrics.row import FGD_SEEDED_CUT, Row, reference_cut, row_latents
from ha2g_jax.metrics.sanity import HALF, SANITY_ROWS, TRUTH

if TYPE_CHECKING:
    from ha2g_jax.evaluation.features import PoseFeatures

_MANY = 1.3  # times as many beats as ground truth, a sign of jitter; dense beats are near some onset by chance
_FEW = 0.5

_RELIABLE = 10  # recordings; the percentile interval of 10 normal values leaves their mean out in 10 % of the cases

_BY_CHANCE = (TRUTH, HALF)

_NO_AUTOENCODER = (
    "no FGD and no diversity without a pose auto-encoder; train one with "
    "`ha2g train --config autoencoder:DATA --workdir WORKDIR` and give --autoencoder WORKDIR"
)

_TESTED_BY_TIME = (
    "only one recording has 5 s of motion, so that what gives motion away is tested on held-out blocks of it; areas "
    "are then larger than between recordings"
)

_BIAS = (
    "resampling recordings makes a distance larger on average, so that its interval may lie above its value; "
    f"compare the distance of a row with that of the row {HALF}"
)


def won_metrics(rows: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return a sentence for each metric in which a sanity row goes further in the "better" direction than truth."""
    sentences = []
    for key, metric in metrics.of_section("rows").items():
        true = _value(rows[TRUTH], key)
        if metric.direction == "none" or true is None:
            continue
        sign = 1 if metric.direction == "higher" else -1
        found = {name: _value(rows.get(name, {}), key) for name in SANITY_ROWS if name not in _BY_CHANCE}
        winners = [
            f"{name} ({value:.{metric.digits}f})"
            for name, value in found.items()
            if value is not None and round(sign * (value - true), metric.digits) > 0
        ]
        if winners:
            sentences.append(
                f"{metric.heading}: {', '.join(winners)} {metric.direction} than ground truth "
                f"({true:.{metric.digits}f}), so {metric.direction} is not better"
            )
    return sentences


def beat_rates(rows: Mapping[str, Mapping[str, Any]], methods: Sequence[str]) -> list[str]:
    """Return a sentence for each method that has far more or far fewer motion beats than ground truth."""
    true = _value(rows[TRUTH], "beats_per_second")
    sentences = []
    for name in methods:
        rate = _value(rows[name], "beats_per_second")
        if not true or rate is None or _FEW * true <= rate <= _MANY * true:
            continue
        found = f"{name}: {rate:.2f} beats/s, ground truth {true:.2f}"
        jerk = _value(rows[name], "jerk_ratio")
        if rate < true:
            sentences.append(f"{found}: far fewer, whatever the F")
        else:
            rough = "" if jerk is None else f", and {jerk:.1f} times its jerk"
            sentences.append(f"{found}{rough}: its F and BC are those of dense beats")
    return sentences


def _value(row: Mapping[str, Any], key: str) -> float | None:
    return row[key]["value"] if key in row else None


def few_recordings(made: Rows) -> list[str]:
    """Return sentences on what one recording, or one with enough motion, cannot tell, and on unreliable intervals."""
    if (count := made.reference.num_recordings) > 1:
        return [*too_few_recordings(count), *[_TESTED_BY_TIME] * is_tested_by_time(made.truth)]
    return [
        "all clips are of one recording, so there are no intervals, no mismatched speech and no other half, and what "
        "gives motion away is tested on blocks of its time; give clips of several recordings"
    ]


def too_few_recordings(count: int) -> list[str]:
    """Return a sentence on intervals over so few recordings that they are too narrow."""
    if not 1 < count < _RELIABLE:
        return []
    return [
        f"intervals of {count} recordings are too narrow: those of a difference between equal methods leave 0 out far "
        f"more often than in 5 % of the cases; give {_RELIABLE} recordings or more"
    ]


def without_sound(made: Rows) -> list[str]:
    """Return a sentence on the clips whose beats are not scored."""
    missing = [name for name, onsets in zip(made.ids, made.truth.onsets, strict=True) if onsets is None]
    if not missing:
        return []
    return [
        f"{len(missing)} of {len(made.ids)} clips have no sound, such as {missing[0]}, so their beats are not scored; "
        "put a file of sound with the name of the clip beside its reference"
    ]


def latent_warnings(truth: Row, autoencoder: "PoseFeatures | None") -> list[str]:
    """Return sentences on distances that are not reliable."""
    found = truth.once(row_latents)
    if autoencoder is None or found is None:
        return []
    sentences, count, latent_dim = [], len(found.latents), autoencoder.latent_dim
    if count < SAMPLES_PER_DIMENSION * latent_dim:
        sentences.append(
            f"{count} windows for {latent_dim} latent values, less than {SAMPLES_PER_DIMENSION} times as many: the FGD "
            f"says more about their number than about the motion; compare it with the row {HALF}"
        )
    if found.cut.name == FGD_SEEDED_CUT:
        title = metrics.lookup("fgd_seeded").title
        sentences.append(f"clips are too short to leave the seed pose out of a window, so the distance is {title}")
    return sentences


def latent_notes(truth: Row, autoencoder: "PoseFeatures | None") -> list[str]:
    """Return sentences on clips without latents."""
    cut = truth.reference.once(reference_cut)
    if autoencoder is None:
        return [_NO_AUTOENCODER]
    if cut is None:
        return [f"no clip has {WINDOW_FRAMES} frames, so no FGD and no diversity"]
    short = sum(not cut.starts(len(directions)) for directions in truth.directions)
    return [_BIAS] + ([f"{short} clips are shorter than a window and not part of FGD and diversity"] if short else [])
