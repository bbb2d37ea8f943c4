"""Program that estimates the landmarks of body and hands in images with MediaPipe Holistic.

`python holistic.py OUT.npz < images`: each image is its width and height (two little-endian uint32), then its RGB
bytes. `pose` runs this program in another environment, because MediaPipe needs numpy < 2; therefore it imports nothing
of this package, and no module imports it.

It writes `world` (T, 33, 4): metres and visibility, `image` (T, 33, 2): pixels, `left_hand` and `right_hand`
(T, 21, 3): pixels, depth relative to the wrist in the same unit, `sizes` (T, 2): width and height of the images in
pixels; NaN where nothing was found.
"""

import os
import struct
import sys
from collections.abc import Iterator
from typing import Any, BinaryIO

import numpy as np

_HEADER = struct.Struct("<2I")
_NUM_BODY, _NUM_HAND = 33, 21
_WRISTS = [15, 16]  # indices of landmarks of the body
_KNUCKLES = [5, 9, 13, 17]  # indices of landmarks of a hand
_VISIBLE = 0.5
# Maximum distance of a hand from the body's wrist, and minimum distance of both hands, in palms (wrist to knuckles).
_NEAR, _APART = 1.2, 0.45


def main() -> None:
    """Read images from standard input until its end, then write the file atomically."""
    (out,) = sys.argv[1:]
    found = estimate(read_images(sys.stdin.buffer))
    temporary = f"{out}.part"
    with open(temporary, "wb") as file:  # noqa: PTH123
        np.savez(file, **found)
    os.replace(temporary, out)  # noqa: PTH105


def read_images(stream: BinaryIO) -> Iterator[np.ndarray]:
    """Yield the images (height, width, 3) uint8 of a stream in the format of this program.

    Raises:
        EOFError: the stream ends within an image.
    """
    while header := stream.read(_HEADER.size):
        width, height = _HEADER.unpack(header)
        data = stream.read(width * height * 3)
        if len(data) < width * height * 3:
            raise EOFError("the stream ends within an image")
        yield np.frombuffer(data, np.uint8).reshape(height, width, 3)


def estimate(images: Iterator[np.ndarray]) -> dict[str, Any]:
    """Estimate the landmarks of images (height, width, 3) uint8: the arrays of the module's docstring by name.

    Tracking from image to image keeps the body steady (a third of the jitter of independent images), but it may
    exchange hands that cross and not recover. In such images the hands are estimated independently.
    """
    from mediapipe.python.solutions.holistic import Holistic

    found: dict[str, list[np.ndarray]] = {name: [] for name in ("world", "image", "left_hand", "right_hand", "sizes")}
    # Complexity 2 is not bundled. MediaPipe's smoothing lags behind the motion, that of `smoothing` does not.
    with (
        Holistic(model_complexity=1, smooth_landmarks=False) as tracking,
        Holistic(model_complexity=1, static_image_mode=True) as anew,
    ):
        for image in images:
            height, width, _ = image.shape
            pixels = np.array([width, height, width], np.float32)
            result = tracking.process(image)
            body = _landmarks(result.pose_landmarks, _NUM_BODY)
            hands, is_right = _hands(result, body, pixels)
            is_visible = np.nan_to_num(body[_WRISTS, 3]) >= _VISIBLE
            if (is_visible & ~is_right).any():
                others, is_better = _hands(anew.process(image), body, pixels)
                if is_better.sum() > is_right.sum():
                    hands, is_right = others, is_better
            hands[~is_right] = np.nan
            values = (_landmarks(result.pose_world_landmarks, _NUM_BODY), body[:, :2] * pixels[:2], *hands, pixels[:2])
            for values_so_far, value in zip(found.values(), values):
                values_so_far.append(value)
    return {name: np.array(values, np.float32) for name, values in found.items()}


def _hands(result, body: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the left and right hand (2, 21, 3) in pixels, and whether each belongs to the body's wrist."""
    landmarks = (result.left_hand_landmarks, result.right_hand_landmarks)
    hands = np.stack([_landmarks(hand, _NUM_HAND)[:, :3] * pixels for hand in landmarks])
    return hands, which_fit(hands, body[_WRISTS, :2] * pixels[:2])


def which_fit(hands: np.ndarray, wrists: np.ndarray) -> np.ndarray:
    """Return which hands (2, 21, 3) in pixels lie at the wrists (2, 2) of the body and do not coincide, (2,) bool."""
    palms = np.linalg.norm(hands[:, _KNUCKLES] - hands[:, :1], axis=-1).mean(axis=1)
    distances = np.linalg.norm(hands[:, 0, :2] - wrists, axis=-1)
    fits = distances < _NEAR * palms  # False for NaN
    between = np.linalg.norm(hands[0, :, :2] - hands[1, :, :2], axis=-1).mean()
    if between < _APART * palms.max():  # the same hand was found twice
        fits[np.argmax(distances)] = False
    return fits


def _landmarks(landmarks, count: int) -> np.ndarray:
    if landmarks is None:
        return np.full((count, 4), np.nan, np.float32)
    return np.array([[mark.x, mark.y, mark.z, mark.visibility] for mark in landmarks.landmark], np.float32)


if __name__ == "__main__":
    main()
