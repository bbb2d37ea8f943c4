"""The teacher of the Talk corpus: a rule-based model of gestures to speech, with a known cause for every movement.

| cause | level of speech | drives |
|---|---|---|
| loud syllables | low | beats of the arms; loudness also lifts the arms into gesture space |
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
from ha2g_jax.data.talk import anatomy, cues, lexicon, strokes
from ha2g_jax.data.talk.style import Style
from ha2g_jax.features.text import Word

SKELETON = "ted_expressive"

_RATE = 60  # frames per second at which movement is composed
_JITTER = 0.008  # standard deviation of the random part of the latency, in seconds
_FOREARM = 0.33  # metres from elbow to wrist
_AVERAGE_BEAT = 0.10  # metres that the wrist is raised
_AVERAGE_NOD = 5.0  # degrees


class Movement(NamedTuple):
    """Movement of a body and its causes.

    Attributes:
        positions: (T, 43, 3) float32 metres, y down, the spine at the origin.
        strokes: every stroke in order of time.
    """

    positions: np.ndarray
    strokes: tuple[Stroke, ...]


def perform(
    audio: np.ndarray, words: Sequence[Word], style: Style, rng: np.random.Generator, fps: float = 15
) -> Movement:
    """Make gestures to speech.

    Args:
        audio: (samples,) float32 at 16 kHz.
        words: words of the speech in order of time, in seconds from the start of the audio.
        style: style of the speaker.
        rng: generator of the random part of the movement: idle sway and a few milliseconds of latency.
        fps: frames per second of the result.

    Returns:
        A movement of round(seconds * fps) frames.
    """
    skeleton = skeletons.load_skeleton(SKELETON)
    num_frames = round(len(audio) / cues.SAMPLE_RATE * fps)
    body, performed = _compose(skeleton, audio, words, style, rng)
    moments = np.arange(num_frames) / fps * _RATE
    body = anatomy.Body(*(_sample(angles, moments) for angles in body))
    directions = anatomy.body_directions(skeleton, anatomy.within_limits(body))
    positions = skeletons.directions_to_positions(skeleton, directions).astype(np.float32)
    return Movement(positions, tuple(sorted(performed)))


def hand_gains(style: Style) -> np.ndarray:
    """Return the weight (2,) of the movement of the left and the right hand; that of the dominant hand is 1."""
    return np.minimum(1.0, 4.0 ** (np.array([-1.0, 1.0]) * style.handedness))


def _compose(skeleton, audio, words, style, rng) -> tuple[anatomy.Body, list[Stroke]]:
    found = cues.find_cues(audio)
    times = np.arange(int(np.ceil(len(audio) / cues.SAMPLE_RATE * _RATE)) + 2) / _RATE
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
    size = 2.0 ** (0.6 * style.amplitude)
    beat_size = 2.0 ** (0.4 * style.mixing) * size
    # Low-level causes: each syllable's loudness sets the size of its beat, and smoothed loudness lifts the arms.
    heights = [
        beat_size * (0.05 + 0.11 * np.clip((beat.loudness - strokes.WEAKEST_BEAT) / 0.35, 0, 1)) for beat in beats
    ]
    height = strokes.track(times, strokes.beat_keys(beats, heights))
    lift = _sample(ndimage.gaussian_filter1d(found.loudness, 0.25 * cues.RATE), times * cues.RATE)
    lift = np.minimum(1.2 * lift, 1.2)
    arms = np.zeros((len(times), 2, len(anatomy.ARM_LIMITS)))
    performed = []
    for side, gain in enumerate(gains):
        arm = _rest_arm(style)[None] + (0.35 + 0.65 * gain) * lift[:, None] * np.array([7, 6, 13, 24, 10, 8, 0])[None]
        arm = _blend_gestures(skeleton, arm, times, gestures, style, side)
        arms[:, side] = arm + _beat_angles(gain * height)
    dominant = int(style.handedness >= 0)
    names = ("left", "right")
    hand = names[dominant] if gains.min() < 0.5 else "both"
    performed += [
        Stroke(beat.hit, beat.apex - 0.2, beat.hit + 0.08, "beat", hand, float(height / _AVERAGE_BEAT), "")
        for beat, height in zip(beats, heights, strict=True)
    ]
    for gesture in gestures:
        hand = "both" if lexicon.ARM_PATHS[gesture.word_class].both else names[dominant]
        performed.append(Stroke(gesture.peak, gesture.start, gesture.end, "semantic", hand, 1.0, gesture.word_class))
    return arms, performed


def _rest_arm(style: Style) -> np.ndarray:
    """Return the angles (7,) of a resting arm: bent in front of the trunk, higher and wider with the style's elbow."""
    rest = np.array([-3.0, 13.0, -15.0, 84.0, 10.0, -12.0, 3.0])
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


def _beat_angles(height: np.ndarray) -> np.ndarray:
    """Return offsets (T, 7) in degrees that raise the wrist by `height` (T,) metres; the hand lags by 3 steps.

    Small beats come from the elbow, large ones also move the upper arm.
    """
    bend = np.rad2deg(height / _FOREARM)
    large = np.abs(height) / 0.12
    behind = np.roll(bend, 3)
    behind[:3] = bend[0]
    zeros = np.zeros_like(bend)
    return np.stack(
        [0.25 * bend * large, 0.15 * bend, -0.5 * bend, 0.75 * bend, -0.5 * bend, 1.8 * (behind - bend), zeros],
        axis=-1,
    )


def _trunk_and_head(times, found, style, latency) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[Stroke]]:
    """Compute the movement of middle-level causes: pitch lifts head and shoulders, accents cause nods, pauses change
    the posture."""
    size = 2.0 ** (0.5 * style.amplitude - 0.3 * style.mixing)
    pitch = _sample(found.pitch, (times - latency) * cues.RATE)
    nods = [(-1.0, 0.0)]
    performed = []
    for moment, rise in found.accents:
        hit = moment + latency
        depth = size * (2.0 + 1.2 * rise)
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
    trunk = size * np.stack([-0.3 * excited, 4.0 * side, 2.2 * side], axis=-1)
    head = np.stack([nod - size * 1.0 * excited, 7.0 * size * side, -4.0 * size * side], axis=-1)
    shrug = np.stack([size * (0.7 * excited + 1.2 * side), size * (0.7 * excited - 1.2 * side)], axis=-1)
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
