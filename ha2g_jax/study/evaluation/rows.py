"""The rows of an evaluation: all methods on the same clips, and the motions that show what a metric does."""

import collections
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.metrics import sanity
from ha2g_jax.study.evaluation.metrics import FROZEN, HALF, JITTER, MEAN_POSE, MISMATCHED, SANITY_ROWS, SMOOTHED, TRUTH
from ha2g_jax.study.evaluation.performance import SEED_FRAMES, Performance

MIN_FRAMES = SEED_FRAMES + 8  # of a clip: half a second after the seed pose


class Row(NamedTuple):
    """The motions of one row; the first axis of everything is its clips.

    Attributes:
        directions: (T, bones, 3) of each clip, as long as its reference.
        numbers: (n,) index of each clip's reference.
        onsets: of the sound that the motion is scored with, None without sound.
        borders: first frames of the windows that it was joined from.
        has_counterpart: whether the reference is what the motion should be like.
    """

    directions: list[np.ndarray]
    numbers: np.ndarray
    onsets: list[np.ndarray | None]
    borders: list[np.ndarray]
    has_counterpart: bool


class Rows(NamedTuple):
    """All rows but `HALF`, which is a way to divide ground truth.

    Attributes:
        rows: name of each row; ground truth is `TRUTH`.
        ids: (n,) of the reference clips.
        sources: (n,) recordings that they were cut from.
        members: (n,) index of each clip's source in the sorted sources.
        audio: (n,) samples of each clip, None where unknown.
        notes: what was cut or left out, a sentence each.
    """

    rows: dict[str, Row]
    ids: list[str]
    sources: np.ndarray
    members: np.ndarray
    audio: list[np.ndarray | None]
    notes: list[str]

    @property
    def truth(self) -> Row:
        return self.rows[TRUTH]

    @property
    def num_sources(self) -> int:
        return int(self.members.max()) + 1


def make_rows(
    methods: Mapping[str, Sequence[Performance]],
    reference: Sequence[Performance],
    mean_directions: np.ndarray,
    seed: int = 0,
) -> Rows:
    """Brings all rows to the same clips of the same lengths, and adds the sanity rows.

    A clip is as long as the shortest of its performances and its reference. Clips that a method has not performed, and
    clips of less than `MIN_FRAMES`, are left out of all rows.

    Args:
        methods: performances of each method, at least one of each clip.
        reference: the true motion, one performance of a clip.
        mean_directions: (bones, 3) of the mean pose.
        seed: of the jitter and of the pairs of mismatched speech.

    Raises:
        UserError: no clip is left, or motion of different skeletons or frame rates.
    """
    if taken := set(methods) & set(SANITY_ROWS):
        raise UserError(f"a method is called {taken.pop()!r}, as a sanity row is; give it another name")
    notes: list[str] = []
    reference, lengths = _common(methods, reference, notes)
    truth = Row(
        directions=[clip.directions[: lengths[clip.id]] for clip in reference],
        numbers=np.arange(len(reference)),
        onsets=[_within(clip.onsets, lengths[clip.id] / clip.fps) for clip in reference],
        borders=[np.array(clip.borders, int) for clip in reference],
        has_counterpart=True,
    )
    places = {clip.id: number for number, clip in enumerate(reference)}
    rows = {name: _method_row(clips, places, lengths, truth) for name, clips in methods.items()}
    sources, members = np.unique([clip.source for clip in reference], return_inverse=True)
    rows |= {TRUTH: truth} | _sanity_rows(truth, members, mean_directions, seed)
    return Rows(
        rows, [clip.id for clip in reference], sources[members], members, [clip.audio for clip in reference], notes
    )


