"""Comparison of HA2G with and without its GAN term: is the motion nearer to the truth, and is the fit kept?"""

from collections.abc import Mapping, Sequence

from tables.claims import Measured, Spread, interval, over_seeds, paired
from tables.paper_tables import WITHOUT_GAN
from tables.run_estimates import MODEL, TRUTH, Scores, estimate
from tables.tables import RowScores, markdown, number, spread_text

_WITH_GAN = "HA2G"
_MEASURES = {"jerk_ratio": "jerk / truth", "fgd": "FGD", "diversity_l1": "Diversity (L1)"}
_TOLERANCE = 0.05  # share by which the reconstruction term may be larger with the GAN term
_NEARER = "nearer"
_RULE = f"""\
The GAN term helps if one of these distances to the truth is smaller with it, with a 95 % interval over seeds that \
excludes 0 (not corrected for their number), and if the reconstruction term on the validation split is at most \
{_TOLERANCE:.0%} larger."""


def gan_lines(scores: RowScores, validation: Mapping[str, Mapping[int, float]], split: str) -> list[str]:
    """Write the distances to the truth with and without the GAN term, and whether the term helps.

    The term helps if one of the measures is nearer to the truth, with a 95 % interval over seeds that excludes 0, and
    the reconstruction term on the validation split is at most 5 % larger on average. Seeds count that have scores of
    both rows.

    Args:
        scores: name of a row -> seed -> scores.
        validation: name of a row -> seed -> reconstruction term on the validation split.
        split: name of the split.

    Returns:
        Lines of Markdown; none where no seed has both rows.
    """
    pair = [scores.get(name, {}) for name in (_WITH_GAN, WITHOUT_GAN)]
    seeds = sorted(pair[0].keys() & pair[1].keys())
    lines: list[tuple[str, ...]] = [("distance to the truth", "with GAN", "without", "difference [95 %]", "verdict")]
    spreads = []
    for metric, title in _MEASURES.items():
        distances = [_distances({seed: mine[seed] for seed in seeds}, split, metric) for mine in pair]
        difference = paired(*distances)
        if difference is None:
            continue
        spreads.append(interval(difference))
        means = [over_seeds([each.value for each in mine.values()]).mean for mine in distances]
        lines.append((title, *map(number, means), spread_text(spreads[-1]), _said(spreads[-1])))
    if not spreads:
        return []
    is_nearer = any(_said(each) == _NEARER for each in spreads)
    return [_RULE, "", markdown(lines), "", _verdict(validation, seeds, is_nearer)]


def _distances(scores: Mapping[int, Scores], split: str, metric: str) -> dict[int, Measured]:
    found = {seed: [estimate(one, split, metric, row) for row in (MODEL, TRUTH)] for seed, one in scores.items()}
    return {seed: Measured(abs(mine.value - truth.value)) for seed, (mine, truth) in found.items() if mine and truth}


def _said(spread: Spread) -> str:
    if spread.low is None or spread.high is None or spread.low <= 0 <= spread.high:
        return "undecided"
    return _NEARER if spread.high < 0 else "farther"


def _verdict(validation: Mapping[str, Mapping[int, float]], seeds: Sequence[int], is_nearer: bool) -> str:
    ours, without = (validation.get(name, {}) for name in (_WITH_GAN, WITHOUT_GAN))
    if not all(seed in ours and seed in without for seed in seeds):
        return "Whether the fit is kept is not known, because a run has not logged the reconstruction term."
    spread = over_seeds([ours[seed] / without[seed] - 1 for seed in seeds])
    limits = "" if spread.low is None else f" [{spread.low:+.1%}, {spread.high:+.1%}]"
    helps = "helps" if is_nearer and spread.mean <= _TOLERANCE else "was not shown to help"
    return (
        f"The reconstruction term on the validation split changes by {spread.mean:+.1%}{limits} with the GAN term. "
        f"The GAN term **{helps}**."
    )
