"""The teacher of the Talk corpus: a rule-based model of gestures to speech, with a known cause for every movement.

| cause | level of speech | drives |
|---|---|---|
| loud syllables | low | beats of the arms, whose pitch chooses the hand; loudness also lifts the arms |
| pitch and pauses | middle | head, shoulders, spine |
| class of a word | high | hand shape and the path of the arm |

The speaker's style changes size, timing and side of all of it. Fingers never follow the sound and
beats never follow the words, so that each association can be scored by itself.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from ha2g_jax import skeleton as skeletons
from ha2g_jax.data.records import Stroke
from ha2g_jax.data.talk import anatomy, lexicon, strokes
from ha2g_jax.data.talk.speakers import Style
from ha2g_jax.features.text import Word

SKELETON = "ted_expressive"

_RATE = 60  # frames per second at which movement is composed
_JITTER = 0.008  # standard deviation of the random part of the latency, in seconds
_FOREARM = 0.33  # metres from elbow to wrist
_LOUD = 1.03  # loudness from which a syllable moves both hands
_LOW_PITCH = -0.3  # semitones from which down a beat is made by the other hand
_WIDE_PITCH = 3.0  # semitones at which a beat goes as far to the side as up
_RAISED_ARM = np.array([22.0, 14.0, 30.0, 44.0, 12.0, 10.0, 0.0])  # degrees that loud speech adds to a resting arm
_AVERAGE_BEAT = 0.13  # metres that the wrist is raised
_AVERAGE_NOD = 7.5  # degrees


class Movement(NamedTuple):
    """Movement of a body and its causes.

    Attributes:
        positions: (T, 43, 3) float32 metres, y down, the spine at the origin.
        strokes: every stroke in order of time; times and amplitudes have six decimals.
    """

    positions: np.ndarray
    strokes: tuple[Stroke, ...]


def perform(
    audio: np.ndarray, words: Sequence[Word], style: Style, rng: np.random.Generator, fps: float = 15
) -> Movement:
    """Make gestures to speech (samples,) at 16 kHz and its words, round(seconds * fps) frames of them.

    The generator is that of the random part of the movement: idle sway and a few milliseconds of latency.
    """
    skeleton = skeletons.load_skeleton(SKELETON)
    num_frames = round(len(audio) / strokes.SAMPLE_RATE * fps)
    body, performed = _compose(skeleton, audio, words, style, rng)
    moments = np.arange(num_frames) / fps * _RATE
    body = anatomy.Body(*(_sample(angles, moments) for angles in body))
    directions = anatomy.body_directions(skeleton, anatomy.within_limits(body))
    positions = skeletons.directions_to_positions(skeleton, directions).astype(np.float32)
    return Movement(positions, tuple(sorted(map(_rounded, performed))))


def hand_gains(style: Style) -> np.ndarray:
    """Return the weight (2,) of the movement of the left and the right hand; that of the dominant hand is 1."""
    return np.minimum(1.0, 4.0 ** (np.array([-1.0, 1.0]) * style.handedness))


def beat_hands(beats: Sequence[strokes.Beat], style: Style) -> np.ndarray:
    """Choose the hands that make each beat, (beats, 2) left and right.

    A loud syllable moves both hands, another one of low pitch the hand that is not dominant, and the rest the dominant
    hand.
    """
    is_loud = np.array([beat.loudness >= _LOUD for beat in beats], bool)
    is_low = np.array([beat.pitch <= _LOW_PITCH for beat in beats], bool)
    by_dominant, by_other = is_loud | ~is_low, is_loud | is_low
    return np.stack([by_other, by_dominant] if style.handedness >= 0 else [by_dominant, by_other], axis=-1)


def _rounded(stroke: Stroke) -> Stroke:
    """Return a stroke without the last bits of its numbers, which differ between processors."""
    time, start, end = (round(float(moment), 6) for moment in (stroke.time, stroke.start, stroke.end))
    return stroke._replace(time=time, start=start, end=end, amplitude=round(stroke.amplitude, 6))


def _compose(skeleton, audio, words, style, rng) -> tuple[anatomy.Body, list[Stroke]]:
    found = strokes.find_cues(audio)
    times = np.arange(int(np.ceil(len(audio) / strokes.SAMPLE_RATE * _RATE)) + 2) / _RATE
    latency = strokes.LATENCY * style.latency + _JITTER * rng.standard_normal()
    beats = strokes.plan_beats(found, latency)
    gestures = strokes.plan_word_gestures(words, latency)
    arms, arm_strokes = _arms(skeleton, times, found, beats, gestures, style)
    trunk, head, shrug, body_strokes = _trunk_and_head(times, found, style, latency)
    fingers = _fingers(times, gestures, style)
    body = anatomy.Body(
        trunk + 0.5 * _sway(rng, trunk.shape),
        head + 0.6 * _sway(rng, head.shape),
        shrug,
        arms + 1.2 * _sway(rng, arms.shape),
        fingers + 0.006 * _sway(rng, fingers.shape),
    )
    return body, arm_strokes + body_strokes


def _arms(skeleton, times, found, beats, gestures, style) -> tuple[np.ndarray, list[Stroke]]:
    """Compute the angles (T, 2, 7) of the arms: rest and lift, blended with the word gestures, plus beats."""
    gains = hand_gains(style)
    beat_size = 2.0 ** (0.5 * style.amplitude + 0.25 * style.mixing)
    # Low-level causes: each syllable's loudness sets the size of its beat, and smoothed loudness lifts the arms.
    loudness = np.array([beat.loudness for beat in beats])
    heights = beat_size * (0.06 + 0.16 * np.clip((loudness - strokes.WEAKEST_BEAT) / 0.35, 0, 1))
    sideways = heights * np.clip([beat.pitch / _WIDE_PITCH for beat in beats], -1, 1)
    hands = beat_hands(beats, style)
    lift = _lift(found, times, style)
    arms = np.zeros((len(times), 2, len(anatomy.ARM_LIMITS)))
    for side, gain in enumerate(gains):
        arm = _rest_arm(style)[None] + lift[:, side, None] * _RAISED_ARM[None]
        arm = _blend_gestures(skeleton, arm, times, gestures, style, side)
        sizes = np.where(hands[:, side], np.sqrt(gain), 0.3 * gain)
        height, outward = (strokes.track(times, strokes.beat_keys(beats, sizes * size)) for size in (heights, sideways))
        arms[:, side] = arm + _beat_angles(height, outward)
    names = ("left", "right")
    performed = []
    for beat, height, made in zip(beats, heights, hands, strict=True):
        hand = "both" if made.all() else names[int(made[1])]
        size = float(height / _AVERAGE_BEAT)
        performed.append(Stroke(beat.hit, beat.apex - 0.2, beat.hit + 0.08, "beat", hand, size, ""))
    dominant = names[int(style.handedness >= 0)]
    for gesture in gestures:
        hand = "both" if lexicon.ARM_PATHS[gesture.word_class].both else dominant
        performed.append(Stroke(gesture.peak, gesture.start, gesture.end, "semantic", hand, 1.0, gesture.word_class))
    return arms, performed


def _lift(found: strokes.Cues, times: np.ndarray, style: Style) -> np.ndarray:
    """Return how far each arm is raised (T, 2), 0 at rest: loudness over a phrase, and half as much over a moment.

    A phrase of high pitch raises the dominant hand more, one of low pitch the other hand.
    """
    phrase, moment = (ndimage.gaussian_filter1d(found.loudness, width * strokes.RATE) for width in (0.6, 0.2))
    pitch = ndimage.gaussian_filter1d(found.pitch, 0.6 * strokes.RATE)
    dominant = 0.4 * np.clip(pitch / 2, -1, 1) * (1 if style.handedness >= 0 else -1)
    sides = 0.35 + 0.65 * hand_gains(style) + np.stack([-dominant, dominant], axis=-1)
    return np.minimum(_sample(1.4 * ((2 * phrase + moment) / 3)[:, None] * sides, times * strokes.RATE), 1.4)


def _rest_arm(style: Style) -> np.ndarray:
    """Return the angles (7,) of a resting arm: bent in front of the trunk, higher and wider with the style's elbow."""
    rest = np.array([-12.0, 12.0, -30.0, 56.0, 10.0, -12.0, 3.0])
    return rest + style.elbow * np.array([3.0, 7.0, -5.0, 9.0, 14.0, 0.0, 0.0])


