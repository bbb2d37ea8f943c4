"""The rows of an evaluation: all methods on the same clips, and the sanity rows that show what a metric does."""

import collections
import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ha2g_jax.data.records import WINDOW_FRAMES
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.clip_result import ClipResult
from ha2g_jax.metrics import sanity
from ha2g_jax.metrics.row import SEED_FRAMES, Reference, Row
from ha2g_jax.metrics.sanity import HALF, MISMATCHED, SANITY_ROWS, TRUTH
from ha2g_jax.skeleton import Skeleton

if TYPE_CHECKING:
    from ha2g_jax.evaluation.features import PoseFeatures

MIN_FRAMES = SEED_FRAMES + 8  # least number of frames of a clip: half a second after the seed pose

_MAX_ERROR = 0.01  # largest error of the length of a direction vector


class Rows(NamedTuple):
    """All rows of an evaluation except `HALF`, which is a division of ground truth.

    Attributes:
        rows: name of each row -> its motions; ground truth is `TRUTH`.
        reference: what all rows have in common.
        ids: (n,) names of the reference clips.
        notes: what was cut or left out, a sentence each.
    """

    rows: dict[str, Row]
    reference: Reference
    ids: list[str]
    notes: list[str]

    @property
    def truth(self) -> Row:
        """The row of ground truth."""
        return self.reference.truth


def make_rows(
    methods: Mapping[str, Sequence[ClipResult]],
    reference: Sequence[ClipResult],
    skeleton: Skeleton,
    *,
    training: Sequence[np.ndarray] | None = None,
    autoencoder: "PoseFeatures | None" = None,
    seed: int = 0,
) -> Rows:
    """Bring all rows to the same clips of the same lengths, and add the sanity rows.

    A clip is as long as the shortest of its motions and its reference. Clips that a method has no motion for, and clips
    of less than `MIN_FRAMES`, are left out of all rows.

    The arguments are those of `evaluate.evaluate`; the default of `training` is the reference before it is cut.

    Raises:
        UserError: no clip is left, motion of different skeletons or frame rates, or vectors that are not of length 1.
    """
    if taken := set(methods) & set(SANITY_ROWS):
        raise UserError(f"a method is called {taken.pop()!r}, as a sanity row is; give it another name")
    notes: list[str] = []
    usual = [clip.directions for clip in reference] if training is None else training
    clips, lengths = _common(methods, reference, notes)
    recordings, members = np.unique([clip.recording for clip in clips], return_inverse=True)
    common = Reference(
        skeleton=skeleton,
        fps=clips[0].fps,
        directions=[clip.directions[: lengths[clip.id]] for clip in clips],
        onsets=[_within(clip.onsets, lengths[clip.id] / clip.fps) for clip in clips],
        borders=[np.array(clip.borders, int) for clip in clips],
        audio=[clip.audio for clip in clips],
        recordings=recordings[members],
        members=members,
        training=usual,
        encode=autoencoder,
        window=WINDOW_FRAMES,
        seed=seed,
    )
    places = {clip.id: number for number, clip in enumerate(clips)}
    rows = {name: _method_row(results, places, lengths, common) for name, results in methods.items()}
    rows |= {TRUTH: common.truth} | _sanity_rows(common)
    return Rows(rows, common, [clip.id for clip in clips], notes)


def _common(
    methods: Mapping[str, Sequence[ClipResult]], reference: Sequence[ClipResult], notes: list[str]
) -> tuple[list[ClipResult], dict[str, int]]:
    """Return the reference clips that all rows have, and the number of frames of each."""
    if twice := [name for name, count in collections.Counter(clip.id for clip in reference).items() if count > 1]:
        raise UserError(f"the reference has {len(twice)} clips twice, such as {twice[0]}; give each another name")
    lengths = {clip.id: clip.num_frames for clip in reference}
    for clips in methods.values():
        for clip in clips:
            lengths[clip.id] = min(lengths.get(clip.id, 0), clip.num_frames)
    everywhere = set(lengths).intersection(*({clip.id for clip in clips} for clips in methods.values()))
    shared = [clip for clip in reference if clip.id in everywhere]
    if not shared:
        raise UserError("no clip has motion by all methods; give motion of the same clips as the reference")
    _check_alike([clip for clips in (reference, *methods.values()) for clip in clips if clip.id in everywhere])
    kept = [clip for clip in shared if lengths[clip.id] >= MIN_FRAMES]
    if not kept:
        raise UserError(
            f"all {len(shared)} clips have less than {MIN_FRAMES} frames, {shared[0].fps:g} a second; give longer ones"
        )
    if missing := len(reference) - len(shared):
        notes.append(f"clips of the reference that lack the motion of a method and are left out: {missing}")
    if short := len(shared) - len(kept):
        notes.append(f"clips of less than {MIN_FRAMES} frames, which are left out: {short}")
    if cut := _cut(kept, lengths):
        notes.append(f"clips whose reference was cut to the length of the motion: {cut}")
    kept_ids = {clip.id for clip in kept}
    for name, clips in methods.items():
        if cut := _cut([clip for clip in clips if clip.id in kept_ids], lengths):
            notes.append(f"{name}: clips whose motion was cut to the length of the shortest: {cut}")
    return kept, lengths


