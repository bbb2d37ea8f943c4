"""Parallel import of videos into one corpus; an interrupted build can be continued."""

import collections
import contextlib
import hashlib
import json
import os
import pathlib
import shutil
import sys
from collections.abc import Sequence
from typing import Any, NamedTuple

import msgpack
import tqdm

from ha2g_jax.data.corpus import TRAIN
from ha2g_jax.data.corpus_writer import CorpusWriter
from ha2g_jax.data.recording import Report, SplitReport, report_as_json
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import check_regular, file_sha256, files_below, reading, shown
from ha2g_jax.files.writing import check_kept, check_new, whole_file
from ha2g_jax.importers.video import extraction, pose, runners
from ha2g_jax.importers.video.extraction import Extraction, VideoRecording
from ha2g_jax.importers.video.settings import VideoSettings
from ha2g_jax.progress import counted, progress_bar

RUNNERS = ("local", "ray")
_COUNTS = ("frames", "frames_with_both_hands", "seconds", "shots")
_NAMED = 5  # maximum number of failed videos that the last message names

SUFFIXES = (".mp4", ".mov", ".mkv", ".webm", ".avi", ".m4v")

_SUFFIX = ".clips"


class _Job(NamedTuple):
    """Task of a worker; `done` are the keys of videos that need not be read again."""

    recording: VideoRecording
    settings: VideoSettings
    overlay: pathlib.Path | None
    done: frozenset[str]


class _Outcome(NamedTuple):
    """Keys of the videos that succeeded, and reasons of those that failed, by name of the recording."""

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
    """Make a corpus from videos of speakers; equal videos and settings give equal bytes, whatever the runner.

    A video that fails is reported on standard error and in `dataset.json`, and the others are still read. Results are
    kept in the folder `.NAME-work` beside the corpus until all videos have succeeded, so that another call reads only
    the missing ones.

    Args:
        videos: paths of files, and of folders to search; subfolders name speakers (see `extraction.VideoRecording`).
        runner: "local" for processes on this machine, "ray" for a Ray cluster at `address`, whose nodes must find the
            videos under the same paths.
        workers: number of videos that are read at the same time; one per core by default.
        overlay: folder for copies of the videos with the skeleton drawn on the speaker; None for no copies.

    Raises:
        UserError: `dst` exists, no video is found, an overlay would overwrite one, PySceneDetect or the pose estimator
            is not installed, all videos fail, or no clip is left.
    """
    dst, settings = pathlib.Path(dst).absolute(), settings or VideoSettings()
    overlay = pathlib.Path(overlay).absolute() if overlay is not None else None
    check_new(dst)
    if runner not in RUNNERS:
        raise UserError(f"unknown runner {runner!r}; expected one of {', '.join(RUNNERS)}")
    root, recordings = find_recordings(videos, without=overlay)
    if overlay is not None:
        overlays = [overlay / f"{recording.name}.mp4" for recording in recordings]
        check_kept(overlays, [recording.video for recording in recordings], what="overlay", option="--overlay")
    if runner == "local":  # the nodes of a cluster have environments of their own
        extraction.scene_detector()
        if settings.pose_command is None:
            pose.holistic_command()
    metadata = {"name": shown(root.name), "source": "ha2g data build-video", "licence": licence}
    writer = CorpusWriter(dst, splits=[split], skeleton=extraction.SKELETON, fps=settings.fps, metadata=metadata)
    work = dst.with_name(f".{dst.name}-work")
    done = frozenset(path.stem for path in work.glob(f"[0-9a-f]*{_SUFFIX}"))
    jobs = [_Job(recording, settings, overlay, done) for recording in recordings]
    results = runners.local(_do, jobs, workers) if runner == "local" else runners.ray(_do, jobs, workers, address)
    with contextlib.closing(results):
        outcome = _collect(results, len(jobs), work)
    if not outcome.keys:
        name, reason = min(outcome.failures.items())
        only = _named(name, reason)
        raise UserError(only if len(recordings) == 1 else f"all {len(recordings)} videos failed; the first: {only}")

    names = [recording.name for recording in recordings]
    keys = [outcome.keys[name] for name in names if name in outcome.keys]
    with writer:
        report, counts = _write(writer, split, keys, work)
        if not report.kept:
            if not outcome.failures:  # another call could not use the results
                shutil.rmtree(work)
            raise _no_clip(report, len(keys))
        writer.metadata["import"] = report_as_json({split: report})
        writer.metadata["video"] = {**counts, "settings": _published(settings)}
        writer.metadata["failed"] = [
            {"video": name, "reason": outcome.failures[name]} for name in names if name in outcome.failures
        ]
    if outcome.failures:
        _say(_summary(sorted(outcome.failures), len(recordings), dst, work))
    else:
        shutil.rmtree(work)
    return {split: report}