def _blend_gestures(skeleton, arm, times, gestures, style, side) -> np.ndarray:
    dominant = int(style.handedness >= 0)
    mine = [gesture for gesture in gestures if side == dominant or lexicon.ARM_PATHS[gesture.word_class].both]
    if not mine:
        return arm
    paths = [lexicon.ARM_PATHS[gesture.word_class] for gesture in mine]
    swivel = 24 + 10 * style.elbow
    ready = [np.array([*anatomy.reach(skeleton, path.wind_up, swivel), path.pronation, 0, 0]) for path in paths]
    peak = [
        np.array([*anatomy.reach(skeleton, path.peak, swivel), path.pronation, path.extension, 0]) for path in paths
    ]
    keys, value = strokes.gesture_keys(mine, ready, peak)
    weight = strokes.track(times, keys)[:, None] * 0.9 * 2.0 ** (0.15 * (style.amplitude - style.mixing) - 0.3)
    return arm + np.minimum(weight, 1) * (strokes.track(times, value) - arm)


def _beat_angles(height: np.ndarray, outward: np.ndarray) -> np.ndarray:
    """Return offsets (T, 7) in degrees that raise the wrist by `height` (T,) metres and move it outward by `outward`.

    Small beats come from the elbow, large ones also move the upper arm; the hand lags by 3 steps.
    """
    bend, turn = np.rad2deg(height / _FOREARM), np.rad2deg(outward / _FOREARM)
    large = np.abs(height) / 0.12
    behind = np.roll(bend, 3)
    behind[:3] = bend[0]
    zeros = np.zeros_like(bend)
    offsets = [0.25 * bend * large, 0.15 * bend + 0.2 * turn, -0.5 * bend + turn, 0.75 * bend, -0.5 * bend]
    return np.stack([*offsets, 1.8 * (behind - bend), zeros], axis=-1)


