"""Pieces of sound that arrive: decoding of their bytes, resampling to 16 kHz, and requests between them."""

import collections
import io
import re
import sys
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
import soundfile
import soxr

from ha2g_jax.apps.live.clock import Clock
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.files.reading import reason
from ha2g_jax.limits import MAX_SOUND_RATE, MIN_SOUND_RATE
from ha2g_jax.motion.cues import Cue

_WAV = re.compile(rb"RIFF.{4}WAVE", re.DOTALL)
_MOST_HEADER = 1 << 16  # bytes of a WAV before its sound
_UNKNOWN_SIZE = 0x7FFF0000  # sizes from here on in the header of a WAV from a pipe are not its size
# How files begin that are neither raw PCM nor WAV.
_OTHERS = {
    "FLAC": rb"fLaC",
    "Ogg": rb"OggS",
    "MP3": rb"ID3",
    "AIFF": rb"FORM",
    "AU": rb"\.snd",
    "CAF": rb"caff",
    "RF64": rb"RF64",
    "WebM": rb"\x1a\x45\xdf\xa3",
    "MP4": rb".{4}ftyp",
}
# For frames of MP3: bit rates of MPEG 1 and of later versions, and sample rates by the bits of the version.
_MP3_KBPS = (32, 40, 48, 56, 64, 80, 96, 112, 128, 160, 192, 224, 256, 320)
_MP3_LATER_KBPS = (8, 16, 24, 32, 40, 48, 56, 64, 80, 96, 112, 128, 144, 160)
_MP3_RATES = {3: (44100, 48000, 32000), 2: (22050, 24000, 16000), 0: (11025, 12000, 8000)}


class Change(NamedTuple):
    """A request of a sender: values of a stream, see `Stream`; a cue; or to drop the speech that is not shown yet."""

    muted: bool | None = None
    state: str | None = None
    cue: Cue | None = None
    clear: bool = False


class Chunk(NamedTuple):
    """Samples (samples,), float32 mono at 16 kHz, and the time of the clock at which the first of them is heard.

    `other` are those of the other speaker, and `change` takes effect before these samples.
    """

    samples: np.ndarray
    heard: float
    other: np.ndarray | None = None
    change: Change | None = None


def held_back(chunks: Iterable[Chunk], seconds: float, clock: Clock) -> Iterator[Chunk]:
    """Yield chunks in their order, `seconds` after they are heard, or at the end of the sound.

    A clear is yielded at once: the agent's sound that is held back becomes silence, and cues among it are dropped.
    """
    waiting = collections.deque[Chunk]()
    for chunk in chunks:
        if chunk.change is not None and chunk.change.clear:
            for index, (samples, _, _, change) in enumerate(waiting):
                change = None if change is None else change._replace(cue=None)
                waiting[index] = waiting[index]._replace(samples=np.zeros_like(samples), change=change)
            yield chunk
        else:
            waiting.append(chunk)
        while waiting and waiting[0].heard + seconds <= clock.now():
            yield waiting.popleft()
    yield from waiting


class Resampler:
    """Conversion of sound that arrives in pieces to 16 kHz."""

    def __init__(self, rate: float, channels: int = 1) -> None:
        self._rate = rate
        is_equal = rate == SAMPLE_RATE
        self._stream = None if is_equal else soxr.ResampleStream(rate, SAMPLE_RATE, channels, dtype="float32")
        self._taken = self._given = 0

    def resample(self, samples: np.ndarray, heard: float, is_last: bool = False) -> Chunk:
        """Convert a piece; the last milliseconds of it are held back, unless the sound ends here.

        Args:
            samples: (samples,) float32 mono, or (samples, 2), the agent and the other; values that are not finite
                become 0.
            heard: time at which the first of them is heard.
            is_last: whether the sound ends here.
        """
        samples = np.nan_to_num(samples.astype(np.float32, copy=False), nan=0.0, posinf=0.0, neginf=0.0)
        if self._stream is not None:
            heard += self._given / SAMPLE_RATE - self._taken / self._rate
            self._taken += len(samples)
            samples = self._stream.resample_chunk(samples, last=is_last)
            self._given += len(samples)
        return Chunk(samples, heard) if samples.ndim == 1 else Chunk(samples[:, 0], heard, samples[:, 1])


