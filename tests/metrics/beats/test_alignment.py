"""Deliberate stops at the onsets score, stillness and jitter do not, and chance is fairly drawn."""

import math

import numpy as np
import pytest

from ha2g_jax.metrics.beats.alignment import Clip, align, mismatched, partners, with_partners
from ha2g_jax.metrics.beats.stops import angle_change_rates, make_clips
from ha2g_jax.metrics.beats.times import audio_onsets
from ha2g_jax.metrics.legacy import legacy_bc
from ha2g_jax.skeleton import load_skeleton, normalize

SKELETON = load_skeleton("ted_expressive")
FPS = 15


def swinging_arms(angles: np.ndarray) -> np.ndarray:
    """Direction vectors (..., T, 42, 3) of the mean pose with both arms, hands included, turned by angles (..., T).

    The axis is square to clavicle and upper arm, so that the angle between them changes by as much.
    """
    pose = normalize(SKELETON.mean_directions.astype(np.float64))
    motion = np.broadcast_to(pose, (*angles.shape, *pose.shape)).copy()
    cosine, sine = np.cos(angles)[..., None, None], np.sin(angles)[..., None, None]
    for side in ("left", "right"):
        shoulder, elbow = SKELETON.bone(f"{side}_shoulder"), SKELETON.bone(f"{side}_elbow")
        arm = [index for index, (_, child) in enumerate(SKELETON.bones) if SKELETON.paths[child, elbow]]
        axis = normalize(np.cross(pose[shoulder], pose[elbow]))[None]
        along = axis * (pose[arm] @ axis.T)
        turned = (pose[arm] - along) * cosine + np.cross(axis, pose[arm]) * sine + along
        motion[..., arm, :] = turned
    return motion


def stopping_angles(stops: np.ndarray, num_frames: int, fps: float = FPS) -> np.ndarray:
    """Angles (T,) that turn back at each stop and nowhere else, fastest halfway; half a second to the first one."""
    time = np.arange(num_frames) / fps
    moments = np.concatenate([[min(0, *stops) - 0.5], stops, [max(num_frames / fps, *stops) + 0.5]])
    after = np.clip(np.searchsorted(moments, time, side="right"), 1, len(moments) - 1)
    part = (time - moments[after - 1]) / (moments[after] - moments[after - 1])
    return 0.4 * np.where(after % 2, 1, -1) * np.cos(np.pi * part)


