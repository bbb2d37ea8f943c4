"""Rows of Tables 3, 4 and 11: name of the row -> settings that differ from the full model."""

from typing import Any

FULL = "HA2G Full"

_ASR = {"model.audio.kind": "whisper", "loss.ha2g.weights.contrastive": 0.0}

AUDIO_LEARNER: dict[str, dict[str, Any]] = {
    "low-level feature only": {"model.audio.levels": ("low",)},
    "mid-level feature only": {"model.audio.levels": ("mid",)},
    "high-level feature only": {"model.audio.levels": ("high",)},
    "HA2G without high-level negatives": {"loss.ha2g.negatives": ("low", "mid")},
    "HA2G without low/mid-level negatives": {"loss.ha2g.negatives": ("high",)},
    "HA2G without text": {"loss.ha2g.weights.contrastive": 0.0},
    "HA2G-ASR": _ASR,
    FULL: {},
}
# Levels of the motion: 1 head and shoulders, 2 elbows, 3 wrists, 4 to 6 the joints of the fingers.
POSE_INFERER: dict[str, dict[str, Any]] = {
    "Holistic": {"model.inferer.levels": (6,)},
    "without hand hierarchy": {"model.inferer.levels": (1, 2, 3, 6)},
    "without body hierarchy": {"model.inferer.levels": (3, 4, 5, 6)},
    "same audio feature for all levels": {"model.inferer.coordinator": "tied"},
    "without physical loss": {"loss.ha2g.weights.physical": 0.0},
    FULL: {},
}
SEED_FRAMES: dict[str, dict[str, Any]] = {
    "1": {"data.num_seed_frames": 1, "data.num_reference_images": 1},
    "4": {},
    "7": {"data.num_seed_frames": 7, "data.num_reference_images": 7},
}
# Rows for TED-Gesture, whose hierarchy has three levels and no fingers.
GESTURE: dict[str, dict[str, Any]] = {
    "high-level only": {"model.audio.levels": ("high",)},
    "Holistic": {"model.inferer.levels": (3,)},
    "without physical loss": {"loss.ha2g.weights.physical": 0.0},
    "HA2G-ASR": _ASR,
    FULL: {},
}

TABLES = {"table3": AUDIO_LEARNER, "table4": POSE_INFERER, "table11": SEED_FRAMES, "gesture_ablation": GESTURE}
ABLATIONS = AUDIO_LEARNER | POSE_INFERER
