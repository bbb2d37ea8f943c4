"""Comparison of HA2G with and without its GAN term: is the motion nearer to the truth, and is the fit kept?"""

from collections.abc import Mapping, Sequence

from ha2g_jax.study.reproduction.claims import Measured, Spread, interval, over_seeds, paired
from ha2g_jax.study.reproduction.paper_tables import WITHOUT_GAN
from ha2g_jax.study.reproduction.run_estimates import MODEL, TRUTH, Scores, estimate
from ha2g_jax.study.reproduction.tables import RowScores, markdown, spread_text

WITH_GAN = "HA2G"
_MEASURES = {"jerk_ratio": "jerk / truth", "fgd": "FGD", "diversity_l1": "Diversity (L1)"}
_TOLERANCE = 0.05  # share by which the reconstruction term may be larger with the GAN term


def gan_lines(scores: RowScores, validation: Mapping[str, Mapping[int, float]], split: str) -> list[str]:
    """Write the distances to the truth with and without the GAN term, and whether the term helps.

    The term helps if one of the measures is nearer to the truth, with a 95 % interval over seeds that excludes 0, and
    the reconstruction term on the validation split is at most 5 % larger on average.

    Args:
        scores: name of a row -> seed -> scores.
        validation: name of a row -> seed -> reconstruction term on the validation split.
        split: name of the split.

    Returns:
        Lines of Markdown; none where no seed has both rows.
    """
    pair = [scores.get(name, {}) for name in (WITH_GAN, WITHOUT_GAN)]
    lines: list[tuple[str, ...]] = [("measure", "with GAN", "without", "difference [95 %]", "with the term")]
    are_nearer = []
    for metric, title in _MEASURES.items():
        distances = [_distances(mine, split, metric) for mine in pair]
        difference = paired(*distances)
        if difference is None:
            continue
        spread = interval(difference)
        means = [over_seeds([each.value for each in mine.values()]).mean for mine in distances]
        are_nearer.append(spread.high is not None and spread.high < 0)
        lines.append((title, *(f"{mean:.3g}" for mean in means), spread_text(spread), _said(spread)))
    if len(lines) == 1:
        return []
    return ["Distance to the truth:", "", markdown(lines), "", _verdict(validation, any(are_nearer))]


def _distances(scores: Mapping[int, Scores], split: str, metric: str) -> dict[int, Measured]:
    found = {seed: [estimate(one, split, metric, row) for row in (MODEL, TRUTH)] for seed, one in scores.items()}
    return {seed: Measured(abs(mine.value - truth.value)) for seed, (mine, truth) in found.items() if mine and truth}


def _said(spread: Spread) -> str:
    if spread.low is None or spread.high is None or spread.low <= 0 <= spread.high:
        return "undecided"
    return "nearer" if spread.high < 0 else "farther"


def _verdict(validation: Mapping[str, Mapping[int, float]], is_nearer: bool) -> str:
    ours, without = (validation.get(name, {}) for name in (WITH_GAN, WITHOUT_GAN))
    ratios: Sequence[float] = [ours[seed] / without[seed] - 1 for seed in sorted(ours.keys() & without.keys())]
    if not ratios:
        return "Whether the GAN term keeps the fit is not known: no reconstruction term on the validation split."
    spread = over_seeds(ratios)
    limits = "" if spread.low is None else f" [{spread.low:+.1%}, {spread.high:+.1%}]"
    is_kept = spread.mean <= _TOLERANCE
    helps = "helps" if is_nearer and is_kept else "was not shown to help"
    return (
        f"With the GAN term the reconstruction term on the validation split is {spread.mean:+.1%}{limits} larger, "
        f"{'within' if is_kept else 'more than'} {_TOLERANCE:.0%}. The GAN term **{helps}**."
    )