def _do(job: _Job) -> tuple[str, Extraction | None]:
    """Return the key of a video, and its clips unless they exist already; runs in a worker."""
    recording, key = job.recording, _key_of(job.recording, job.settings)
    path = job.overlay / f"{recording.name}.mp4" if job.overlay else None
    if key in job.done and (path is None or path.exists()):
        return key, None
    return key, extraction.extract(recording, job.settings, overlay_path=path)


def _collect(results: Any, num_videos: int, work: pathlib.Path) -> _Outcome:
    outcome, clips = _Outcome({}, {}), 0
    with progress_bar("importing videos", num_videos, "video") as bar:
        for job, result in results:
            if isinstance(result, Exception):
                reason = _reason(result, job.recording)
                outcome.failures[job.recording.name] = reason
                if num_videos > 1:
                    _say(f"failed: {_named(job.recording.name, reason)}")
            else:
                key, extracted = result
                if extracted is not None:
                    _save(work, key, extracted)
                    clips += len(extracted.records)
                outcome.keys[job.recording.name] = key
            bar.update()
            bar.set_postfix_str(f"{counted(clips, 'clip')}, {len(outcome.failures)} failed, last {job.recording.name}")
    return outcome


def _write(
    writer: CorpusWriter, split: str, keys: Sequence[str], work: pathlib.Path
) -> tuple[SplitReport, dict[str, float]]:
    report = SplitReport()
    counts: dict[str, float] = dict.fromkeys(_COUNTS, 0)
    for key in keys:
        extracted = _load(work, key)
        for record in extracted.records:
            writer.add(split, record)
        report += extracted.report
        counts = {name: round(counts[name] + getattr(extracted, name), 3) for name in _COUNTS}
    return report, counts


def _no_clip(report: SplitReport, num_videos: int) -> UserError:
    reasons = [f"{counted(count, 'shot or clip')}: {reason}" for reason, count in report.rejected.items()]
    reasons += [f"{counted(count, 'window')}: {reason}" for reason, count in report.filtered.items()]
    return UserError(
        f"no clip is left of {counted(num_videos, 'video')} ({', '.join(reasons)}); look at the --overlay, or "
        "change the settings"
    )


def _published(settings: VideoSettings) -> dict[str, Any]:
    """Return the settings to store in the corpus, without the pose command, which depends on the machine."""
    return settings.as_json() | {"pose_command": "one of the user's own" if settings.pose_command else None}


def _reason(error: Exception, recording: VideoRecording) -> str:
    """Return the reason why a video failed in one line without paths of this machine."""
    video = recording.video
    file = recording.name.removesuffix(video.suffix) + video.suffix
    text = " ".join(str(error).split())
    return text.replace(str(video), file).replace(f"{video.parent}{os.sep}", "")


def _named(name: str, reason: str) -> str:
    return reason if reason.startswith(name) else f"{name}: {reason}"


def _summary(failed: Sequence[str], num_videos: int, dst: pathlib.Path, work: pathlib.Path) -> str:
    names = ", ".join(failed[:_NAMED]) + (" ..." if len(failed) > _NAMED else "")
    return (
        f"{len(failed)} of {counted(num_videos, 'video')} failed ({names}) and are not in {dst}; to add them, "
        f"correct them, remove {dst} and run again: {work} keeps the results of the others"
    )