def _cut(clips: Sequence[ClipResult], lengths: Mapping[str, int]) -> str:
    """Say how many clips are longer than their lengths in frames, and by how much; "" if none is."""
    cut = [clip.num_frames - lengths[clip.id] for clip in clips if clip.num_frames > lengths[clip.id]]
    return f"{len(cut)}, by {sum(cut) / clips[0].fps:.1f} s in all" if cut else ""


def _check_alike(clips: Sequence[ClipResult]) -> None:
    first = clips[0]
    for clip in clips:
        if clip.fps != first.fps or clip.directions.shape[1:] != first.directions.shape[1:]:
            raise UserError(
                f"{clip.id} has {clip.directions.shape[1]} bones at {clip.fps:g} frames per second, {first.id} "
                f"{first.directions.shape[1]} at {first.fps:g}; evaluate motion of one skeleton and one rate at a time"
            )
        if not np.isfinite(clip.directions).all():
            raise UserError(f"the motion of {clip.id} has values that are not numbers; generate it again")
        lengths = np.linalg.norm(clip.directions, axis=-1)
        is_wrong = (np.abs(lengths - 1) > _MAX_ERROR) & (lengths > 0)  # a bone without a length has no direction
        if is_wrong.any():
            raise UserError(
                f"the motion of {clip.id} has direction vectors of length {lengths[is_wrong][0]:.3g}, not 1; add the "
                "mean pose if it was subtracted, and normalise them"
            )


def _method_row(
    results: Sequence[ClipResult], places: dict[str, int], lengths: dict[str, int], reference: Reference
) -> Row:
    clips = sorted((clip for clip in results if clip.id in places), key=lambda clip: places[clip.id])
    numbers = np.array([places[clip.id] for clip in clips])
    return Row(
        reference=reference,
        directions=[clip.directions[: lengths[clip.id]] for clip in clips],
        numbers=numbers,
        onsets=[reference.onsets[number] for number in numbers],
        borders=[np.array(clip.borders, int) for clip in clips],
    )


def _sanity_rows(reference: Reference) -> dict[str, Row]:
    truth, seed = reference.truth, reference.seed
    mean = mean_directions(reference.training)
    no_borders = [np.zeros(0, int)] * len(truth.directions)
    rows = {
        name: dataclasses.replace(truth, directions=made, borders=no_borders)
        for name, made in sanity.rows(truth.directions, mean, seed=seed).items()
    }
    others = sanity.mismatched_onsets(
        reference.onsets,
        [str(member) for member in reference.members],
        [len(clip) for clip in reference.directions],
        reference.fps,
        seed=reference.seed,
    )
    rows[MISMATCHED] = dataclasses.replace(truth, onsets=others, has_counterpart=False)
    return {name: rows[name] for name in SANITY_ROWS if name not in (TRUTH, HALF)}


def mean_directions(clips: Sequence[np.ndarray]) -> np.ndarray:
    """Return the mean (bones, 3) over all frames of clips (T, bones, 3); not of unit length."""
    total = sum(np.sum(clip, axis=0, dtype=np.float64) for clip in clips)
    return np.asarray(total) / sum(map(len, clips))


def _within(onsets: np.ndarray | None, seconds: float) -> np.ndarray | None:
    return None if onsets is None else np.extract(np.less(onsets, seconds), onsets)
