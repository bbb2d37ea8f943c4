"""The `ha2g data` commands, for corpora: arguments only; each calls one function of the package."""

import argparse
import json
import pathlib
from typing import TYPE_CHECKING, Any

from ha2g_jax.cli.parser import (
    READING,
    add_reading,
    positive,
    print_verdict,
    read_seed,
    reading,
    refuse_others,
    stored_text,
)
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown
from ha2g_jax.skeleton import SKELETONS

if TYPE_CHECKING:
    from ha2g_jax.data.recording import Report

_SPLITS = ("train", "val", "test")
_MOTION = ("skeleton", "fps", "speaker", "audio", "words", "no_words", "license")
# Options of `data import` that have an effect, by the kind of the recordings.
_IMPORT = {
    "ted": ("split", "workers"),
    "bvh": (*_MOTION, "split", *READING),
    "smplx": (*_MOTION, "split", "model", "up", "source_fps", "unit"),
}


def add_commands(commands: Any) -> None:
    """Add `data` and its subcommands to the commands of a parser."""
    parser = commands.add_parser("data", help="import recordings; make, inspect, merge and divide corpora")
    parser.description = "Import recordings; make, inspect, merge and divide corpora. See docs/data.md."
    data = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for add in (_add_import, _add_build_video, _add_make_talk, _add_inspect, _add_merge, _add_split):
        add(data)


def _add_import(data: Any) -> None:
    command = data.add_parser("import", help="import TED-Expressive, TED-Gesture, or motion capture with sound")
    command.description = (
        "Make a corpus from the LMDB folders of TED-Expressive or TED-Gesture, from motion capture in BVH, or from "
        "SMPL-X or SMPL-H poses or joint positions (BEAT2, Embody 3D, Seamless Interaction). The files tell the kind; "
        "sound and transcript lie beside a motion file and have the same name."
    )
    command.add_argument(
        "src",
        type=pathlib.Path,
        metavar="SRC",
        help="an LMDB folder or a folder of them; a motion file or a folder",
    )
    _add_destination(command)
    command.add_argument("--kind", choices=tuple(_IMPORT), help="kind of recordings, if SRC has several")
    motion = command.add_argument_group("motion capture")
    motion.add_argument(
        "--skeleton", choices=SKELETONS, help="43 joints with fingers, or 10 without (default: ted_expressive)"
    )
    motion.add_argument(
        "--fps", type=positive, metavar="N", help="frames per second; training takes 15 to 30 (default: 15)"
    )
    motion.add_argument(
        "--speaker", type=stored_text, metavar="NAME", help="name of the speaker (default: by folders and files)"
    )
    motion.add_argument("--audio", type=pathlib.Path, metavar="FILE", help="sound, if SRC is one file")
    motion.add_argument("--words", type=pathlib.Path, metavar="FILE", help="transcript or FILE#SPEAKER, for one SRC")
    motion.add_argument("--no-words", action="store_true", help="allow recordings without a transcript")
    add_reading(motion)
    motion.add_argument(
        "--model", type=pathlib.Path, metavar="NPZ", help="an SMPL-X body model (default: a neutral template)"
    )
    motion.add_argument(
        "--up", choices=("auto", "y", "-y", "z", "-z", "x", "-x"), help="axis of SMPL-X files that points up"
    )
    _add_split_and_license(command)
    command.add_argument("--workers", type=positive, metavar="N", help="processes for TED (default: one per core)")
    command.add_argument("--json", action="store_true", help="print the report as JSON")
    command.set_defaults(run=_import)