class Decoder:
    """Conversion of the bytes of raw PCM or of a WAV to samples, mono or (samples, 2), at a rate, by default 16 kHz.

    A WAV is recognised by its header, which states rate, channels and type; part of a sample waits for the next bytes.
    Several WAVs may follow one another; bytes between the sound of one and the next are dropped. Values that are not
    finite become 0.
    """

    def __init__(self, rate: int | None, channels: int = 1) -> None:
        self._channels = channels
        self._stated, self._rest, self._left = rate, b"", sys.maxsize
        self._form: dict[str, Any] = {}  # of the sound, as soon as it is known
        self._width = 2 * channels
        self._resampler: soxr.ResampleStream | None = None
        self._is_wav = self._is_cleared = False

    def clear(self) -> None:
        """Expect that the sound is cut off: the next bytes of raw PCM begin a sample, and those of a WAV may begin
        another one.
        """
        self._is_cleared = True
        if not self._is_wav:
            self._rest = b""

    def decode(self, data: bytes, *, is_last: bool = False) -> np.ndarray:
        """Return the samples float32 of further bytes.

        Raises:
            UserError: they are of another kind of file, or of a WAV with another rate than the one that is stated.
        """
        if self._is_cleared and data.startswith(b"RIFF"):
            self._rest, self._form, self._resampler, self._left = b"", {}, None, sys.maxsize
        self._is_cleared = self._is_cleared and not data
        self._rest += data
        parts = [np.zeros((0, *[2] * (self._channels == 2)), np.float32)]
        while self._form or self._begin(is_last):
            if self._left >= self._width:
                parts.append(self._whole_samples(is_last))
            if self._left >= self._width:
                break
            found = _WAV.search(self._rest)
            self._rest = self._rest[found.start() if found else -11 :]
            if not found:
                break
            self._form, self._resampler, self._left = {}, None, sys.maxsize
        return np.concatenate(parts)

    def _whole_samples(self, is_last: bool) -> np.ndarray:
        whole = min(len(self._rest), self._left) // self._width * self._width
        sound, self._rest, self._left = self._rest[:whole], self._rest[whole:], self._left - whole
        samples = soundfile.read(io.BytesIO(sound), dtype="float32", always_2d=True, **self._form)[0]
        samples = np.nan_to_num(samples, nan=0.0, posinf=0.0, neginf=0.0)
        samples = samples.mean(axis=1) if self._channels == 1 else samples
        if self._resampler is None:
            return samples
        return self._resampler.resample_chunk(samples, last=is_last or self._left < self._width)

    def _begin(self, is_last: bool) -> bool:
        """Find out what the sound is, and return whether it is known."""
        head = self._rest
        if len(head) < 12 and not is_last:
            return False
        other = next((name for name, start in _OTHERS.items() if re.match(start, head, re.DOTALL)), None)
        if other := other or ("MP3" if _is_mp3(head) else None):
            raise UserError(f"what is sent is {other}; send WAV or raw PCM, or give the file to --source")
        form = {"samplerate": self._stated or SAMPLE_RATE, "channels": self._channels, "subtype": "PCM_16"}
        self._is_wav = head.startswith(b"RIFF") and head[8:12] == b"WAVE"
        if self._is_wav:
            start = 12
            while head[start : start + 4] != b"data" and start < len(head):
                if head[start : start + 4] == b"fmt ":
                    self._width = int.from_bytes(head[start + 20 : start + 22], "little")
                start += 8 + int.from_bytes(head[start + 4 : start + 8], "little") + 1 & ~1
            if len(head) < start + 8 and not is_last and len(head) < _MOST_HEADER:
                return False
            size = int.from_bytes(head[start + 4 : start + 8], "little")
            try:
                with soundfile.SoundFile(io.BytesIO(head[: start + 8])) as file:
                    form = {"samplerate": file.samplerate, "channels": file.channels, "subtype": file.subtype}
                two = soundfile.read(io.BytesIO(bytes(2 * self._width)), format="RAW", **form)[0]
            except (soundfile.SoundFileError, ValueError, TypeError) as error:
                raise UserError(f"what is sent is a WAV that cannot be read ({reason(error)}); send 16 bits") from error
            if len(two) != 2 or not MIN_SOUND_RATE <= file.samplerate <= MAX_SOUND_RATE:
                raise UserError(
                    f"what is sent is a WAV of {self._width} bytes a sample, {file.samplerate} samples a second, which "
                    "cannot be; write it again"
                )
            if self._channels == 2 != file.channels:
                raise UserError(f"the WAV has {file.channels} channels; send 2, the agent and the other")
            if self._stated not in (None, file.samplerate):
                raise UserError(f"the WAV has {file.samplerate} samples a second, not {self._stated}; leave out --rate")
            self._rest, self._left = head[start + 8 :], size if 0 < size < _UNKNOWN_SIZE else sys.maxsize
            if file.samplerate != (self._stated or SAMPLE_RATE):
                self._resampler = soxr.ResampleStream(file.samplerate, SAMPLE_RATE, self._channels, dtype="float32")
        self._form = form | {"format": "RAW", "endian": "LITTLE"}
        return True


def _is_mp3(head: bytes) -> bool:
    """Return whether bytes begin with a frame of MP3 without a tag, and continue with another one."""
    if len(head) < 4 or head[0] != 0xFF or head[1] >> 5 != 0b111 or head[1] >> 1 & 3 != 1:
        return False
    version, kbps, rate = head[1] >> 3 & 3, (head[2] >> 4) - 1, head[2] >> 2 & 3
    if version not in _MP3_RATES or not 0 <= kbps < len(_MP3_KBPS) or rate == 3:
        return False
    bits = 144_000 * _MP3_KBPS[kbps] if version == 3 else 72_000 * _MP3_LATER_KBPS[kbps]
    size = bits // _MP3_RATES[version][rate]
    size += head[2] >> 1 & 1
    return head[size : size + 2] == head[:2]