def _trunk_and_head(times, found, style, latency) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[Stroke]]:
    """Compute middle-level movement: pitch lifts head and shoulders, accents cause nods, pauses change the posture."""
    size = 2.0 ** (0.5 * style.amplitude - 0.3 * style.mixing)
    pitch = _sample(found.pitch, (times - latency) * strokes.RATE)
    nods = [(-1.0, 0.0)]
    performed = []
    for moment, rise in found.accents:
        hit = moment + latency
        depth = size * (3.0 + 1.8 * rise)
        if hit - 0.3 < nods[-1][0]:
            nods.pop()
        nods += [(hit - 0.28, 0.0), (hit, depth), (hit + 0.4, 0.0)]
        performed.append(Stroke(hit, hit - 0.28, hit + 0.4, "nod", "", float(depth / _AVERAGE_NOD), ""))
    nod = strokes.track(times, nods)
    keys = strokes.plan_posture(found.pauses)
    side = strokes.track(times, keys)
    for start, end in zip(keys[1::2], keys[2::2], strict=True):
        performed.append(Stroke(end[0], start[0], end[0], "posture", "", float(size), ""))
    excited = np.clip(pitch, -3, 6)
    trunk = size * np.stack([-0.6 * excited, 7.0 * side, 3.5 * side], axis=-1)
    head = np.stack([nod - size * 1.6 * excited, 12.0 * size * side, -5.0 * size * side], axis=-1)
    shrug = np.stack([size * (1.0 * excited + 1.5 * side), size * (1.0 * excited - 1.5 * side)], axis=-1)
    return trunk, head, shrug, performed


def _fingers(times, gestures, style) -> np.ndarray:
    """Compute the flexions (T, 2, 5) of the fingers: the style's rest pose, and the shape of each word's class."""
    rest = np.array([0.40, 0.40, 0.44, 0.45, 0.44]) + 0.13 * style.curl
    fingers = np.tile(rest, (len(times), 2, 1))
    dominant = int(style.handedness >= 0)
    for side in range(2):
        mine = [gesture for gesture in gestures if side == dominant or lexicon.ARM_PATHS[gesture.word_class].both]
        if mine:
            shapes = [lexicon.HAND_SHAPES[gesture.word_class] for gesture in mine]
            keys, value = strokes.gesture_keys(mine, shapes, shapes)
            weight = strokes.track(times, keys)[:, None]
            fingers[:, side] += weight * (strokes.track(times, value) - fingers[:, side])
    return fingers


def _sway(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Draw slow noise of unit variance along the first axis."""
    width = 0.7 * _RATE
    noise = ndimage.gaussian_filter1d(rng.standard_normal(shape), width, axis=0, mode="wrap")
    return noise * np.sqrt(2 * np.sqrt(np.pi) * width)


def _sample(track: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Interpolate a track linearly at fractional positions; its ends are held."""
    positions = np.clip(positions, 0, len(track) - 1)
    before = np.minimum(positions.astype(int), max(len(track) - 2, 0))
    after = np.minimum(before + 1, len(track) - 1)
    blend = (positions - before).reshape(-1, *[1] * (track.ndim - 1))
    return track[before] + blend * (track[after] - track[before])