def _import(arguments: argparse.Namespace) -> None:
    kind = arguments.kind or _kind_of(arguments.src)
    names = {"ted": "TED's LMDB", "bvh": "BVH and glTF", "smplx": "SMPL-X"}
    refuse_others(arguments, _IMPORT[kind], sum(_IMPORT.values(), ()), names[kind])
    given = {name: getattr(arguments, name) for name in _IMPORT[kind]}
    given = {name: value for name, value in given.items() if value is not None and value is not False}
    if kind == "ted":
        from ha2g_jax.importers.ted import importer

        report = importer.import_ted(arguments.src, arguments.dst, **given)
    else:
        from ha2g_jax.importers import mocap
        from ha2g_jax.importers.mocap import ImportOptions

        common = {name: given.pop(name) for name in (*_MOTION, "split") if name in given}
        options = ImportOptions(
            with_words=not common.pop("no_words", False), licence=common.pop("license", ""), **common
        )
        convert = mocap.import_bvh if kind == "bvh" else mocap.import_smplx
        report = convert(arguments.src, arguments.dst, options, **given)
    _print_report(report, arguments)


def _kind_of(src: pathlib.Path) -> str:
    from ha2g_jax.files.reading import files_below
    from ha2g_jax.motion.readers import bvh_motion, is_motion

    files = [src] if src.is_file() else files_below(src)
    suffixes = {path.suffix.lower() for path in files if path.suffix.lower() == ".mdb" or is_motion(path)}
    kinds = {"ted": (".mdb",), "bvh": bvh_motion.TREES, "smplx": (".npz", ".npy")}
    found = [kind for kind, of_kind in kinds.items() if suffixes & {*of_kind}]
    if not found:
        trees = ", ".join(bvh_motion.TREES)
        raise UserError(f"no data.mdb (TED), {trees}, .npz or .npy (SMPL-X) in {shown(src)}; give recordings")
    if len(found) > 1:
        raise UserError(f"{shown(src)} has several kinds of recordings; choose one with --kind {' or '.join(found)}")
    return found[0]


def _add_destination(command: argparse.ArgumentParser) -> None:
    command.add_argument("dst", type=pathlib.Path, metavar="DST", help="folder of the new corpus")


def _add_split_and_license(command: argparse.ArgumentParser) -> None:
    command.add_argument("--split", type=stored_text, help="name of the split of all clips (default: train)")
    command.add_argument("--license", type=stored_text, metavar="TEXT", help="licence of the data, kept in the corpus")


def _add_build_video(data: Any) -> None:
    command = data.add_parser("build-video", help="import videos of speakers: shots, 3-D body and hands, words")
    command.description = (
        "Import videos of speakers: find shots, estimate 3-D body and hands, read or recognise the words. The pose "
        "estimator, MediaPipe, is installed once in an environment of its own by --install."
    )
    command.add_argument(
        "paths", type=pathlib.Path, nargs="*", metavar="VIDEO", help="video files or folders, then DST, the new corpus"
    )
    command.add_argument("--install", action="store_true", help="install the pose estimator (400 MB) and end")
    command.add_argument(
        "--python", help="with --install: interpreter, Python 3.11 or 3.12 (default: the running one, or one on PATH)"
    )
    command.add_argument("--settings", type=pathlib.Path, metavar="JSON", help="file of settings (see docs/data.md)")
    command.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="one setting, such as min_seconds=5; repeatable",
    )
    command.add_argument("--recognise", metavar="MODEL", help="Whisper model for videos without a transcript")
    command.add_argument(
        "--pose-command", metavar="COMMAND", help="another pose estimator, which reads {video} and writes {out}"
    )
    command.add_argument(
        "--runner", choices=("local", "ray"), default="local", help="run on this machine or on Ray (default: local)"
    )
    command.add_argument("--address", help="address of the Ray cluster (default: RAY_ADDRESS, else a local or new one)")
    command.add_argument(
        "--workers",
        type=positive,
        metavar="N",
        help="number of videos processed at the same time (default: one per core)",
    )
    command.add_argument(
        "--overlay", type=pathlib.Path, metavar="DIR", help="folder for copies of the videos with the skeleton drawn"
    )
    _add_split_and_license(command)
    command.add_argument("--json", action="store_true", help="print the report as JSON")
    command.set_defaults(run=_build_video)