def synthetic_motions(num: int, num_frames: int = 34, seed: int = 0) -> tuple[dict[str, np.ndarray], list[np.ndarray]]:
    """Motions (num, T, 42, 3) by name, and onsets of each clip, about 3.9 a second, in pairs.

    The motions stop on every second onset, the first of its pair; sway at 1 Hz, without and with tiny jitter; are white
    jitter; are frozen.
    """
    rng = np.random.default_rng(seed)
    gaps = rng.uniform([[0.2, 0.06]], [[0.57, 0.2]], (num, 12 + num_frames // 4, 2)).reshape(num, -1)
    sounds = np.cumsum(gaps, axis=1) - 2
    stops = [times[(times > -0.6) & (times < num_frames / FPS + 0.6)] for times in sounds[:, ::2]]
    time, shape = np.arange(num_frames) / FPS, (num, num_frames, SKELETON.num_bones, 3)
    sway = swinging_arms(0.4 * np.sin(2 * np.pi * (time[None] + rng.random((num, 1)))))
    jitter = normalize(SKELETON.mean_directions[None, None] + rng.normal(0, 0.1, shape))
    motions = {
        "stops": swinging_arms(np.stack([stopping_angles(times, num_frames) for times in stops])),
        "sway": sway,
        "sway with jitter": normalize(sway + rng.normal(0, 0.01, shape)),
        "white jitter": jitter,
        "frozen": np.repeat(jitter[:, :1], num_frames, axis=1),
    }
    return motions, [times[(times >= 0) & (times < num_frames / FPS)] for times in sounds]


def stop_beats(rate: np.ndarray, fps: float, **options) -> np.ndarray:
    """The motion beats of one clip."""
    return make_clips([rate], [np.zeros(0)], fps, **options)[0].beats


def clip(beats, onsets, start: float = 0.0, end: float = 4.0) -> Clip:
    return Clip(np.array(beats, float), np.array(onsets, float), start, end)


def test_jitter_gains_nothing_over_mismatched_speech_and_wins_by_the_legacy_rules():
    motions, onsets = synthetic_motions(300)
    found, gain, error, legacy = {}, {}, {}, {}
    for name, motion in motions.items():
        clips = make_clips(angle_change_rates(SKELETON, motion), onsets, FPS)
        found[name] = align(clips)
        gains = found[name].f - mismatched(clips, np.arange(300))
        gain[name], error[name] = gains.mean(), gains.std() / math.sqrt(300)
        legacy[name] = [legacy_bc(SKELETON, motion, onsets, variant=x) for x in ("paper", "fixed")]
    rates = {name: alignment.num_beats.sum() / alignment.seconds.sum() for name, alignment in found.items()}
    assert found["white jitter"].f.mean() > 0.6  # yet all of it by chance:
    for name in ("white jitter", "sway", "sway with jitter"):
        assert abs(gain[name]) < 1.96 * error[name] < 0.025
    assert gain["stops"] > 0.2 and gain["stops"] > 20 * error["stops"]
    assert rates["white jitter"] > 1.8 * rates["stops"] > 1.8
    frozen = found["frozen"]
    assert not (frozen.recall + frozen.precision + frozen.f + frozen.num_beats).any() and gain["frozen"] == 0
    for jitter, stops in zip(legacy["white jitter"], legacy["stops"], strict=True):
        assert jitter > stops + 0.01
    assert all(map(math.isnan, legacy["frozen"]))


@pytest.mark.parametrize("fps", [15, 24, 30, 60])
@pytest.mark.parametrize("shift", [0.0, 0.2, 0.45, 0.7])
def test_beats_lie_where_the_arms_stop(fps, shift):
    stops = 0.6 * np.arange(-1, 9) + shift / fps  # without a shift right on a frame, but for 24 fps
    motion = swinging_arms(stopping_angles(stops, round(4 * fps), fps))
    change = SKELETON.angle_change * FPS / fps  # per frame
    found = stop_beats(angle_change_rates(SKELETON, [motion], change)[0], fps)
    np.testing.assert_allclose(found * fps, stops[(stops > 0.5) & (stops < 3.9)] * fps, atol=0.1)


def test_minima_must_rise_on_both_sides_after_the_seed_poses():
    rate = np.ones(20)
    rate[[2, 4]] = 0  # the seed poses, and the first step that is scored
    rate[8] = 0.9
    rate[11], rate[12] = 0.98, 0.99
    rate[15], rate[16] = 0.96, 0.97  # 0.04 on both sides, one of them in two steps
    np.testing.assert_allclose(stop_beats(rate, 10), [0.85, 1.55 + 0.05 * 0.03 / 0.05])
    assert len(stop_beats(rate, 10, threshold=0.01)) == 3
    assert len(stop_beats(rate[:5], 10)) == len(stop_beats(rate[:0], 10)) == 0


def test_clips_of_any_length_are_those_of_each_alone():
    rng = np.random.default_rng(0)
    rates = [rng.integers(0, 6, length) / 3 for length in (33, 0, 3, 60, 5, 7, 33)]  # some of them equal
    onsets = [np.sort(rng.uniform(0, 3, 4)) for _ in rates]
    clips = make_clips(rates, onsets, 25)
    for rate, heard, made in zip(rates, onsets, clips, strict=True):
        np.testing.assert_allclose(made.beats, stop_beats(rate, 25), atol=1e-12)
        assert made.onsets is heard
        assert (made.start, made.end) == pytest.approx((4 / 25, (len(rate) + 1) / 25))
    assert sum(len(made.beats) for made in clips) > 20
    assert make_clips([], [], 15) == []


def test_alignment_is_that_of_a_plain_loop():
    rng = np.random.default_rng(5)
    clips = [
        clip(rng.uniform(0, 5, rng.integers(0, 6)), rng.uniform(0, 5, rng.integers(1, 6)), 0.5, 4.5) for _ in range(80)
    ]
    alignment = align(clips)
    for index, each in enumerate(clips):
        moves, onsets = ([x for x in times if 0.5 <= x < 4.5] for times in (each.beats, each.onsets))
        values = [math.nan] * 3
        if onsets:
            r, q = (
                sum(max((math.exp(-((x - y) ** 2) / 0.02) for y in others), default=0) for x in times)
                / max(len(times), 1)
                for times, others in ((onsets, moves), (moves, onsets))
            )
            values = [r, q, 2 * r * q / (r + q) if r + q else 0]
        found = [alignment.recall[index], alignment.precision[index], alignment.f[index]]
        np.testing.assert_allclose(found, values, atol=1e-9)
        assert (alignment.num_onsets[index], alignment.num_beats[index]) == (len(onsets), len(moves))
    assert alignment.is_silent.any() and (alignment.num_beats == 0).any()
    np.testing.assert_array_equal(alignment.take(np.array([7, 7, 2])).f, alignment.f[[7, 7, 2]])


def test_a_known_distance_scores_as_known():
    alignment = align([clip([1.1, 3.0], [1.0, 2.0, 3.0])])
    heard, meant = np.exp(-0.5) + np.exp(-0.5 * 9**2) + 1, np.exp(-0.5) + 1
    assert alignment.recall[0] == pytest.approx(heard / 3) and alignment.precision[0] == pytest.approx(meant / 2)
    assert alignment.f[0] == pytest.approx(2 * heard / 3 * meant / 2 / (heard / 3 + meant / 2))


def test_silence_is_counted_and_left_out():
    clips = [
        clip([1.0], [1.0, 2.0]),
        clip([], [1.0]),
        clip([1.0, 2.0, 3.0], []),
        clip([1.0, 2.0], [9.0]),
        clip([], [], end=8.0),
    ]
    alignment = align(clips)
    assert np.isnan(alignment.f).tolist() == alignment.is_silent.tolist() == [False, False, True, True, True]
    np.testing.assert_allclose(alignment.f[:2], [2 / 3, 0], atol=1e-6)
    assert alignment.num_onsets[:2].tolist() == [2, 1] and alignment.num_beats.tolist() == [1, 0, 3, 2, 0]
    assert np.isnan(align(clips[2:]).f).all() and np.isnan(mismatched(clips[2:], np.arange(3))).all()
    assert align([]).f.shape == (0,)


def test_onsets_of_clicks_and_none_under_the_floor():
    audio = np.random.default_rng(0).normal(0, 1e-4, 3 * 16000).astype(np.float32)
    for time in (0.5, 1.25, 2.0):
        audio[round(time * 16000) :][:800] += np.hanning(800).astype(np.float32)
    found = audio_onsets(audio, 3.0)
    distances = np.abs(found[:, None] - np.array([0.5, 1.25, 2.0])[None])
    assert distances.min(axis=0).max() < 0.08 and distances.min(axis=1).max() < 0.08
    np.testing.assert_array_equal(audio_onsets(audio, 1.6), found[found < 1.6])
    assert len(audio_onsets(0.1 * audio, 3.0))
    for silence in (0.001 * audio, 0 * audio, audio[:4000], audio[:0]):
        assert len(audio_onsets(silence, 3.0)) == 0
    assert len(audio_onsets(audio, 0.4)) == 0  # what is loud comes later
    assert audio_onsets(audio[8000:9500], 3.0).max(initial=0) < 0.1  # shorter than a spectrum
    with_noise = np.append(0.1 * audio, np.random.default_rng(1).uniform(-1, 1, 16000)).astype(np.float32)
    np.testing.assert_array_equal(audio_onsets(with_noise, 3.0), audio_onsets(0.1 * audio, 3.0))


def many(count: int, rng: np.random.Generator) -> list[Clip]:
    ends = rng.uniform(2, 20, count)
    return [clip(np.sort(rng.uniform(0, end, 5)), np.sort(rng.uniform(0, end, 8)), 0.2, end) for end in ends]


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


def test_few_recordings_leave_gaps_and_one_leaves_it_undefined():
    clips = [clip([0.5, 1.5], [0.5], end=2), clip([0.5, 1.5], [0.7], end=2), clip([0.5, 1.5], [0.9], end=2)]
    assert np.sort(partners(clips, [0, 0, 1], num=2)).tolist() == [[-1, 2], [-1, 2], [0, 1]]
    assert np.isnan(mismatched(clips, [0, 0, 0])).all()
    assert np.isnan(mismatched([clip([0.5, 1.5], [], end=2), clip([0.5, 1.5], [], end=2)], [0, 1])).all()
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


def test_times_that_are_not_numbers_are_refused():
    onsets = np.array([0.5, 1.0])
    for beats, sounds in ((np.array([np.nan, 1.0]), onsets), (onsets, np.array([0.5, np.nan]))):
        with pytest.raises(ValueError, match="at times that are not numbers"):
            align([Clip(beats, sounds, 0.0, 2.0)])
    directions = np.tile(SKELETON.mean_directions, (40, 1, 1))
    directions[20] = np.nan
    with pytest.raises(ValueError, match="directions that are not numbers"):
        angle_change_rates(SKELETON, [directions])
