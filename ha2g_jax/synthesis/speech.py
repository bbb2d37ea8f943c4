"""Speech to generate motion for: a file, or samples."""

import pathlib
from typing import NamedTuple

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE, check_samples, read_audio
from ha2g_jax.files.reading import shown


class Audio(NamedTuple):
    """Speech that has been read and checked.

    Attributes:
        samples: (samples,) float32 mono samples at 16 kHz.
        name: name of the file, None for an array.
    """

    samples: np.ndarray
    name: str | None = None

    @property
    def duration(self) -> float:
        """Duration in seconds."""
        return len(self.samples) / SAMPLE_RATE


Speech = str | pathlib.Path | np.ndarray | Audio


def read_speech(speech: Speech) -> Audio:
    """Read and check speech; speech that was read before is returned unchanged.

    Args:
        speech: path of a file with sound, (samples,) float mono samples at 16 kHz, or a result of this function.

    Raises:
        UserError: the speech cannot be used, see `features.audio.read_audio`.
    """
    if isinstance(speech, Audio):
        return speech
    if isinstance(speech, str | pathlib.Path):
        return Audio(read_audio(speech), shown(pathlib.Path(speech).name))
    samples = np.asarray(speech)
    if samples.ndim != 1 or not np.issubdtype(samples.dtype, np.floating):
        raise UserError(f"speech is an array of {samples.dtype}, shape {samples.shape}; expected float mono at 16 kHz")
    return Audio(check_samples(samples.astype(np.float32), SAMPLE_RATE, "the speech"))
