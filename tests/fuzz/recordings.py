"""Small files of sound and of video in every container that can be written here."""

import fractions
import functools
import io
from typing import cast

import av
import numpy as np
import soundfile

SOUNDFILE_KINDS = (
    *(("WAV", "PCM_16"), ("WAV", "FLOAT"), ("WAV", "DOUBLE"), ("WAV", "IMA_ADPCM"), ("WAVEX", "PCM_24")),
    *(("FLAC", "PCM_16"), ("OGG", "VORBIS"), ("OGG", "OPUS"), ("MP3", "MPEG_LAYER_III"), ("AIFF", "PCM_16")),
    *(("AU", "PCM_16"), ("W64", "PCM_16"), ("RF64", "PCM_16"), ("CAF", "PCM_16"), ("CAF", "ALAC_16")),
)
# Container, codec of the sound, codec of the images.
FFMPEG_SOUND_KINDS = (("ipod", "aac", ""), ("ipod", "alac", ""), ("matroska", "flac", ""), ("ogg", "libopus", ""))
VIDEO_KINDS = (
    *(("matroska", "aac", "libx264"), ("avi", "pcm_s16le", "mpeg4"), ("mp4", "aac", "libx264")),
    *(
        ("mov", "pcm_s16le", "mpeg4"),
        ("webm", "libopus", "libvpx"),
        ("mpegts", "aac", "libx264"),
        ("flv", "aac", "flv"),
    ),
)
SIDE = 64  # pixels
_SAMPLES, _RATE, _IMAGES, _FPS = 12_000, 48_000, 6, 24


def _speech(num_samples: int) -> np.ndarray:
    noise = np.random.default_rng(0).normal(0, 0.02, num_samples)
    return (0.3 * np.sin(np.arange(num_samples) / 9) + noise).astype(np.float32)


@functools.cache
def soundfile_bytes(container: str, codec: str) -> bytes:
    """Return a quarter of a second of sound, written by libsndfile."""
    file = io.BytesIO()
    soundfile.write(file, _speech(4_000), 16_000, format=container, subtype=codec)
    return file.getvalue()


@functools.cache
def ffmpeg_bytes(container: str, codec: str, images: str, channels: str = "stereo") -> bytes:
    """Return a quarter of a second of sound and of images, unless `images` is empty, written by FFmpeg."""
    file = io.BytesIO()
    with av.open(file, "w", format=container) as output:
        video = cast(av.VideoStream, output.add_stream(images, rate=_FPS)) if images else None
        sound = cast(av.AudioStream, output.add_stream(codec, rate=_RATE, layout=channels))
        if video is not None:
            video.width = video.height = SIDE
            video.pix_fmt = "yuv420p"
            for number in range(_IMAGES):
                picture = np.full((SIDE, SIDE, 3), 40 * number, np.uint8)
                output.mux(video.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
            output.mux(video.encode(None))
        one = np.repeat(_speech(_SAMPLES)[:, None], len(sound.codec_context.layout.channels), 1)
        whole = av.AudioFrame.from_ndarray(one.reshape(1, -1), format="flt", layout=channels)
        whole.sample_rate, whole.pts, whole.time_base = _RATE, 0, fractions.Fraction(1, _RATE)
        converter = av.AudioResampler(
            sound.codec_context.format, channels, _RATE, frame_size=sound.codec_context.frame_size or 1024
        )
        for frame in [*converter.resample(whole), *converter.resample(None)]:
            output.mux(sound.encode(frame))
        output.mux(sound.encode(None))
    return file.getvalue()