def _say(text: str) -> None:
    tqdm.tqdm.write(f"ha2g: {text}", file=sys.stderr)


def find_recordings(
    videos: Sequence[str | os.PathLike], without: pathlib.Path | None = None
) -> tuple[pathlib.Path, list[VideoRecording]]:
    """Return the common folder of files of any suffix and of folders, and their videos, sorted by name.

    Folders are searched for videos at any depth, without hidden files and without the folder `without`.
    """
    # Links are not resolved, so that a video is named by the path where it was found.
    given = [pathlib.Path(os.path.abspath(path)) for path in videos]  # noqa: PTH100
    for path in given:
        with reading(path, "a video or a folder of videos"):
            if not path.exists():
                raise UserError(f"no file or folder at {shown(path)}; give videos, or folders of videos")
        if not path.is_dir():
            check_regular(path, "a video")
    found = {file for path in given for file in (_inside(path, without) if path.is_dir() else [path])}
    if not found:
        raise UserError(f"no video in {', '.join(map(shown, given))}; expected files ending in {', '.join(SUFFIXES)}")
    root = pathlib.Path(os.path.commonpath([path if path.is_dir() else path.parent for path in given]))
    names = collections.Counter(_name(file, root) for file in found)
    recordings, in_folder = dict[str, VideoRecording](), collections.Counter(file.parent for file in found)
    for file in found:
        name = _name(file, root)
        name = name if names[name] == 1 else shown(file.relative_to(root).as_posix())
        if name in recordings:
            raise UserError(f"two videos would both be called {name}; rename one")
        folder, slash, _ = name.partition("/")
        is_alone = in_folder[file.parent] == 1 and not _others(file)
        recordings[name] = VideoRecording(file, name, folder if slash else name, is_alone)
    return root, [recordings[name] for name in sorted(recordings)]


def _others(video: pathlib.Path) -> set[pathlib.Path]:
    """Return the other videos in the folder of a video, whether they are read or not."""
    beside = (file for file in video.parent.iterdir() if not file.name.startswith("."))
    return {file for file in beside if file.suffix.lower() in SUFFIXES} - {video}


def _inside(folder: pathlib.Path, without: pathlib.Path | None) -> list[pathlib.Path]:
    return [
        file
        for file in files_below(folder)
        if file.suffix.lower() in SUFFIXES
        and file.is_file()
        and not any(part.startswith(".") for part in file.relative_to(folder).parts)
        and (without is None or without not in file.parents)
    ]


def _name(file: pathlib.Path, root: pathlib.Path) -> str:
    return shown(file.relative_to(root).with_suffix("").as_posix())


def _key_of(recording: VideoRecording, settings: VideoSettings) -> str:
    """Return the key of the clips of a video: a hash of contents, names, settings and version."""
    transcript = recording.transcript
    facts = {
        "version": extraction.VERSION,
        "talk": recording.name,
        "speaker": recording.speaker,
        "settings": settings.as_json(),
        "video": _digest(recording.video),
        "transcript": [shown(transcript.name), _digest(transcript)] if transcript else None,
    }
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()


def _save(folder: pathlib.Path, key: str, extracted: Extraction) -> None:
    content = extracted._asdict() | {"report": extracted.report.as_json()}
    with whole_file(folder / f"{key}{_SUFFIX}") as path:
        path.write_bytes(msgpack.packb(content) or b"")


def _load(folder: pathlib.Path, key: str) -> Extraction:
    content = msgpack.unpackb((folder / f"{key}{_SUFFIX}").read_bytes())
    content["report"] = SplitReport.from_json(content["report"])
    return Extraction(**content)


def _digest(path: pathlib.Path) -> str:
    with reading(path, "a video with its transcript"):
        return file_sha256(path)
