"""Diversity: how far apart the gestures of a set lie in the latent space of the pose auto-encoder."""

from typing import NamedTuple

import numpy as np


class Draws(NamedTuple):
    """Mean distance between the pairs of each random draw (NaN where there is no pair)."""

    l1: np.ndarray
    l2: np.ndarray


def diversity(
    latents: np.ndarray, sources: np.ndarray, *, num_pairs: int = 500, num_draws: int = 10, seed: int = 0
) -> Draws:
    """Mean distance between gestures of different recordings, in several random draws of pairs (Tables 1 and 12).

    Pairs are unordered and distinct within a draw, and never of one recording, whose overlapping windows differ little.
    All pairs are equally likely. Where there are no more than `num_pairs`, each draw has them all.

    Args:
        latents: (n, d) latent of each window.
        sources: (n,) label of the recording each window is cut from.
        num_pairs: pairs of a draw.
        num_draws: number of draws.
        seed: seed of the draws.

    Returns:
        L1 and L2 distances, (num_draws,) each, in units of the latents.
    """
    latents = np.asarray(latents, np.float64)
    _, members, sizes = np.unique(np.asarray(sources), return_inverse=True, return_counts=True)
    order = np.argsort(members, kind="stable")
    # In the order of sources, a row is paired with every row behind its own source: pair k of all is found by counting.
    ends = np.repeat(np.cumsum(sizes), sizes)
    last = np.cumsum(len(order) - ends)  # number of the first pair that is not of this row or an earlier one
    total = int(last[-1]) if len(last) else 0
    rng = np.random.default_rng(seed)
    distances = np.full((2, num_draws), np.nan)
    for draw in range(num_draws if total else 0):
        pairs = rng.choice(total, num_pairs, replace=False) if num_pairs < total else np.arange(total)
        first = np.searchsorted(last, pairs, side="right")
        second = len(order) - (last[first] - pairs)
        difference = latents[order[first]] - latents[order[second]]
        distances[:, draw] = np.abs(difference).sum(axis=1).mean(), np.linalg.norm(difference, axis=1).mean()
    return Draws(*distances)


def multimodality(latents: np.ndarray, *, order: int = 1) -> float:
    """Mean distance between the gestures that a method makes of one and the same speech, over several speeches.

    Unlike diversity it says how many answers a method has to one input: 0 for a method without randomness.

    Args:
        latents: (inputs, samples, d) latents of several samples for each input.
        order: 1 for L1 distances, 2 for L2.

    Returns:
        The mean over inputs and pairs of samples; NaN with fewer than two samples or no input.
    """
    latents = np.asarray(latents, np.float64)
    first, second = np.triu_indices(latents.shape[1], k=1)
    if not len(latents) or not len(first):
        return np.nan
    pairs = [np.linalg.norm(samples[first] - samples[second], ord=order, axis=1).mean() for samples in latents]
    return float(np.mean(pairs))


LEGACY_BATCHES = 500


def legacy_diversity(latents: np.ndarray, batch_size: int, seed: int | np.random.Generator) -> float:
    """Diversity as the public release measured it: whole batches against whole batches, for comparison only.

    The first 500 batches, in order, meet the first 500 of a random permutation of all batches, row by row. The value
    depends on the batch size, and a batch may meet itself. The last, partial batch is dropped.

    Args:
        latents: (n, d) latents in the order of the loader.
        batch_size: rows of a batch.
        seed: seed, or a generator, whose `permutation(num_batches)` is the second order.

    Returns:
        Mean L1 distance over the rows; NaN without a whole batch.
    """
    num_batches = len(latents) // batch_size
    if not num_batches:
        return np.nan
    batches = np.asarray(latents, np.float64)[: num_batches * batch_size].reshape(num_batches, batch_size, -1)
    others = batches[np.random.default_rng(seed).permutation(num_batches)]
    difference = batches[:LEGACY_BATCHES] - others[:LEGACY_BATCHES]
    return float(np.abs(difference).sum(axis=-1).mean())
