"""The teacher of the Talk corpus: a rule-based generator of gestures with a known cause for every movement.

| cause | level of speech | drives |
|---|---|---|
| loud syllables | low | beats of the hands |
| phrases | low | stances (`stances`), and rest where nobody speaks |
| pitch and pauses | middle | head, shoulders, spine |
| class of a word | high | hand shape and the path of the arm |

The speaker's style changes the size, timing and side of all movement. Fingers never follow the sound and beats never
follow the words, so that each association can be scored by itself. Times follow from the speech; stances, and the
hands, directions and part of the sizes of beats, are random.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from ha2g_jax import anatomy
from ha2g_jax import skeleton as skeletons
from ha2g_jax.data.records import Stroke
from ha2g_jax.data.talk import lexicon, strokes
from ha2g_jax.data.talk.speakers import Style
from ha2g_jax.data.talk.stances import ARM, REST, arm_track, draw_stances, hand_gains, plan_moves
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.text import Word

SKELETON = "ted_expressive"

_RATE = 60  # frames per second at which movement is composed
_JITTER = 0.008  # standard deviation of the random part of the latency, in seconds
_FOREARM, _SHOULDERS = 0.33, 0.42  # metres from elbow to wrist, and from shoulder to shoulder
_LOW_PITCH = -0.3  # semitones at and below which the other hand makes a beat
_WIDE_PITCH = 3.0  # semitones at which a beat goes far to the side
_AVERAGE_BEAT = 0.05  # metres by which the wrist is raised
_AVERAGE_NOD = 4.0  # degrees
_SHIFT_SIZE = 0.3  # size of a shift within a stance, relative to that of a new stance
_ARM_SWAY = np.array([0.05, 0.006, 0.05, 4.0, 6.0, 4.0, 3.0])  # standard deviations of `stances.ARM` in speech
_ARM_SWAY_SECONDS = {0.35: 0.9, 0.17: 0.45}
_REST_SWAY = 0.12  # sway at rest, as a fraction of that in speech


class Movement(NamedTuple):
    """Motion of a body and its causes.

    Attributes:
        positions: (T, 43, 3) float32 metres, y down, the spine at the origin.
        strokes: every stroke in order of time; times and amplitudes have six decimals.
    """

    positions: np.ndarray
    strokes: tuple[Stroke, ...]


def perform(
    audio: np.ndarray, words: Sequence[Word], style: Style, rng: np.random.Generator, fps: float = 15
) -> Movement:
    """Make gestures for speech (samples,) at 16 kHz and its words, round(seconds * fps) frames of them.

    `rng` determines what does not follow from the speech: stances, the hands and directions of beats, sway. Silent
    audio gives rest.
    """
    skeleton = skeletons.load_skeleton(SKELETON)
    num_frames = round(len(audio) / SAMPLE_RATE * fps)
    body, performed = _compose(skeleton, audio, words, style, rng)
    moments = np.arange(num_frames) / fps * _RATE
    body = anatomy.Body(*(_sample(angles, moments) for angles in body))
    directions = anatomy.body_directions(skeleton, anatomy.within_limits(body))
    positions = skeletons.directions_to_positions(skeleton, directions).astype(np.float32)
    return Movement(positions, tuple(sorted(map(_rounded, performed))))


def _rounded(stroke: Stroke) -> Stroke:
    """Round the numbers of a stroke, because their last bits differ between processors."""
    time, start, end = (round(float(moment), 6) for moment in (stroke.time, stroke.start, stroke.end))
    return stroke._replace(time=time, start=start, end=end, amplitude=round(stroke.amplitude, 6))


def _compose(skeleton, audio, words, style, rng) -> tuple[anatomy.Body, list[Stroke]]:
    found = strokes.find_cues(audio)
    times = np.arange(int(np.ceil(len(audio) / SAMPLE_RATE * _RATE)) + 2) / _RATE
    latency = strokes.LATENCY * style.latency + _JITTER * rng.standard_normal()
    stance_rng, beat_rng, sway_rng = rng.spawn(3)
    beats = strokes.plan_beats(found, latency)
    gestures = strokes.plan_word_gestures(words, latency)
    moves = plan_moves(found.nuclei[:, 0] + latency, beats, times[-1], stance_rng)
    liveliness = strokes.liveliness(found, np.array([move.hit for move in moves]))
    stances = draw_stances(moves, liveliness, style, stance_rng)
    arms, arm_strokes = _arms(skeleton, times, found, beats, gestures, stances, style, beat_rng, sway_rng)
    trunk, head, shrug, body_strokes = _trunk_and_head(times, found, stances, style, latency)
    fingers = _fingers(times, gestures, style)
    body = anatomy.Body(
        trunk + np.array([0.8, 2.5, 1.2]) * _sway(sway_rng, trunk.shape, 1.0),
        head + np.array([1.2, 2.5, 1.2]) * _sway(sway_rng, head.shape, 1.0),
        shrug,
        arms,
        fingers + 0.006 * _sway(sway_rng, fingers.shape),
        11.0 - 2.0 * style.curl + 1.5 * _sway(sway_rng, (len(times), 2), 1.5),
    )
    return body, arm_strokes + body_strokes


def _arms(
    skeleton, times, found, beats, gestures, stances, style, beat_rng, sway_rng
) -> tuple[np.ndarray, list[Stroke]]:
    """Compute the angles (T, 2, 7) of the arms: stances, blended with the word gestures, plus beats and sway."""
    offsets, hands = _beat_offsets(found, beats, stances, style, beat_rng)
    sway = 2.0 ** (0.75 * style.amplitude) * _awake(times, stances)[:, None, None] * _ARM_SWAY
    sway = sway * np.sqrt(hand_gains(style))[:, None]
    arms = np.stack(
        [_blend_gestures(arm_track(times, stances, side), times, gestures, style, side) for side in range(2)], axis=1
    )
    for seconds, share in _ARM_SWAY_SECONDS.items():
        shared, own = (_sway(sway_rng, (len(times), count, len(ARM)), seconds) for count in (1, 2))
        arms += share * sway * np.sqrt(0.5) * (shared + own)
    raised = np.stack([strokes.track(times, strokes.beat_keys(beats, offsets[:, side])) for side in range(2)], axis=1)
    wrists = _clear_of_the_body(arms[..., :3] + raised)
    angles = np.zeros((len(times), 2, len(anatomy.ARM_LIMITS)))
    for side in range(2):
        arm, wrist, beat = arms[:, side], wrists[:, side], raised[:, side]
        # An elbow is less outward if the hand is high or far to the side; in a beat the hand lags behind.
        swivel = arm[:, 3] - 60 * (wrist[:, 1] + 0.4) - 80 * np.maximum(wrist[:, 0] - 0.1, -0.1)
        arm[:, 5] += np.rad2deg(1.5 * (_sample(beat[:, 1], np.arange(len(beat)) - 3) - beat[:, 1]) / _FOREARM)
        angles[:, side] = np.concatenate([anatomy.reach(skeleton, wrist, swivel), arm[:, 4:]], axis=-1)
    names = ("left", "right")
    performed = []
    for stance in stances:
        hit = stance.move.hit
        size = _SHIFT_SIZE if stance.move.kind == "shift" else 1.0
        if stance.move.kind != "idle":
            performed.append(Stroke(hit, stance.start, hit, "stance", stance.hand, size, stance.name))
    for beat, offset, made in zip(beats, offsets, hands, strict=True):
        hand = "both" if made.all() else names[int(made[1])]
        size = float(offset[:, 1].max() / _AVERAGE_BEAT)
        performed.append(Stroke(beat.hit, beat.apex - 0.2, beat.hit + 0.08, "beat", hand, size, ""))
    for gesture in gestures:
        hand = "both" if lexicon.ARM_PATHS[gesture.word_class].both else names[style.dominant]
        performed.append(Stroke(gesture.peak, gesture.start, gesture.end, "semantic", hand, 1.0, gesture.word_class))
    return angles, performed


def _awake(times, stances) -> np.ndarray:
    """Return the weight (T,) of the sway of the arms: 1 in speech, less at rest."""
    keys = [(-1.0, _REST_SWAY)]
    for stance in stances:
        keys += [(stance.start, keys[-1][1]), (stance.move.hit, _REST_SWAY if stance.name == REST else 1.0)]
    return strokes.track(times, strokes.in_order(keys))


def _beat_offsets(found, beats, stances, style, rng) -> tuple[np.ndarray, np.ndarray]:
    """Draw the offset of each hand at the apex of each beat (beats, 2, 3), in metres outward, up and forward, and
    choose the hands (beats, 2) that make it.

    The size grows with the loudness of the syllable. A stance has beats of both hands, of one, or in turns, where a
    syllable of low pitch moves the hand that is not dominant.
    """
    of_beats = [stance for stance in stances if stance.move.is_beat]
    loudness, pitch = (np.array([getattr(beat, name) for beat in beats]) for name in ("loudness", "pitch"))
    size = 2.0 ** (0.8 * style.amplitude + 0.25 * style.mixing)
    size = size * strokes.liveliness(found, np.array([beat.hit for beat in beats])) * rng.lognormal(0, 0.25, len(beats))
    size *= np.array([stance.vigour for stance in of_beats])
    height = size * (0.02 + 0.031 * np.clip((loudness - strokes.WEAKEST_BEAT) / 0.35, 0, 1))
    direction = np.ones((len(beats), 2, 3))
    direction[..., 0] = 0.1 + 0.4 * np.clip(pitch / _WIDE_PITCH, -1, 1)[:, None]
    direction[..., 2] = 0.3
    spread = np.array([1.0, 0.0, 1.0])
    direction += spread * (0.4 * rng.standard_normal((len(beats), 1, 3)) + 0.28 * rng.standard_normal(direction.shape))
    hands = np.ones((len(beats), 2), bool)
    for beat, stance, made in zip(beats, of_beats, hands, strict=True):
        if stance.pattern == "turns":
            made[style.dominant if beat.pitch <= _LOW_PITCH else 1 - style.dominant] = False
        elif stance.pattern == "one":
            made[1 - (style.dominant if stance.hand == "both" else int(stance.hand == "right"))] = False
    gains = hand_gains(style) * np.where(hands, 1.0, 0.35) * rng.lognormal(-0.05, 0.4, hands.shape)
    heights = np.clip(height, 0.02, 0.16)[:, None] * gains
    return heights[..., None] * np.clip(direction, -1.2, 1.2), hands


def _of_side(gestures, style, side) -> list[strokes.WordGesture]:
    """Return the gestures in which an arm takes part."""
    return [each for each in gestures if side == style.dominant or lexicon.ARM_PATHS[each.word_class].both]


def _blend_gestures(arm, times, gestures, style, side) -> np.ndarray:
    mine = _of_side(gestures, style, side)
    if not mine:
        return arm
    paths = [lexicon.ARM_PATHS[gesture.word_class] for gesture in mine]
    swivel = 28 + 10 * style.elbow
    ready = [np.array([*path.wind_up, swivel, path.pronation, 0, 0]) for path in paths]
    peak = [np.array([*path.peak, swivel, path.pronation, path.extension, 0]) for path in paths]
    keys, value = strokes.gesture_keys(mine, ready, peak)
    weight = strokes.track(times, keys)[:, None] * 0.5 * 2.0 ** (0.15 * (style.amplitude - style.mixing))
    return arm + np.minimum(weight, 1) * (strokes.track(times, value) - arm)


def _clear_of_the_body(wrists: np.ndarray) -> np.ndarray:
    """Keep wrists (T, 2, 3) where arms are relaxed: side by side, and before the trunk if they cross it or are high."""
    outward, up, forward = np.moveaxis(wrists, -1, 0)
    between = _SHOULDERS + outward.sum(axis=1, keepdims=True)
    outward = -anatomy.at_least(-outward - (anatomy.at_least(between, 0.12) - between) / 2, -0.5)
    crossing = _step((0.06 - outward) / 0.2)
    up = -anatomy.at_least(-up, 0.22 * crossing - 0.12)
    raised = _step((up + 0.5) / 0.3) * (1 - _step((outward - 0.2) / 0.2))
    forward = anatomy.at_least(forward, 0.03 + 0.24 * (1 - (1 - crossing) * (1 - raised)))
    return np.stack([outward, up, forward], axis=-1)


def _step(values: np.ndarray) -> np.ndarray:
    values = np.clip(values, 0, 1)
    return values**2 * (3 - 2 * values)


def _trunk_and_head(times, found, stances, style, latency) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[Stroke]]:
    """Compute middle-level movement: pitch lifts head and shoulders, accents cause nods, pauses change the posture, and
    the trunk turns to the side of a stance.
    """
    size = 2.0 ** (0.5 * style.amplitude - 0.3 * style.mixing)
    pitch = _sample(found.pitch, (times - latency) * strokes.RATE)
    nods = [(-1.0, 0.0)]
    performed = []
    for moment, rise in found.accents:
        hit = moment + latency
        depth = size * (1.5 + 0.9 * rise)
        if hit - 0.3 < nods[-1][0]:
            nods.pop()
        nods += [(hit - 0.28, 0.0), (hit, depth), (hit + 0.4, 0.0)]
        performed.append(Stroke(hit, hit - 0.28, hit + 0.4, "nod", "", float(depth / _AVERAGE_NOD), ""))
    nod = strokes.track(times, nods)
    keys = strokes.plan_posture(found.pauses)
    side = strokes.track(times, keys)
    for start, end in zip(keys[1::2], keys[2::2], strict=True):
        performed.append(Stroke(end[0], start[0], end[0], "posture", "", float(size), ""))
    turns = [(-1.0, np.zeros(3))]
    for stance in stances:
        turns += [(stance.start, turns[-1][1]), (stance.move.hit + 0.15, stance.trunk)]
    turn = strokes.track(times, strokes.in_order(turns))
    excited = ndimage.gaussian_filter1d(np.clip(pitch, -3, 6), 0.2 * _RATE)
    lean = np.stack([-0.5 * excited, 2.5 * side, 1.5 * side], axis=-1)
    head = np.stack([nod - size * 0.8 * excited, 3.0 * size * side, -2.0 * size * side], axis=-1)
    shrug = np.stack([size * (1.0 * excited + 1.5 * side), size * (1.0 * excited - 1.5 * side)], axis=-1)
    return turn + size * lean, head - np.array([0.3, 0.6, 0.4]) * turn, shrug, performed


def _fingers(times, gestures, style) -> np.ndarray:
    """Compute the flexions (T, 2, 5) of the fingers: the style's rest pose, and the shape of each word's class."""
    rest = np.array([0.40, 0.44, 0.44, 0.42, 0.36]) + 0.13 * style.curl
    fingers = np.tile(rest, (len(times), 2, 1))
    for side in range(2):
        if mine := _of_side(gestures, style, side):
            shapes = [anatomy.HAND_SHAPES[gesture.word_class] for gesture in mine]
            keys, value = strokes.gesture_keys(mine, shapes, shapes)
            weight = strokes.track(times, keys)[:, None]
            fingers[:, side] += weight * (strokes.track(times, value) - fingers[:, side])
    return fingers


def _sway(rng: np.random.Generator, shape: tuple[int, ...], seconds: float = 0.7) -> np.ndarray:
    """Draw slow noise of unit variance along the first axis."""
    width = seconds * _RATE
    noise = ndimage.gaussian_filter1d(rng.standard_normal(shape), width, axis=0, mode="wrap")
    return noise * np.sqrt(2 * np.sqrt(np.pi) * width)


def _sample(track: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Interpolate a track linearly at fractional positions; its ends are held."""
    positions = np.clip(positions, 0, len(track) - 1)
    before = np.minimum(positions.astype(int), max(len(track) - 2, 0))
    after = np.minimum(before + 1, len(track) - 1)
    blend = (positions - before).reshape(-1, *[1] * (track.ndim - 1))
    return track[before] + blend * (track[after] - track[before])
