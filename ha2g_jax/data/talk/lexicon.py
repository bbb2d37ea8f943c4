"""Words that carry a gesture: their classes, and the arm path of each class.

The hand shape of a class is that of its name in `anatomy.HAND_SHAPES`. The shapes differ in the flexion of the fingers,
so a generated hand can be scored against them without knowing where the arm is.
"""

from typing import NamedTuple

WORD_CLASSES: dict[str, tuple[str, ...]] = {
    "one": ("one", "single"),
    "two": ("two", "both"),
    "three": ("three", "triple"),
    "open": ("everything", "huge"),
    "small": ("tiny", "little"),
    "point": ("you", "there"),
    "fist": ("strong", "power"),
    "round": ("ball", "circle"),
    "negation": ("never", "nothing"),
    "approve": ("great", "perfect"),
}


class ArmPath(NamedTuple):
    """Path of the wrist in a gesture. Offsets are metres from the shoulder: outward, up, forward.

    Attributes:
        both: whether the other hand makes the mirrored movement.
        wind_up: position of the wrist at the end of the preparation.
        peak: position of the wrist at the end of the stroke, where it is held.
        pronation: roll of the forearm in degrees; 0 thumb up, 90 palm down, -60 palm up.
        extension: bend of the wrist in degrees towards the back of the hand.
    """

    both: bool
    wind_up: tuple[float, float, float]
    peak: tuple[float, float, float]
    pronation: float
    extension: float


ARM_PATHS: dict[str, ArmPath] = {
    "one": ArmPath(False, (0.06, -0.16, 0.25), (0.12, 0.00, 0.30), 60, 5),
    "two": ArmPath(False, (0.04, -0.17, 0.26), (0.16, -0.03, 0.30), 70, 8),
    "three": ArmPath(False, (0.08, -0.18, 0.24), (0.20, -0.05, 0.31), 75, 12),
    "open": ArmPath(True, (-0.02, -0.22, 0.32), (0.26, -0.08, 0.30), -20, 25),
    "small": ArmPath(False, (0.04, -0.20, 0.27), (0.02, -0.03, 0.31), 55, 0),
    "point": ArmPath(False, (0.05, -0.16, 0.24), (0.06, -0.08, 0.52), 60, 12),
    "fist": ArmPath(False, (0.08, 0.04, 0.26), (0.06, -0.20, 0.36), 10, -10),
    "round": ArmPath(True, (0.12, -0.08, 0.28), (-0.03, -0.17, 0.36), 20, -5),
    "negation": ArmPath(False, (-0.14, -0.20, 0.34), (0.26, -0.22, 0.34), 80, 28),
    "approve": ArmPath(False, (0.03, -0.26, 0.26), (0.08, -0.06, 0.40), -20, -8),
}

_CLASS_OF_WORD = {word: name for name, words in WORD_CLASSES.items() for word in words}


def word_class(word: str) -> str:
    """Return the gesture class of a word in any letter case, "" for a word that carries no gesture."""
    return _CLASS_OF_WORD.get(word.lower(), "")
