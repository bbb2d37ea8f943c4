"""HA2G on videos of speakers: a folder made by ha2g data build-video, with images of the speakers.

ha2g data build-video VIDEOS corpora/video && ha2g data split corpora/video corpora/video_split
ha2g train --config video --workdir runs/video --config.data.path=corpora/video_split
"""

from ha2g_jax.config import presets
from ha2g_jax.config.settings import Config


def get_config(size: str = "paper") -> Config:
    return presets.make("video", size)
