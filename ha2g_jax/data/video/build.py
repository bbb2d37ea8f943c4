"""Many videos become one corpus, in parallel; a build that was stopped goes on where it was."""

import contextlib
import os
import pathlib
import shutil
import sys
from collections.abc import Sequence
from typing import Any, NamedTuple

import tqdm

from ha2g_jax.data import import_report
from ha2g_jax.data.corpus import TRAIN
from ha2g_jax.data.corpus_writer import CorpusWriter
from ha2g_jax.data.import_report import Report, SplitReport
from ha2g_jax.data.video import extraction, runners, work_folder
from ha2g_jax.data.video.extraction import Extraction
from ha2g_jax.data.video.settings import VideoSettings
from ha2g_jax.data.video.talks import Talk, find_talks
from ha2g_jax.errors import UserError

RUNNERS = ("local", "ray")

_COUNTS = ("frames", "frames_with_both_hands", "seconds", "shots")
_NAMED = 5  # failed videos, at most, that the last message names


class _Job(NamedTuple):
    """What a worker is told; `done` are the keys of what need not be made again."""

    talk: Talk
    settings: VideoSettings
    overlay: pathlib.Path | None
    done: frozenset[str]


class _Outcome(NamedTuple):
    """Keys of what the videos gave, and reasons of those that failed, by name of the talk."""

    keys: dict[str, str]
    failures: dict[str, str]


def build_video(
    videos: Sequence[str | os.PathLike],
    dst: str | os.PathLike,
    *,
    settings: VideoSettings | None = None,
    runner: str = "local",
    workers: int | None = None,
    address: str | None = None,
    split: str = TRAIN,
    overlay: str | os.PathLike | None = None,
    licence: str = "",
) -> Report:
    """Makes a corpus from videos of speakers; equal videos and settings give equal bytes, whatever the runner.

    A video that fails is named on stderr and in `dataset.json`, and the rest goes on. What the videos gave is kept in
    the folder `.NAME-work` beside the corpus until all have succeeded, so that another call does only what is missing.

    Args:
        videos: files, and folders to search; sub-folders are taken for speakers (see `talks.Talk`).
        dst: folder to make.
        settings: every threshold and choice; the defaults where None.
        runner: "local" for processes here, "ray" for a Ray cluster, whose nodes find the videos under the same paths.
        workers: videos at the same time; one a core by default.
        address: of the Ray cluster.
        split: the split that all clips go to.
        overlay: folder for copies of the videos with the skeleton drawn on the speaker; none where None.
        licence: of the videos.

    Returns:
        The counts of the split.

    Raises:
        UserError: `dst` exists, no video is found, all fail, or no clip is left.
    """
    dst, settings = pathlib.Path(dst).absolute(), settings or VideoSettings()
    overlay = pathlib.Path(overlay).absolute() if overlay is not None else None
    if dst.exists():
        raise UserError(f"{dst} exists already; choose another folder or remove it")
    if runner not in RUNNERS:
        raise UserError(f"unknown runner {runner!r}; expected one of {', '.join(RUNNERS)}")
    root, talks = find_talks(videos, without=overlay)
    work = dst.with_name(f".{dst.name}-work")
    jobs = [_Job(talk, settings, overlay, work_folder.keys_in(work)) for talk in talks]
    results = runners.local(_do, jobs, workers) if runner == "local" else runners.ray(_do, jobs, workers, address)
    with contextlib.closing(results):
        outcome = _collect(results, len(jobs), work)
    if not outcome.keys:
        name, reason = min(outcome.failures.items())
        only = _named(name, reason)
        raise UserError(only if len(talks) == 1 else f"all {len(talks)} videos failed; the first: {only}")

    keys = [outcome.keys[talk.name] for talk in talks if talk.name in outcome.keys]
    metadata = {"name": root.name, "source": "ha2g data build-video", "licence": licence}
    with CorpusWriter(dst, splits=[split], skeleton=extraction.SKELETON, fps=settings.fps, metadata=metadata) as writer:
        report, counts = _write(writer, split, keys, work)
        if not report.kept:
            if not outcome.failures:  # nothing that another call could use
                shutil.rmtree(work)
            raise _no_clip(report, len(keys))
        writer.metadata["import"] = import_report.as_json({split: report})
        writer.metadata["video"] = {**counts, "settings": _published(settings)}
        writer.metadata["failed"] = [
            {"video": talk.name, "reason": outcome.failures[talk.name]}
            for talk in talks
            if talk.name in outcome.failures
        ]
    if outcome.failures:
        _say(_summary(sorted(outcome.failures), len(talks), dst, work))
    else:
        shutil.rmtree(work)
    return {split: report}


