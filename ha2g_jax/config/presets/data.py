"""Skeleton and settings for each kind of data."""

from collections.abc import Callable
from typing import NamedTuple

from ha2g_jax.config.settings import Config


class DataPreset(NamedTuple):
    """Preset of a kind of data.

    Attributes:
        skeleton: name of the skeleton.
        adapt: function of (config, size) that changes settings of the paper in place.
    """

    skeleton: str
    adapt: Callable[[Config, str], None]


def talk(config: Config, size: str) -> None:
    """Adapt a config to the Talk corpus, which is made on first use."""
    del size
    config.data.path = "talk"
    config.data.jitter = 9  # windows start every 10 frames; with this, training sees every start
    config.loss.ha2g.weights.contrastive = 2.0  # D19


def ted(config: Config, size: str) -> None:
    """Adapt a config to the published LMDB files of TED."""
    del size
    config.model.identity.kind = "speakers"  # the files contain no images


def bvh(config: Config, size: str) -> None:
    """Adapt a config to motion capture."""
    del size
    config.model.identity.kind = "speakers"  # motion capture has no images
    config.data.jitter = 9


def video(config: Config, size: str) -> None:
    """Adapt a config to videos of speakers, from which images are stored."""
    del size
    config.data.jitter = 9


DATA = {
    "talk": DataPreset("ted_expressive", talk),
    "ted_expressive": DataPreset("ted_expressive", ted),
    "ted_gesture": DataPreset("ted_gesture", ted),
    "bvh": DataPreset("ted_expressive", bvh),
    "video": DataPreset("ted_expressive", video),
}
