"""The chance level is that of others' speech, fairly drawn and cut to the motion's length."""

import numpy as np
import pytest

from ha2g_jax.metrics.beats.alignment import Clip, align, mismatched, partners, with_partners


def clip(onsets, end: float = 2.0, beats=(0.5, 1.5), start: float = 0.0) -> Clip:
    return Clip(np.array(beats, float), np.array(onsets, float), start, end)


def many(
    count: int,
    rng: np.random.Generator,
) -> list[Clip]:
    ends = rng.uniform(2, 20, count)
    return [clip(np.sort(rng.uniform(0, end, 8)), end, np.sort(rng.uniform(0, end, 5)), 0.2) for end in ends]


def test_partners_are_other_recordings_with_sound_that_last_as_long():
    rng = np.random.default_rng(0)
    clips = many(60, rng)
    clips[3] = clips[3]._replace(onsets=np.zeros(0))
    sources = np.arange(60) // 4
    drawn = partners(clips, sources, num=5, seed=1)
    assert drawn.shape == (60, 5) and (drawn >= 0).all() and not (drawn == 3).any()
    assert (sources[drawn] != sources[:, None]).all()
    assert all(len(set(row)) == 5 for row in drawn.tolist())
    ends = np.array([each.end for each in clips])
    ends[3] = 0  # cannot be drawn
    for index, row in enumerate(drawn):
        longer = np.flatnonzero((ends >= clips[index].end) & (sources != sources[index]))
        if len(longer) >= 5:
            assert set(row) <= set(longer)
        else:
            others = np.flatnonzero(sources != sources[index])
            assert set(row) == set(others[np.argsort(-ends[others])][:5])
    np.testing.assert_array_equal(drawn, partners(clips, sources, num=5, seed=1))
    assert (drawn != partners(clips, sources, num=5, seed=2)).any()
    still = [each._replace(beats=np.zeros(0)) for each in clips]
    np.testing.assert_array_equal(drawn, partners(still, sources, num=5, seed=1))


def test_every_partner_is_drawn_as_often():
    clips = [clip([0.5 + 0.01 * index]) for index in range(12)]
    sources = [0, 0, 0, *range(1, 10)]
    counts = np.zeros((12, 12))
    for seed in range(400):
        for index, row in enumerate(partners(clips, sources, num=3, seed=seed)):
            counts[index, row] += 1
    assert not counts[:3, :3].any() and not np.diag(counts).any()
    np.testing.assert_allclose(counts[0, 3:], 400 * 3 / 9, rtol=0.3)
    np.testing.assert_allclose(np.delete(counts[5], 5), 400 * 3 / 11, rtol=0.35)


def test_few_recordings_leave_gaps_and_one_leaves_it_undefined():
    clips = [clip([0.5]), clip([0.7]), clip([0.9])]
    assert np.sort(partners(clips, [0, 0, 1], num=2)).tolist() == [[-1, 2], [-1, 2], [0, 1]]
    assert np.isnan(mismatched(clips, [0, 0, 0])).all()
    assert np.isnan(mismatched([clip([]), clip([])], [0, 1])).all()
    assert mismatched([], []).shape == (0,)


def test_scores_are_those_of_the_others_speech():
    rng = np.random.default_rng(3)
    clips = many(30, rng)
    sources = np.arange(30) // 2
    drawn = partners(clips, sources, num=4, seed=0)
    expected = []
    for own, row in zip(clips, drawn, strict=True):
        paired = []
        for other in (clips[index] for index in row):
            length = other.end - other.start
            times = other.onsets[(other.onsets >= other.start) & (other.onsets < other.end)] - other.start
            times = np.concatenate([times + copy * length for copy in range(20)]) + own.start
            paired.append(own._replace(onsets=times))
        expected.append(np.nanmean(align(paired).f))  # without those that are silent so long
    np.testing.assert_allclose(mismatched(clips, sources, 4, 0), expected, atol=1e-9)
    np.testing.assert_allclose(with_partners(clips, drawn), expected, atol=1e-9)


def test_a_longer_recording_is_cut_and_its_silence_left_out():
    early, late = clip([0.5, 1.5], end=9.0), clip([5.0], end=9.0)
    short = clip([1.0])
    assert mismatched([short, early, late], [0, 1, 2])[0] == pytest.approx(1)
    assert np.isnan(mismatched([short, late], [0, 1])[0])


def test_a_shorter_recording_is_repeated():
    beats = (0.5, 2.5, 4.5)
    assert mismatched([clip([3.0], end=6.0, beats=beats), clip([0.5])], [0, 1])[0] == pytest.approx(1)