def _do(job: _Job) -> tuple[str, Extraction | None]:
    """One video, in a worker: its key, and what it gives unless that is there already."""
    talk, key = job.talk, work_folder.key_of(job.talk, job.settings)
    path = job.overlay / f"{talk.name}.mp4" if job.overlay else None
    if key in job.done and (path is None or path.exists()):
        return key, None
    return key, extraction.extract(talk.video, job.settings, talk=talk.name, speaker=talk.speaker, overlay_path=path)


def _collect(results: Any, num_videos: int, work: pathlib.Path) -> _Outcome:
    """Keeps what the videos give, as they finish."""
    outcome, clips = _Outcome({}, {}), 0
    with tqdm.tqdm(desc="Videos", total=num_videos, unit="video", disable=None, leave=False) as bar:
        for job, result in results:
            if isinstance(result, Exception):
                reason = _reason(result, job.talk)
                outcome.failures[job.talk.name] = reason
                if num_videos > 1:
                    _say(f"failed: {_named(job.talk.name, reason)}")
            else:
                key, extracted = result
                if extracted is not None:
                    work_folder.save(work, key, extracted)
                    clips += len(extracted.records)
                outcome.keys[job.talk.name] = key
            bar.update()
            bar.set_postfix_str(f"{clips} clips, {len(outcome.failures)} failed, last {job.talk.name}")
    return outcome


def _write(
    writer: CorpusWriter, split: str, keys: Sequence[str], work: pathlib.Path
) -> tuple[SplitReport, dict[str, float]]:
    """Writes the clips in the order of the keys, and adds up what was counted."""
    report = SplitReport()
    counts: dict[str, float] = dict.fromkeys(_COUNTS, 0)
    for key in keys:
        extracted = work_folder.load(work, key)
        for record in extracted.records:
            writer.add(split, record)
        report += extracted.report
        counts = {name: round(counts[name] + getattr(extracted, name), 3) for name in _COUNTS}
    return report, counts


def _no_clip(report: SplitReport, num_videos: int) -> UserError:
    reasons = [f"{count} shots or clips: {reason}" for reason, count in report.rejected.items()]
    reasons += [f"{count} windows: {reason}" for reason, count in report.filtered.items()]
    return UserError(
        f"no clip is left of {num_videos} videos ({', '.join(reasons)}); watch the overlay, or change the settings"
    )


def _published(settings: VideoSettings) -> dict[str, Any]:
    """The settings as the corpus names them; a command is of one machine."""
    return settings.as_json() | {"pose_command": "one of the user's own" if settings.pose_command else None}


def _reason(error: Exception, talk: Talk) -> str:
    """Why a video failed, in one line that is the same on every machine."""
    file = talk.name.removesuffix(talk.video.suffix) + talk.video.suffix
    text = " ".join(str(error).split())
    return text.replace(str(talk.video), file).replace(f"{talk.video.parent}{os.sep}", "")


def _named(name: str, reason: str) -> str:
    return reason if reason.startswith(name) else f"{name}: {reason}"


def _summary(failed: Sequence[str], num_videos: int, dst: pathlib.Path, work: pathlib.Path) -> str:
    names = ", ".join(failed[:_NAMED]) + (" ..." if len(failed) > _NAMED else "")
    return (
        f"{len(failed)} of {num_videos} videos failed ({names}) and are not in {dst}; to add them, mend them, remove "
        f"{dst} and run again: {work} keeps what the others gave"
    )


def _say(text: str) -> None:
    tqdm.tqdm.write(f"ha2g: {text}", file=sys.stderr)
