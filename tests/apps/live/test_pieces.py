"""Bytes that arrive in pieces of any size are the samples that were sent, and wait no longer than they are asked to."""

import io

import numpy as np
import pytest
import soundfile
import soxr
from apps.live.standins import joined, pcm, tone

from ha2g_jax.apps.live.pieces import Change, Chunk, Decoder, Resampler, held_back
from ha2g_jax.motion.cues import Cue


@pytest.mark.parametrize("rate", [8000, 16000, 44100])
def test_sound_in_pieces_is_resampled_as_a_whole_and_keeps_its_times(rate):
    samples, resampler, chunks, first = tone(rate), Resampler(rate), [], 0
    for size in np.random.default_rng(0).integers(1, 1500, 400):
        chunks.append(resampler.resample(samples[first : first + size], 5 + first / rate, bool(first + size >= rate)))
        first += size
        if first >= rate:
            break
    expected = samples if rate == 16000 else soxr.resample(samples, rate, 16000)
    np.testing.assert_allclose(joined(chunks), expected, atol=1e-6)
    starts = np.cumsum([0, *(len(chunk.samples) for chunk in chunks)])[:-1]
    np.testing.assert_allclose([chunk.heard for chunk in chunks], 5 + starts / 16000, atol=1e-9)


@pytest.mark.parametrize("size", [333, 1 << 20])
@pytest.mark.parametrize(("subtype", "rate"), [("PCM_16", 48000), ("PCM_24", 16000), ("FLOAT", 22050), ("ULAW", 8000)])
def test_a_wav_on_stdin_is_heard_as_its_header_says(subtype, rate, size):
    """Two channels, in reads of any size, with more behind the sound."""
    soundfile.write(file := io.BytesIO(), np.stack([tone(rate), tone(rate)], 1), rate, subtype, format="WAV")
    content, decoder = file.getvalue() + b"LIST\x04\0\0\0more", Decoder(None)
    pieces = [decoder.decode(content[start : start + size]) for start in range(0, len(content), size)]
    sound = np.concatenate([*pieces, decoder.decode(b"", is_last=True)])
    assert len(sound) == pytest.approx(16000, abs=2)
    np.testing.assert_allclose(sound[200:15000], tone(16000)[200:15000], atol=0.02)


@pytest.mark.parametrize("size", [7, 1 << 20])
def test_wavs_one_after_another_are_all_heard(size):
    """As a speech service sends its sentences; the second has another rate, and values that are no numbers."""
    sound_of_16k, spoiled = tone(16000, 0.25), tone(24000, 0.25)
    spoiled[3000:3005] = np.nan
    content = b""
    for samples, rate in ((sound_of_16k, 16000), (spoiled, 24000)):
        soundfile.write(file := io.BytesIO(), samples, rate, "FLOAT", format="WAV")
        content += file.getvalue() + b"LIST\x04\0\0\0more"
    decoder = Decoder(None)
    pieces = [decoder.decode(content[start : start + size]) for start in range(0, len(content), size)]
    sound = np.concatenate([*pieces, decoder.decode(b"", is_last=True)])
    assert len(sound) == pytest.approx(8000, abs=2) and np.isfinite(sound).all()
    for start in (0, 4000):
        np.testing.assert_allclose(sound[start + 200 : start + 1800], sound_of_16k[200:1800], atol=0.01)


def test_a_wav_that_goes_on_after_a_clear_keeps_its_form():
    """It has two channels and no stated size, as one that a program writes while its agent speaks."""
    soundfile.write(file := io.BytesIO(), np.stack([tone(24000), tone(24000)], 1), 24000, format="WAV")
    content = bytearray(file.getvalue())
    content[40:44] = b"\xff" * 4
    decoder = Decoder(None)
    before = decoder.decode(bytes(content[:48_001]))
    decoder.clear()
    after = decoder.decode(bytes(content[48_001:]), is_last=True)
    np.testing.assert_allclose(np.concatenate([before, after])[200:15000], tone(16000)[200:15000], atol=0.01)


@pytest.mark.parametrize("channels", [1, 2])
def test_after_a_clear_the_next_byte_of_raw_pcm_begins_a_sample(channels):
    """What was interrupted ends in the middle of the samples of a moment."""
    content, decoder = pcm(np.repeat(tone(16000)[:, None], channels, axis=1)), Decoder(16000, channels)
    decoder.decode(content[:1001])
    decoder.clear()
    sound = decoder.decode(content).reshape(-1, channels)
    np.testing.assert_allclose(sound, np.repeat(tone(16000)[:, None], channels, axis=1), atol=1e-4)


def test_sound_that_is_held_back_becomes_silence_at_a_clear_but_not_that_of_the_other(clock):
    def heard():
        for number in range(10):
            clock.time = 100 + 0.1 * number + 0.01
            if number == 5:
                yield Chunk(np.zeros(0, np.float32), 100.5, change=Change(clear=True))
            change = {3: Change(cue=Cue("nod")), 4: Change(muted=True)}.get(number)
            sound = np.full(1600, number + 1, np.float32)
            yield Chunk(sound, 100 + 0.1 * number, -sound, change)

    told = [(chunk, clock.now()) for chunk in held_back(heard(), 0.2, clock)]
    assert all(now >= 100.9 or now - 0.2 >= chunk.heard for chunk, now in told if chunk.other is not None)
    place = next(index for index, (chunk, _) in enumerate(told) if chunk.change == Change(clear=True))
    assert (place, told.pop(place)[1]) == (3, pytest.approx(100.51))
    chunks = [chunk for chunk, _ in told]
    assert [chunk.samples[0] for chunk in chunks] == [1, 2, 3, 0, 0, 6, 7, 8, 9, 10]
    assert [-chunk.other[0] for chunk in chunks if chunk.other is not None] == list(range(1, 11))
    assert [chunk.change for chunk in chunks if chunk.change not in (None, Change())] == [Change(muted=True)]