def _build_video(arguments: argparse.Namespace) -> None:
    videos_only = ("settings", "set", "recognise", "pose_command", "runner", "address", "workers", "overlay")
    if arguments.install:
        from ha2g_jax.importers.video import pose

        refuse_others(arguments, (), (*videos_only, "split", "license", "json"), "--install")
        if arguments.paths:
            raise UserError(f"--install takes no videos; import {shown(arguments.paths[0])} afterwards")
        print(pose.install(python=arguments.python))
        return
    if len(arguments.paths) < 2:
        raise UserError("give video files or folders, and then the folder of the new corpus; or --install")
    refuse_others(arguments, (), ("python",), "the import of videos; it belongs to --install")
    if arguments.runner == "local":
        refuse_others(arguments, (), ("address",), "--runner local")
    from ha2g_jax.importers.video import settings

    *videos, arguments.dst = arguments.paths
    options = {"recognise": arguments.recognise, "pose_command": arguments.pose_command}
    pairs = [*arguments.set, *(f"{name}={value}" for name, value in options.items() if value)]
    stored = settings.read_settings(arguments.settings) if arguments.settings else None
    chosen = settings.from_pairs(pairs, stored)  # an error in them is reported before the slow imports

    from ha2g_jax.data.corpus import Corpus
    from ha2g_jax.importers.video import build

    report = build.build_video(
        videos,
        arguments.dst,
        settings=chosen,
        runner=arguments.runner,
        workers=arguments.workers,
        address=arguments.address,
        split=arguments.split or "train",
        overlay=arguments.overlay,
        licence=arguments.license or "",
    )
    _print_report(report, arguments)
    if not arguments.json:
        counts = Corpus.open(arguments.dst).metadata["video"]
        print(f"both hands seen in {counts['frames_with_both_hands']} of {counts['frames']} frames")


def _print_report(report: "Report", arguments: argparse.Namespace) -> None:
    from ha2g_jax.data import recording

    if arguments.json:
        print(json.dumps(recording.report_as_json(report), indent=1))
    else:
        print(recording.report_as_table(report), arguments.dst, sep="\n")


def _add_make_talk(data: Any) -> None:
    command = data.add_parser("make-talk", help="make the Talk corpus: synthetic speech and gestures")
    command.description = "Make a Talk corpus: synthetic speech and gestures with known causes. See docs/talk.md."
    _add_destination(command)
    command.add_argument("--speakers", type=int, default=48, metavar="N", help="number of speakers (default: 48)")
    command.add_argument("--minutes", type=float, default=144, metavar="M", help="minutes of speech (default: 144)")
    command.add_argument(
        "--seed", type=read_seed, default=0, metavar="N", help="seed of all random choices (default: 0)"
    )
    command.add_argument("--workers", type=positive, metavar="N", help="number of processes (default: one per core)")
    command.add_argument("--fps", type=positive, default=15, metavar="N", help="frames per second (default: 15)")
    command.add_argument(
        "--synthesiser",
        choices=("espeak-ng", "flite", "both"),
        default="espeak-ng",
        help="program that speaks; flite is a library of the system, see docs/talk.md (default: espeak-ng)",
    )
    command.set_defaults(run=_make_talk)


def _make_talk(arguments: argparse.Namespace) -> None:
    from ha2g_jax.data.talk import build

    names = ("speakers", "minutes", "seed", "workers", "fps", "synthesiser")
    build.make_talk(arguments.dst, **{name: getattr(arguments, name) for name in names})
    print(arguments.dst)


