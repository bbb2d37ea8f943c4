"""Stances: where a speaker's hands are during a phrase. Their times follow from the sound; the stances are random.

An arm has seven numbers, see `ARM`; the hands stand relative to their shoulders.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.data.talk import strokes
from ha2g_jax.data.talk.speakers import Style

# Metres outward, up and forward of the shoulder; degrees of the elbow outward (`anatomy.reach`), pronation (0 thumb up,
# 90 palm down), extension of the wrist, and its bend towards the thumb.
ARM = ("outward", "up", "forward", "swivel", "pronation", "extension", "deviation")
REST_ARM = np.array([0.12, -0.645, 0.12, 18.0, 8.0, -4.0, 0.0])
REST = "rest"


class _Place(NamedTuple):
    """A stance of the table.

    Attributes:
        share: fraction of the stances that are this one, in speech of average liveliness.
        lively: power of the liveliness with which the share grows.
        first, second: position of one wrist and of the other, in metres.
        elbow: angle of the elbows outward, in degrees.
        pronation: pronation of the forearms, in degrees.
        turn: angle by which the trunk turns to the side of the first hand, in degrees.
    """

    share: float
    lively: float
    first: tuple[float, float, float]
    second: tuple[float, float, float]
    elbow: float = 36
    pronation: float = 30
    turn: float = 0


STANCES = {
    "front": _Place(0.14, -0.5, (0.05, -0.30, 0.34), (0.05, -0.30, 0.34)),
    "forward": _Place(0.06, 1.0, (0.07, -0.18, 0.50), (0.09, -0.26, 0.44), pronation=10),
    "wide": _Place(0.18, 0.0, (0.27, -0.28, 0.27), (0.27, -0.28, 0.27), pronation=-5),
    "low": _Place(0.13, -1.5, (0.14, -0.50, 0.18), (0.14, -0.50, 0.18)),
    "high": _Place(0.11, 1.5, (0.16, -0.08, 0.38), (0.16, -0.08, 0.38), pronation=20),
    "side": _Place(0.14, 0.0, (0.34, -0.24, 0.24), (-0.16, -0.32, 0.36), pronation=10, turn=13),
    "together": _Place(0.07, 0.0, (-0.10, -0.28, 0.34), (-0.10, -0.28, 0.34)),
    "hips": _Place(0.03, 0.0, (0.07, -0.42, 0.05), (0.07, -0.42, 0.05), elbow=58, pronation=55),
    "spread": _Place(0.07, 1.5, (0.44, -0.18, 0.18), (0.44, -0.18, 0.18), pronation=-30),
    "raised": _Place(0.08, 1.0, (0.14, -0.02, 0.40), (0.12, -0.58, 0.10), pronation=25, turn=5),
    "hanging": _Place(0.02, -2.0, (0.13, -0.63, 0.13), (0.13, -0.63, 0.13), pronation=10),
}
_MIDDLE = np.array([0.14, -0.34, 0.27])  # metres; a larger stance is farther from this point
_VARIATION = np.array([0.06, 0.05, 0.08, 9.0, 22.0, 9.0, 6.0])  # standard deviations of a stance of one name
_SHARED = np.array([0.7, 0.4, 0.5, 0.4, 0.4, 0.4, 0.4])  # fraction of the variance that both hands share
_ROLL = 16.0  # degrees by which the pronation of both hands varies in addition
_LEAST = np.array([-0.18, -0.65, 0.02, 5.0, -60.0, -35.0, -20.0])
_GREATEST = np.array([0.50, 0.10, 0.54, 75.0, 80.0, 45.0, 15.0])
_PATTERNS, _PATTERN_SHARES = ("both", "turns", "one"), (0.55, 0.25, 0.2)

_PHRASE_GAP = 0.3  # seconds without a syllable after which a phrase begins
_REST_GAP = 1.7  # seconds without a syllable in which the arms come to rest
_AT_REST, _RISE = 1.5, 0.75  # seconds after the last syllable, and before the next one
_HOLD = (1.2, 3.4)  # seconds until the next stance of a long phrase
_ROOM, _PATIENCE = 0.62, 1.2  # seconds needed before the beat of a new stance, and seconds to wait for such a beat
_SHORTEST = 0.8  # seconds of the shortest stance, at the end of a phrase
_WAIT = 0.7  # seconds to the nearest beat beyond which hands move at a syllable without one
_IDLE = (3.5, 9.0)  # seconds between two small movements at rest
_SECONDS, _REST_SECONDS = (0.75, 1.1), {REST: 1.0, "idle": 2.2}  # of a movement
_FALL = 0.3  # metres that a hand falls at most in the stroke of a beat
_SHIFT = 2.0  # standard deviations of a shift within a stance, in those of the stance


class Move(NamedTuple):
    """A time in seconds at which the hands arrive: at a new "stance", after a "shift" within one, at "rest", or after
    an "idle" movement at rest; and whether a beat hits then.
    """

    hit: float
    is_beat: bool
    kind: str


class Stance(NamedTuple):
    """A stance and the movement to it.

    Attributes:
        name: one of `STANCES`, or `REST`.
        hand: hand that takes part, "left", "right" or "both".
        pattern: hands that beat in it: "both", in "turns" or "one".
        vigour: size of the movement in it, 1 on average.
        arms: (2, 7) `ARM` of the left and the right arm.
        trunk: (3,) pitch, yaw and roll in degrees.
        start: time in seconds at which the hands begin to move.
        lag: (2,) delay of the left and the right hand, in seconds.
        move: when and why they arrive.
    """

    name: str = REST
    hand: str = "both"
    pattern: str = "both"
    vigour: float = 1.0
    arms: np.ndarray = np.stack([REST_ARM, REST_ARM])
    trunk: np.ndarray = np.zeros(3)
    start: float = -1.0
    lag: np.ndarray = np.zeros(2)
    move: Move = Move(-1.0, False, REST)


def hand_gains(style: Style) -> np.ndarray:
    """Return the weight (2,) of the movement of the left and the right hand; the dominant one does more."""
    return 2.0 ** (0.6 * np.array([-1.0, 1.0]) * style.handedness)


def plan_moves(
    syllables: np.ndarray, beats: Sequence[strokes.Beat], seconds: float, rng: np.random.Generator
) -> list[Move]:
    """Choose the times at which the hands arrive, from the times (n,) of the syllables and the beats, in order.

    They move at each beat, and at a syllable where no beat is near. They move to a new stance at the beginning of a
    phrase and 1.2 to 3.4 seconds after the last one, and to rest where speech ends for long. At rest they move a little
    now and then.
    """
    hits = np.array([beat.hit for beat in beats])
    gaps = np.diff(syllables, append=np.inf)
    phrases = syllables[1:][gaps[:-1] >= _PHRASE_GAP]
    moves: list[Move] = []
    first, rest = 0, 0.0
    for last in np.flatnonzero(gaps >= _REST_GAP):
        spoken = syllables[first : last + 1]
        moves += _idle(rest, spoken[0], rng)
        events = [(hit, True) for hit in hits[(hits >= spoken[0] - 0.01) & (hits <= spoken[-1] + 0.01)]]
        for moment in spoken:
            if all(abs(moment - other) >= _WAIT for other, _ in events):
                events.append((moment, False))
        due = before = -np.inf
        for moment, is_beat in sorted(events):
            is_good = is_beat and moment >= before + _ROOM
            is_new = moment >= due and (is_good or moment >= due + _PATIENCE)
            moves.append(Move(moment, is_beat, "stance" if is_new else "shift"))
            before = moment
            if is_new:
                due = moment + rng.uniform(*_HOLD)
                due = min(due, *phrases[(phrases >= moment + _SHORTEST) & (phrases < due)][:1], np.inf)
        rest = spoken[-1] + min(_AT_REST, gaps[last] - _RISE)
        moves.append(Move(rest, False, REST))
        first = last + 1
    return moves + _idle(rest, seconds, rng)


def _idle(start: float, end: float, rng: np.random.Generator) -> list[Move]:
    """Draw times of idle movements between the beginning and the end of a rest."""
    moments = start + np.cumsum(rng.uniform(*_IDLE, int(max(end - start, 0) / _IDLE[0]) + 1))
    return [Move(moment, False, "idle") for moment in moments[moments < end - 1]]


def draw_stances(moves: Sequence[Move], liveliness: np.ndarray, style: Style, rng: np.random.Generator) -> list[Stance]:
    """Draw a stance for each move; livelier speech and a larger amplitude of the style have larger ones."""
    last = drawn = Stance()
    stances = []
    for move, lively in zip(moves, liveliness, strict=True):
        seconds = _REST_SECONDS[move.kind] if move.kind in _REST_SECONDS else rng.uniform(*_SECONDS)
        start = max(move.hit - seconds, last.move.hit + 0.08)
        size = lively * 2.0 ** (0.75 * style.amplitude) * min(((move.hit - start) / 0.8) ** 1.5, 1.0)
        if move.kind in _REST_SECONDS:
            new = Stance(arms=REST_ARM + _variation(0.3, rng), trunk=rng.normal(0, (1.0, 2.0, 1.0)))
        elif move.kind == "stance":
            new = drawn = _draw(last.name, lively, style, rng)
        else:
            arms = drawn.arms + _variation(_SHIFT * size * drawn.vigour, rng) * np.sqrt(hand_gains(style))[:, None]
            if not move.is_beat:  # a hand that falls without a beat would look like a beat
                arms[:, 1] = np.maximum(arms[:, 1], last.arms[:, 1])
            new = last._replace(arms=_within_reach(arms))
        lag = np.clip(rng.normal(0, 0.02, 2), -0.04, 0.04)
        last = new._replace(start=start, lag=lag, move=move)
        stances.append(last)
    return stances


def _draw(before: str, lively: float, style: Style, rng: np.random.Generator) -> Stance:
    shares = np.array([place.share * lively**place.lively for place in STANCES.values()])
    shares[[name == before for name in STANCES]] *= 0.15
    name = list(STANCES)[rng.choice(len(STANCES), p=shares / shares.sum())]
    place = STANCES[name]
    scale = lively**0.9 * 2.0 ** (0.4 * style.amplitude)
    arms = np.zeros((2, len(ARM)))
    arms[:, :3] = _MIDDLE + scale * (np.array([place.first, place.second]) - _MIDDLE)
    arms[:, 1] += 0.15 * (lively - 1.1)
    arms[:, 3:] = (place.elbow, place.pronation + rng.normal(0, _ROLL), 8, 0)
    arms += style.elbow * np.array([0.03, 0.03, 0, 10, 0, 0, 0]) + _variation(1.0, rng)
    first = int(rng.random() < 0.5 + 0.42 * style.handedness)
    if first == 1:
        arms = arms[::-1]
    hand = ("left", "right")[first] if name == "raised" else "both"
    pattern = _PATTERNS[rng.choice(len(_PATTERNS), p=_PATTERN_SHARES)] if hand == "both" else "one"
    yaw = (place.turn if first == 0 else -place.turn) + rng.normal(0, 6.0)
    trunk = scale * np.array([rng.normal(0, 2.0), yaw, -0.25 * yaw + rng.normal(0, 2.5)])
    return Stance(name, hand, pattern, rng.lognormal(-0.06, 0.35), _within_reach(arms), trunk)


def _variation(size: float, rng: np.random.Generator) -> np.ndarray:
    """Draw the partly shared differences of two arms (2, 7) from those of the table."""
    shared, own = (rng.standard_normal((count, len(ARM))) for count in (1, 2))
    return size * _VARIATION * (np.sqrt(_SHARED) * shared + np.sqrt(1 - _SHARED) * own)


def _within_reach(arms: np.ndarray) -> np.ndarray:
    return np.clip(arms, _LEAST, _GREATEST)


def arm_track(times: np.ndarray, stances: Sequence[Stance], side: int) -> np.ndarray:
    """Return `ARM` (T, 7) of an arm that moves from stance to stance by minimum jerk.

    If a stance is reached with a beat, the hand rises before and falls during the stroke of the beat, so that the fall
    is not a beat of its own.
    """
    keys, slow, fast = [(-1.0, REST_ARM)], [(-1.0, REST_ARM[1])], [(-1.0, 0.0)]
    for stance in stances:
        start, hit = (moment + stance.lag[side] for moment in (stance.start, stance.move.hit))
        arm = stance.arms[side]
        keys += [(start, keys[-1][1]), (hit, arm)]
        rise = arm[1] - slow[-1][1] - fast[-1][1]
        stroke = np.clip(rise, -_FALL, 0) if stance.move.is_beat else 0.0
        fast += [(max(hit - 0.24 + 0.4 * stroke, start), fast[-1][1]), (hit, fast[-1][1] + stroke)]
        risen = hit - 0.22 if stance.move.is_beat and rise > 0 else hit
        slow += [(start, slow[-1][1]), (risen, slow[-1][1] + rise - stroke)]
    track = strokes.track(times, strokes.in_order(keys))
    track[:, 1] = sum(strokes.track(times, strokes.in_order(heights)) for heights in (slow, fast))
    return track
