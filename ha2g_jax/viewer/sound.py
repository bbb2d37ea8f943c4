"""Encoding of sound for a page as MP3, which every browser plays, at an eighth of the size of the samples."""

import fractions
import io

import av
import numpy as np
import soxr

_RATES = (16000, 22050, 24000, 32000, 44100, 48000)  # sample rates of MP3
_BIT_RATE = 32000


def encode(audio: np.ndarray, sample_rate: int) -> bytes:
    """Encode sound as an MP3 file.

    Its header has the number of samples that the encoder puts before the sound, so that players skip them. The same
    sound gives the same bytes.

    Args:
        audio: (samples,) float32 mono sound.
        sample_rate: samples per second.

    Returns:
        Content of the file.
    """
    if sample_rate not in _RATES:
        audio = soxr.resample(audio, sample_rate, _RATES[0], quality="HQ")
        sample_rate = _RATES[0]
    file = io.BytesIO()
    with av.open(file, "w", format="mp3", options={"fflags": "+bitexact", "id3v2_version": "0"}) as container:
        stream = container.add_stream("libmp3lame", rate=sample_rate, layout="mono")
        stream.bit_rate = _BIT_RATE
        samples = np.clip(np.asarray(audio, np.float32), -1, 1)
        for start in range(0, len(samples), sample_rate):
            frame = av.AudioFrame.from_ndarray(samples[None, start : start + sample_rate], "fltp", "mono")
            frame.sample_rate, frame.pts = sample_rate, start
            frame.time_base = fractions.Fraction(1, sample_rate)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return file.getvalue()