def _add_inspect(data: Any) -> None:
    command = data.add_parser("inspect", help="print statistics of a corpus, check it, or write a page about it")
    command.description = (
        "Print hours, speakers, words, bone lengths and angles of a corpus; check every file and record of it; or "
        "write a page with statistics, the report of its import, clips to watch, and the causes of Talk's motion."
    )
    command.add_argument("corpus", type=pathlib.Path, metavar="CORPUS", help="folder of a corpus")
    command.add_argument("--check", action="store_true", help="check it; the exit code is 1 if an error is found")
    command.add_argument("-o", "--out", type=pathlib.Path, metavar="FILE", help="page to write, .html")
    command.add_argument("--samples", type=int, metavar="N", help="clips to watch in the page (default: 4)")
    command.add_argument(
        "--recording", type=pathlib.Path, metavar="MOTION", help="a real speaker to compare the motion with in the page"
    )
    add_reading(command)
    command.add_argument("--json", action="store_true", help="print JSON")
    command.set_defaults(run=_inspect)


def _inspect(arguments: argparse.Namespace) -> int:
    page = ("samples", "recording", "out", *READING)
    if arguments.check:
        from ha2g_jax.data.validation import examine

        refuse_others(arguments, (), page, "--check")
        return print_verdict(examine(arguments.corpus), arguments.corpus, arguments.json)
    if arguments.out is None:
        from ha2g_jax.evaluation.corpus_statistics import as_table, summarise

        refuse_others(arguments, (), page, "the printed numbers; name a page with --out")
        summary = summarise(arguments.corpus)
        print(json.dumps(summary, indent=1) if arguments.json else as_table(summary))
        return 0
    from ha2g_jax.evaluation.corpus_report import write_report

    refuse_others(arguments, (), ("json",), "a page")
    if arguments.recording is None:
        refuse_others(arguments, (), READING, "a page without --recording")
    samples = 4 if arguments.samples is None else arguments.samples
    options: dict[str, Any] = {"num_samples": samples, "recording": arguments.recording, **reading(arguments)}
    print(write_report(arguments.corpus, arguments.out, **options))
    return 0


def _add_merge(data: Any) -> None:
    command = data.add_parser("merge", help="merge several corpora of one skeleton and frame rate")
    command.description = "Merge several corpora of one skeleton and frame rate into a new one."
    command.add_argument("src", type=pathlib.Path, nargs="+", metavar="SRC", help="folders of the corpora to merge")
    _add_destination(command)
    command.add_argument(
        "--same-speakers", action="store_true", help="treat speakers, and recordings, of the same name as one"
    )
    command.set_defaults(run=_merge)


def _merge(arguments: argparse.Namespace) -> None:
    from ha2g_jax.data import regroup

    regroup.merge(arguments.src, arguments.dst, same_speakers=arguments.same_speakers)
    print(arguments.dst)


def _add_split(data: Any) -> None:
    command = data.add_parser("split", help="divide a corpus into training, validation and test splits")
    command.description = (
        "Divide the clips of a corpus into training, validation and test splits. A recording is never divided."
    )
    command.add_argument("src", type=pathlib.Path, metavar="SRC", help="folder of the corpus to divide")
    _add_destination(command)
    command.add_argument(
        "--by",
        choices=("recording", "speaker"),
        default="recording",
        help="unit that is in only one split (default: recording)",
    )
    command.add_argument(
        "--fractions",
        nargs=3,
        type=float,
        default=(0.8, 0.1, 0.1),
        metavar=("TRAIN", "VAL", "TEST"),
        help="fractions of the duration; 0 leaves a split out (default: 0.8 0.1 0.1)",
    )
    command.add_argument("--seed", type=read_seed, default=0, metavar="N", help="seed of the random order (default: 0)")
    command.set_defaults(run=_split)


def _split(arguments: argparse.Namespace) -> None:
    from ha2g_jax.data import regroup

    fractions: dict[str, float] = dict(zip(_SPLITS, arguments.fractions, strict=True))
    regroup.divide(arguments.src, arguments.dst, by=arguments.by, fractions=fractions, seed=arguments.seed)
    print(arguments.dst)
