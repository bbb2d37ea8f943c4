"""Agreement of participants beyond chance: Fleiss' kappa, also where not all of them answer all items."""

import numpy as np

from ha2g_jax.apps.user_study.crossed import Estimate, crossed, jackknife


def fleiss_kappa(table: np.ndarray) -> np.ndarray:
    """Return Fleiss' kappa, (P - P_e) / (1 - P_e).

    P is the mean over items of the share of pairs of answers that agree, sum_j n_ij (n_ij - 1) / (n_i (n_i - 1)), and
    P_e = sum_j p_j^2 with p_j the mean over items of n_ij / n_i. Fleiss 1971 has the same number of answers n_i for all
    items; with other numbers these are the means of Gwet 2014, and items with fewer than two answers do not
    count.

    Args:
        table: (..., items, categories) number of answers.

    Returns:
        Kappa (...): 1 for perfect agreement, 0 for that of chance; NaN if no item has two answers, or if all answers of
        the table are of one category, where chance agrees perfectly as well.
    """
    totals = table.sum(-1)
    is_used = totals > 1
    num_items = np.maximum(is_used.sum(-1), 1)
    agree = (table * (table - 1)).sum(-1) / np.maximum(totals * (totals - 1), 1)
    agreement = np.where(is_used, agree, 0.0).sum(-1) / num_items
    shares = np.where(is_used[..., None], table / np.maximum(totals, 1)[..., None], 0.0).sum(-2) / num_items[..., None]
    chance = np.square(shares).sum(-1)
    is_defined = is_used.any(-1) & (chance < 1 - 1e-12)
    return np.where(is_defined, (agreement - chance) / np.where(is_defined, 1 - chance, 1.0), np.nan)


def agreement(participants: np.ndarray, clips: np.ndarray, items: np.ndarray, answers: np.ndarray) -> Estimate:
    """Return Fleiss' kappa of answers with an interval over participants and clips; see `crossed.crossed`.

    Args:
        participants: (n,) index of the participant of each answer.
        clips: (n,) index of the clip of each answer.
        items: (n,) index of the item of each answer.
        answers: (n,) answers, which agree if they are equal.
    """
    _, item = np.unique(items, return_inverse=True)
    _, category = np.unique(answers, return_inverse=True)
    shape = (item.max() + 1, category.max() + 1)

    def table(is_kept: np.ndarray) -> np.ndarray:
        cells = np.ravel_multi_index((item[is_kept], category[is_kept]), shape)
        return np.bincount(cells, minlength=shape[0] * shape[1]).reshape(shape)

    value = fleiss_kappa(table(np.ones(len(item), bool)))
    spreads = [
        jackknife(np.array([fleiss_kappa(table(groups != group)) for group in np.unique(groups)]))
        for groups in (participants, clips)
    ]
    return crossed(value, *spreads)
