"""Checks of a single clip; each check yields one line for each error that it finds."""

import io
import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import soundfile

from ha2g_jax.data import records
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.pictures import PICTURE_ERRORS, decode_picture
from ha2g_jax.files.reading import reason
from ha2g_jax.limits import MAX_CLIP_PIXELS
from ha2g_jax.skeleton import Skeleton, load_skeleton

# Allowed factor between the length of a bone and its published mean; a wrong unit is a factor of 10 or more.
_LENGTH_FACTOR = 4
_WORD_SLACK = 0.1  # seconds by which a word may lie outside the clip, because aligners and video frames round
_MAX_SIDE = 4096  # pixels of an image
_AUDIO_SLACK = 0.25  # seconds allowed between the ends of motion and audio


def check_fields(fields: dict[str, Any], seconds: float) -> Iterator[str]:
    """Check all fields of a clip except the motion.

    Args:
        fields: fields that `records.unpack` returns, of the right types (see `wrong_types`).
        seconds: length of the motion in seconds.

    Yields:
        One line for each error.
    """
    yield from _check_words(fields, seconds)
    yield from _check_audio(fields, seconds)
    yield from _check_windows(fields)
    yield from _check_confidence(fields)
    yield from _check_images(fields)


def wrong_types(fields: dict[str, Any]) -> list[str]:
    """Return the names of the fields of a wrong type.

    Args:
        fields: fields that `records.unpack` returns.
    """
    is_right = {
        "id": isinstance(fields["id"], str) and fields["id"] != "",
        "speaker": isinstance(fields["speaker"], str),
        "recording": isinstance(fields["recording"], str),
        "recording_start": _is_number(fields["recording_start"]),
        "audio": isinstance(fields["audio"], bytes),
        "words": all(isinstance(text, str) and _is_number(a) and _is_number(b) for text, a, b in fields["words"]),
        "window_starts": all(isinstance(start, int) for start in fields["window_starts"]),
        "reference_images": _is_images(fields["reference_images"]),
    }
    return [name for name, right in is_right.items() if not right]


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and bool(np.isfinite(value))


def _is_images(value: object) -> bool:
    return value is None or (isinstance(value, list) and all(isinstance(frame, bytes) for frame in value))


def check_positions(positions: np.ndarray, skeleton: Skeleton) -> Iterator[str]:
    """Check the motion of a clip.

    Args:
        positions: (T, joints, 3) in metres.
        skeleton: skeleton of the corpus.

    Yields:
        At most one line, because each error makes the next checks meaningless.
    """
    if positions.ndim != 3 or positions.shape[1:] != (skeleton.num_joints, 3) or not len(positions):
        yield f"positions of shape {positions.shape}, expected (T, {skeleton.num_joints}, 3) of {skeleton.name}"
        return
    is_finite = np.isfinite(positions).all(axis=(1, 2))
    if not is_finite.all():
        yield f"positions that are NaN or infinite, first in frame {is_finite.argmin()}"
        return
    median = np.median(bone_lengths(positions, skeleton), axis=0)
    expected = load_skeleton(skeleton.name).lengths.astype(np.float64)
    factor = np.maximum(median, 1e-12) / expected
    is_odd = (factor < 1 / _LENGTH_FACTOR) | (factor > _LENGTH_FACTOR)
    if is_odd.any():
        worst = int(np.abs(np.log(factor)).argmax())
        yield (
            f"{is_odd.sum()} of {len(is_odd)} bones of implausible length, {bone_name(skeleton, worst)} of "
            f"{median[worst]:.4g} m (expected {expected[worst] / _LENGTH_FACTOR:.2g} to "
            f"{expected[worst] * _LENGTH_FACTOR:.2g} m)"
        )


def _check_words(fields: dict[str, Any], seconds: float) -> Iterator[str]:
    words = fields["words"]
    for before, word in itertools.pairwise(words):
        if word.start < before.start:
            yield f"words out of order: {word.text!r} at {word.start:.2f} s after {before.text!r}"
            break
    for word in words:
        if not word.text.strip() or word.end < word.start:
            yield f"word {word.text!r} from {word.start:.2f} to {word.end:.2f} s is empty"
            break
    for word in words:
        if word.start < -_WORD_SLACK or word.end > seconds + _WORD_SLACK:
            yield f"word {word.text!r} at {word.start:.2f} to {word.end:.2f} s lies outside the clip of {seconds:.2f} s"
            break


def _check_audio(fields: dict[str, Any], seconds: float) -> Iterator[str]:
    try:
        # The length declared in the header is checked first, so that hours of audio are not decoded for a short clip.
        declared = soundfile.info(io.BytesIO(fields["audio"])).duration
        if abs(declared - seconds) > _AUDIO_SLACK:
            yield f"{declared:.2f} s of audio for {seconds:.2f} s of motion"
            return
        audio = records.decode_audio(fields, "its record")
    except (soundfile.SoundFileError, UserError) as error:
        yield f"audio that cannot be read ({error})"
        return
    if not np.isfinite(audio).all():
        yield "audio that is NaN or infinite"
    if abs(len(audio) / SAMPLE_RATE - seconds) > _AUDIO_SLACK:
        yield f"{len(audio) / SAMPLE_RATE:.2f} s of audio for {seconds:.2f} s of motion"


def _check_windows(fields: dict[str, Any]) -> Iterator[str]:
    starts, frames = fields["window_starts"], len(fields["positions"])
    outside = [start for start in starts if not 0 <= start < frames]
    if outside:
        yield f"{len(outside)} windows outside its {frames} frames, one at frame {outside[0]}"
    if len(set(starts)) < len(starts):
        yield "the same window twice"


def _check_confidence(fields: dict[str, Any]) -> Iterator[str]:
    confidence, positions = fields["confidence"], fields["positions"]
    if confidence is None:
        return
    if confidence.shape != positions.shape[:2]:
        yield f"confidence of shape {confidence.shape}, expected {positions.shape[:2]}"
    elif not ((confidence >= 0) & (confidence <= 1)).all():  # NaN is in neither
        yield "confidence outside 0 to 1"


def _check_images(fields: dict[str, Any]) -> Iterator[str]:
    sizes = set()
    for frame in fields["reference_images"] or ():
        try:
            width, height = decode_picture(frame, MAX_CLIP_PIXELS).size
        except PICTURE_ERRORS as error:
            yield f"an image of the speaker cannot be read ({reason(error)})"
            return
        if max(width, height) > _MAX_SIDE:
            yield f"an image of the speaker is {width} x {height} pixels, expected {_MAX_SIDE} at most"
            return
        sizes.add((width, height))
    if len(sizes) > 1:
        yield f"images of the speaker of {len(sizes)} sizes, {' and '.join(f'{w} x {h}' for w, h in sorted(sizes)[:2])}"


def bone_lengths(positions: np.ndarray, skeleton: Skeleton) -> np.ndarray:
    """Return the lengths of the bones, (T, bones) in metres.

    Args:
        positions: (T, joints, 3) in metres.
        skeleton: skeleton of the positions.
    """
    parents, children = (list(ends) for ends in zip(*skeleton.bones, strict=True))
    return np.linalg.norm(positions[:, children].astype(np.float64) - positions[:, parents], axis=-1)


def bone_name(skeleton: Skeleton, bone: int) -> str:
    """Return the names of both joints of a bone, "PARENT - CHILD"."""
    return " - ".join(skeleton.joints[joint] for joint in skeleton.bones[bone])
