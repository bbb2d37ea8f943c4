"""Index of the windows of a split, made in one pass over its records that also finds unusable records."""

from collections.abc import Container
from typing import Any, NamedTuple

import numpy as np
import tqdm

from ha2g_jax.data.corpus import Corpus
from ha2g_jax.errors import UserError


class WindowIndex(NamedTuple):
    """The windows of a split, and the names and speakers of its clips.

    Attributes:
        clips: (W,) int32 number of the clip of each window.
        starts: (W,) int32 first frame of each window.
        names: id of each clip.
        speakers: (clips,) int32 index of the speaker of each clip.
        lasts: (clips,) int32 last frame of each clip at which a window can start.
    """

    clips: np.ndarray
    starts: np.ndarray
    names: list[str]
    speakers: np.ndarray
    lasts: np.ndarray


def make_index(
    corpus: Corpus, split: str, num_frames: int, num_images: int = 0, among: Container[str] | None = None
) -> WindowIndex:
    """Index the windows of a split.

    Audio and images stay compressed; all other fields of each record are checked.

    Args:
        corpus: corpus of the clips.
        split: name of the split.
        num_frames: length N of a window in frames.
        num_images: number of images that each clip must have.
        among: names of the speakers whose clips are used; all by default.

    Raises:
        UserError: no clip has a window of N frames, or a record is damaged, has positions that are not finite or not
            of the corpus' skeleton, an unknown speaker or too few images; the message names the record.
    """
    clips = corpus.clips(split)
    speaker_index = {name: index for index, name in enumerate(corpus.speakers)}
    names, speakers, lasts, starts, counts = [], [], [], [], []
    for number in tqdm.trange(len(clips), desc=f"Reading {split}", unit="clip", leave=False, disable=None):
        fields = clips.fields(number)
        place = clips.title(fields, number)
        _check_images(fields["reference_images"], num_images, place)
        if fields["speaker"] not in speaker_index:
            raise UserError(
                f"{place} has a speaker {fields['speaker'][:60]!r} that dataset.json lacks; "
                "make or import the corpus again"
            )
        last = len(fields["positions"]) - num_frames
        is_wanted = among is None or fields["speaker"] in among
        fitting = [start for start in fields["window_starts"] if is_wanted and 0 <= start <= last]
        names.append(fields["id"])
        speakers.append(speaker_index[fields["speaker"]])
        lasts.append(last)
        starts.append(np.array(fitting, np.int32))
        counts.append(len(fitting))
    if not sum(counts):
        whose = "" if among is None else "of a speaker of training "
        raise UserError(
            f"no clip {whose}in split {split!r} of {corpus.path} has a window of {num_frames} frames; "
            "lower data.num_frames, or give more data"
        )
    return WindowIndex(
        clips=np.repeat(np.arange(len(clips), dtype=np.int32), counts),
        starts=np.concatenate(starts),
        names=names,
        speakers=np.array(speakers, np.int32),
        lasts=np.array(lasts, np.int32),
    )


def _check_images(images: list[Any] | None, expected: int, place: str) -> None:
    found = len(images or [])
    if found < expected:
        raise UserError(
            f"{place} has {found} images of its speaker, expected {expected}; set --config.model.identity.kind=speakers"
        )