def _common(
    methods: Mapping[str, Sequence[Performance]], reference: Sequence[Performance], notes: list[str]
) -> tuple[list[Performance], dict[str, int]]:
    """The reference clips that all rows have, and how many frames of each."""
    if twice := [name for name, count in collections.Counter(clip.id for clip in reference).items() if count > 1]:
        raise UserError(f"the reference has {len(twice)} clips twice, such as {twice[0]}; give each another name")
    lengths = {clip.id: clip.num_frames for clip in reference}
    for clips in methods.values():
        for clip in clips:
            lengths[clip.id] = min(lengths.get(clip.id, 0), clip.num_frames)
    everywhere = set(lengths).intersection(*({clip.id for clip in clips} for clips in methods.values()))
    shared = [clip for clip in reference if clip.id in everywhere]
    if not shared:
        raise UserError("no clip has been performed by all methods; give motion of the same clips as the reference")
    _check_alike([clip for clips in (reference, *methods.values()) for clip in clips if clip.id in everywhere])
    kept = [clip for clip in shared if lengths[clip.id] >= MIN_FRAMES]
    if not kept:
        raise UserError(
            f"all {len(shared)} clips have less than {MIN_FRAMES} frames, {shared[0].fps:g} a second; give longer ones"
        )
    if missing := len(reference) - len(shared):
        notes.append(f"{missing} clips of the reference have not been performed by all methods and are left out")
    if short := len(shared) - len(kept):
        notes.append(f"{short} clips of less than {MIN_FRAMES} frames are left out")
    cut = [clip.num_frames - lengths[clip.id] for clip in kept if clip.num_frames > lengths[clip.id]]
    if cut:
        notes.append(
            f"reference of {len(cut)} clips cut to the length of their motion, {sum(cut) / kept[0].fps:.1f} s in all"
        )
    kept_ids = {clip.id for clip in kept}
    for name, clips in methods.items():
        longer = sum(clip.num_frames > lengths[clip.id] for clip in clips if clip.id in kept_ids)
        if longer:
            notes.append(f"{name}: motion of {longer} clips cut to the length of the shortest")
    return kept, lengths


def _check_alike(clips: Sequence[Performance]) -> None:
    first = clips[0]
    for clip in clips:
        if clip.fps != first.fps or clip.directions.shape[1:] != first.directions.shape[1:]:
            raise UserError(
                f"{clip.id} has {clip.directions.shape[1]} bones at {clip.fps:g} frames per second, {first.id} "
                f"{first.directions.shape[1]} at {first.fps:g}; evaluate motion of one skeleton and one rate at a time"
            )
        if not np.isfinite(clip.directions).all():
            raise UserError(f"the motion of {clip.id} has values that are no numbers; generate it again")


def _method_row(clips: Sequence[Performance], places: dict[str, int], lengths: dict[str, int], truth: Row) -> Row:
    clips = [clip for clip in clips if clip.id in places]
    numbers = np.array([places[clip.id] for clip in clips])
    return Row(
        directions=[clip.directions[: lengths[clip.id]] for clip in clips],
        numbers=numbers,
        onsets=[truth.onsets[number] for number in numbers],
        borders=[np.array(clip.borders, int) for clip in clips],
        has_counterpart=True,
    )


def _sanity_rows(truth: Row, members: np.ndarray, mean_directions: np.ndarray, seed: int) -> dict[str, Row]:
    made = sanity.rows(truth.directions, mean_directions, seed=seed, first_frame=SEED_FRAMES)
    keys = {MEAN_POSE: "mean_pose", FROZEN: "frozen", JITTER: "white_jitter", SMOOTHED: "smoothed"}
    no_borders = [np.zeros(0, int)] * len(truth.directions)
    rows = {name: truth._replace(directions=made[key], borders=no_borders) for name, key in keys.items()}
    rows[MISMATCHED] = truth._replace(onsets=_other_onsets(truth, members, seed), has_counterpart=False)
    return {name: rows[name] for name in SANITY_ROWS if name not in (TRUTH, HALF)}


def _other_onsets(truth: Row, members: np.ndarray, seed: int) -> list[np.ndarray | None]:
    """The onsets of another source's clip for each clip; none where all clips with sound are of one source."""
    heard = [number for number, onsets in enumerate(truth.onsets) if onsets is not None]
    others: list[np.ndarray | None] = [None] * len(truth.onsets)
    if len(set(members[heard].tolist())) < 2:
        return others
    lengths = [len(truth.directions[number]) for number in heard]
    sources = [str(member) for member in members[heard]]
    partners = sanity.derangement(sources, np.random.default_rng(seed), lengths=lengths)
    for number, partner in zip(heard, partners.tolist(), strict=True):
        others[number] = truth.onsets[heard[partner]]
    return others


def _within(onsets: np.ndarray | None, seconds: float) -> np.ndarray | None:
    return None if onsets is None else onsets[onsets < seconds]
