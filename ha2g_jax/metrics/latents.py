"""Latents of the windows of a row, in the latent space of a pose auto-encoder."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.metrics.row import SEED_FRAMES, Reference, Row

FGD_CUT, FGD_SEEDED_CUT = "fgd", "fgd_seeded"


class Cut(NamedTuple):
    """The places where windows begin.

    Attributes:
        name: `FGD_CUT` where the seed pose is not in the windows, else `FGD_SEEDED_CUT`.
        first_frame: first frame of the first window of a clip; another window follows each one without overlap.
        window: number of frames of a window.
    """

    name: str
    first_frame: int
    window: int

    def starts(self, num_frames: int) -> range:
        """Return the first frames of the windows of a clip of `num_frames`."""
        return range(self.first_frame, num_frames - self.window + 1, self.window)


class Latents(NamedTuple):
    """Latents of the windows of a row.

    Attributes:
        latents: (n, d) latents.
        members: (n,) index of the recording of each window.
        inputs: (n,) index of the speech of each window, a place in a clip.
        cut: places where the windows begin.
    """

    latents: np.ndarray
    members: np.ndarray
    inputs: np.ndarray
    cut: Cut


def choose_cut(lengths: Sequence[int], window: int) -> Cut | None:
    """Choose how clips of some lengths are cut; None where none is as long as a window.

    The seed pose is left out of the windows unless most clips that are as long as a window would have none then.
    """
    windows = sum(length >= window for length in lengths)
    unseeded = sum(length >= window + SEED_FRAMES for length in lengths)
    if not windows:
        return None
    return Cut(FGD_CUT, SEED_FRAMES, window) if 2 * unseeded >= windows else Cut(FGD_SEEDED_CUT, 0, window)


def reference_cut(reference: Reference) -> Cut | None:
    """Choose how the clips of a table are cut."""
    return choose_cut([len(directions) for directions in reference.directions], reference.window)


def cut_windows(row: Row, cut: Cut) -> np.ndarray | None:
    """Return the windows (n, window, bones, 3) float32 of all clips of a row; None where no clip is as long as one."""
    windows = [
        directions[start : start + cut.window] for directions in row.directions for start in cut.starts(len(directions))
    ]
    return np.stack(windows).astype(np.float32) if windows else None


def places(row: Row, cut: Cut) -> list[tuple[int, int]]:
    """Return clip and first frame of each window of a row."""
    return [
        (int(number), start)
        for directions, number in zip(row.directions, row.numbers, strict=True)
        for start in cut.starts(len(directions))
    ]


def row_latents(row: Row) -> Latents | None:
    """Encode the windows of a row; None without an auto-encoder or a window."""
    reference = row.reference
    if row is not reference.truth and row.directions is reference.directions:  # the speech is mismatched
        return reference.truth.once(row_latents)
    cut = reference.once(reference_cut)
    if reference.encode is None or cut is None:
        return None
    windows, found = cut_windows(row, cut), places(row, cut)
    if windows is None:
        return None
    _, inputs = np.unique(found, axis=0, return_inverse=True)
    members = reference.members[[number for number, _ in found]]
    return Latents(reference.encode(windows), members, inputs, cut)
