"""Checks of a single clip; each check yields one line for each error that it finds."""

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np

from ha2g_jax.data import records
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.files.reading import reason
from ha2g_jax.limits import MAX_CLIP_COORDINATE
from ha2g_jax.skeleton import Skeleton, load_skeleton

# Allowed factor between the length of a bone and its published mean; a wrong unit is a factor of 10 or more.
_LENGTH_FACTOR = 4
_WORD_SLACK = 0.1  # seconds by which a word may lie outside the clip, because aligners and video frames round
_AUDIO_SLACK = 0.25  # seconds allowed between the ends of motion and audio
_MAX_NUMBER = 1e12  # greatest time in seconds, amplitude or value of a style


def check_fields(fields: dict[str, Any], seconds: float, fps: float) -> Iterator[str]:
    """Check all fields of a clip except the motion, and yield a line for each error; the motion has no `problem`."""
    yield from _check_words(fields, seconds, max(_WORD_SLACK, 0.5 / fps))
    yield from _check_audio(fields, seconds, max(_AUDIO_SLACK, 0.5 / fps + 0.01))
    yield from _check_windows(fields)
    yield from _check_confidence(fields)
    yield from _check_images(fields)


def problem(fields: dict[str, Any], skeleton: Skeleton) -> str | None:
    """Return the reason why nothing can be done with the fields of a clip, None if it can be used.

    It says what the clip has: "positions that are NaN or infinite, first in frame 7".
    """
    if wrong := wrong_types(fields):
        return f"{', '.join(wrong)} of a wrong type"
    if found := _unusable_positions(fields["positions"], skeleton):
        return found
    confidence, frames = fields["confidence"], fields["positions"].shape[:2]
    if confidence is not None and confidence.shape != frames:
        return f"confidence of shape {confidence.shape}, expected {frames}"
    return None


def wrong_types(fields: dict[str, Any]) -> list[str]:
    """Return the names of the fields of a wrong type."""
    is_right = {
        "id": isinstance(fields["id"], str) and fields["id"] != "",
        "speaker": isinstance(fields["speaker"], str),
        "recording": isinstance(fields["recording"], str),
        "recording_start": _is_number(fields["recording_start"]),
        "audio": isinstance(fields["audio"], bytes),
        "words": all(isinstance(text, str) and _is_number(a) and _is_number(b) for text, a, b in fields["words"]),
        "window_starts": all(type(start) is int for start in fields["window_starts"]),
        "reference_images": _is_images(fields["reference_images"]),
        "strokes": all(_is_stroke(stroke) for stroke in fields["strokes"]),
        "style": all(_is_number(value) for value in fields["style"]),
    }
    return [name for name, right in is_right.items() if not right]


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and abs(value) < _MAX_NUMBER  # NaN is not


def _is_images(value: object) -> bool:
    return value is None or (isinstance(value, list) and all(isinstance(frame, bytes) for frame in value))


def _is_stroke(stroke: records.Stroke) -> bool:
    texts = (stroke.kind, stroke.hand, stroke.word_class)
    numbers = (stroke.time, stroke.start, stroke.end, stroke.amplitude)
    return all(isinstance(text, str) for text in texts) and all(_is_number(number) for number in numbers)


def check_positions(positions: np.ndarray, skeleton: Skeleton) -> Iterator[str]:
    """Check the motion (T, joints, 3) of a clip in metres.

    Yields at most one line, because each error makes the next checks meaningless.
    """
    if found := _unusable_positions(positions, skeleton):
        yield found
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


def _unusable_positions(positions: np.ndarray, skeleton: Skeleton) -> str | None:
    if positions.ndim != 3 or positions.shape[1:] != (skeleton.num_joints, 3) or not len(positions):
        return f"positions of shape {positions.shape}, expected (T, {skeleton.num_joints}, 3) of {skeleton.name}"
    is_finite = np.isfinite(positions).all(axis=(1, 2))
    if not is_finite.all():
        return f"positions that are NaN or infinite, first in frame {is_finite.argmin()}"
    if (farthest := float(np.abs(positions).max())) > MAX_CLIP_COORDINATE:
        return f"positions up to {farthest:.3g} m, expected {MAX_CLIP_COORDINATE:,} m at most"
    return None


def _check_words(fields: dict[str, Any], seconds: float, slack: float) -> Iterator[str]:
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
        if word.start < -slack or word.end > seconds + slack:
            yield f"word {word.text!r} at {word.start:.2f} to {word.end:.2f} s lies outside the clip of {seconds:.2f} s"
            break


def _check_audio(fields: dict[str, Any], seconds: float, slack: float) -> Iterator[str]:
    try:
        # The length declared in the header is checked first, so that hours of audio are not decoded for a short clip.
        declared = records.flac_seconds(fields["audio"])
        if abs(declared - seconds) > slack:
            yield f"{declared:.2f} s of audio for {seconds:.2f} s of motion"
            return
        audio = records.decode_flac(fields["audio"], seconds + slack)
    except records.DAMAGE as error:
        yield f"audio that cannot be read ({reason(error)})"
        return
    if not np.isfinite(audio).all():
        yield "audio that is NaN or infinite"
    if abs(len(audio) / SAMPLE_RATE - seconds) > slack:
        yield f"{len(audio) / SAMPLE_RATE:.2f} s of audio for {seconds:.2f} s of motion"


def _check_windows(fields: dict[str, Any]) -> Iterator[str]:
    starts, frames = fields["window_starts"], len(fields["positions"])
    outside = [start for start in starts if not 0 <= start < frames]
    if outside:
        yield f"{len(outside)} windows outside its {frames} frames, one at frame {outside[0]}"
    if len(set(starts)) < len(starts):
        yield "the same window twice"


def _check_confidence(fields: dict[str, Any]) -> Iterator[str]:
    confidence = fields["confidence"]
    if confidence is not None and not ((confidence >= 0) & (confidence <= 1)).all():  # NaN is in neither
        yield "confidence outside 0 to 1"


def _check_images(fields: dict[str, Any]) -> Iterator[str]:
    try:
        if fields["reference_images"]:
            records.decode_pictures(fields["reference_images"])
    except records.DAMAGE as error:
        yield f"an image of the speaker cannot be read ({reason(error)})"


def bone_lengths(positions: np.ndarray, skeleton: Skeleton) -> np.ndarray:
    """Return the lengths (T, bones) of the bones of positions (T, joints, 3), in metres."""
    parents, children = (list(ends) for ends in zip(*skeleton.bones, strict=True))
    return np.linalg.norm(positions[:, children].astype(np.float64) - positions[:, parents], axis=-1)


def bone_name(skeleton: Skeleton, bone: int) -> str:
    """Return the names of both joints of a bone, "PARENT - CHILD"."""
    return " - ".join(skeleton.joints[joint] for joint in skeleton.bones[bone])
