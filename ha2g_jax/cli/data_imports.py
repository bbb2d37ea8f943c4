"""The `ha2g data` commands that import data sets, motion capture and videos; arguments only."""

import argparse
import json
import pathlib
from typing import TYPE_CHECKING, Any

from ha2g_jax.cli.values import positive, text

if TYPE_CHECKING:
    from ha2g_jax.data.import_report import Report
    from ha2g_jax.importers.mocap.options import ImportOptions

_SKELETONS = ("ted_expressive", "ted_gesture")


def add_commands(data: Any) -> None:
    """Add the commands that import data to the subcommands of `ha2g data`."""
    for add in (_add_import_ted, _add_import_bvh, _add_import_smplx, _add_build_video, _add_install_pose):
        add(data)


def _add_import_ted(data: Any) -> None:
    command = data.add_parser("import-ted", help="import TED-Expressive or TED-Gesture")
    command.description = "Import TED-Expressive or TED-Gesture from the published LMDB folders."
    command.add_argument(
        "src", type=pathlib.Path, metavar="SRC", help="folder with train, val, test or lmdb_..., or one LMDB folder"
    )
    _add_destination(command)
    command.add_argument(
        "--split", type=text, default="train", help="name of the split if SRC is one LMDB folder (default: train)"
    )
    command.add_argument("--workers", type=positive, metavar="N", help="number of processes (default: one per core)")
    _add_json(command)
    command.set_defaults(run=_import_ted)


def _import_ted(arguments: argparse.Namespace) -> None:
    from ha2g_jax.importers.ted import importer

    report = importer.import_ted(arguments.src, arguments.dst, split=arguments.split, workers=arguments.workers)
    _print_report(report, arguments)


def _add_import_bvh(data: Any) -> None:
    command = data.add_parser("import-bvh", help="import motion capture in BVH, with audio and words")
    command.description = (
        "Import motion capture in BVH. Audio and transcript of a file lie beside it with the same name."
    )
    _add_motion_arguments(command, "a .bvh file, or a folder of .bvh files")
    command.add_argument(
        "--joint-map",
        default="auto",
        metavar="MAP",
        help="auto, mixamo, zeroeggs, beat, genea, ha2g, or a YAML file (default: auto)",
    )
    command.add_argument(
        "--unit", default="auto", metavar="METRES", help="metres in one unit of the file (default: by the arms' length)"
    )
    command.set_defaults(run=_import_bvh)


def _import_bvh(arguments: argparse.Namespace) -> None:
    from ha2g_jax.importers.mocap import import_bvh

    report = import_bvh.import_bvh(
        arguments.src, arguments.dst, _options(arguments), joint_map=arguments.joint_map, unit=arguments.unit
    )
    _print_report(report, arguments)


def _add_import_smplx(data: Any) -> None:
    command = data.add_parser("import-smplx", help="import SMPL-X poses or joint positions, with audio and words")
    command.description = (
        "Import SMPL-X or SMPL-H poses (BEAT2, Embody 3D, Seamless Interaction) or joint positions. "
        "Audio and transcript of a file lie beside it with the same name."
    )
    _add_motion_arguments(command, "a .npz file, a .npy file of joint positions, or a folder of .npz files")
    command.add_argument(
        "--model", type=pathlib.Path, metavar="NPZ", help="an SMPL-X body model (default: a neutral template)"
    )
    command.add_argument(
        "--up",
        choices=("auto", "y", "-y", "z", "-z", "x", "-x"),
        default="auto",
        help="axis of the files that points up (default: auto)",
    )
    command.add_argument(
        "--source-fps", type=float, metavar="FPS", help="frames per second of the files (default: as stored in them)"
    )
    command.set_defaults(run=_import_smplx)


def _import_smplx(arguments: argparse.Namespace) -> None:
    from ha2g_jax.importers.mocap import import_smplx

    report = import_smplx.import_smplx(
        arguments.src,
        arguments.dst,
        _options(arguments),
        model=arguments.model,
        up=arguments.up,
        source_fps=arguments.source_fps,
    )
    _print_report(report, arguments)


def _add_motion_arguments(command: argparse.ArgumentParser, src: str) -> None:
    command.add_argument("src", type=pathlib.Path, metavar="SRC", help=src)
    _add_destination(command)
    command.add_argument(
        "--skeleton",
        choices=_SKELETONS,
        default=_SKELETONS[0],
        help="43 joints with fingers, or 10 joints without (default: ted_expressive)",
    )
    command.add_argument(
        "--fps", type=positive, default=15, metavar="N", help="frames per second of the corpus (default: 15)"
    )
    command.add_argument(
        "--speaker", type=text, metavar="NAME", help="name of the speaker (default: by names of folders and files)"
    )
    command.add_argument("--audio", type=pathlib.Path, metavar="FILE", help="audio file, if SRC is one file")
    command.add_argument("--words", type=pathlib.Path, metavar="FILE", help="transcript, if SRC is one file")
    command.add_argument("--no-words", action="store_true", help="allow recordings without a transcript")
    _add_split_and_licence(command)
    _add_json(command)


def _options(arguments: argparse.Namespace) -> "ImportOptions":
    from ha2g_jax.importers.mocap.options import ImportOptions

    return ImportOptions(
        skeleton=arguments.skeleton,
        fps=arguments.fps,
        speaker=arguments.speaker,
        audio=arguments.audio,
        words=arguments.words,
        with_words=not arguments.no_words,
        split=arguments.split,
        licence=arguments.licence,
    )


def _add_destination(command: argparse.ArgumentParser) -> None:
    command.add_argument("dst", type=pathlib.Path, metavar="DST", help="folder of the new corpus")


def _add_split_and_licence(command: argparse.ArgumentParser) -> None:
    command.add_argument("--split", type=text, default="train", help="name of the split of all clips (default: train)")
    command.add_argument(
        "--license",
        dest="licence",
        type=text,
        default="",
        metavar="TEXT",
        help="licence of the data, kept in the corpus",
    )


def _add_json(command: argparse.ArgumentParser) -> None:
    command.add_argument("--json", action="store_true", help="print the report as JSON")


def _add_build_video(data: Any) -> None:
    command = data.add_parser("build-video", help="import videos of speakers: shots, 3-D body and hands, words")
    command.description = (
        "Import videos of speakers: find shots, estimate 3-D body and hands, read or recognise the words. "
        "Run `pip install 'ha2g-jax[video]'` and `ha2g data install-pose` once before."
    )
    command.add_argument(
        "videos", type=pathlib.Path, nargs="+", metavar="VIDEO", help="video files, or folders of them"
    )
    _add_destination(command)
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
        "--workers", type=positive, metavar="N", help="number of videos at the same time (default: one per core)"
    )
    command.add_argument(
        "--overlay", type=pathlib.Path, metavar="DIR", help="folder for copies of the videos with the skeleton drawn"
    )
    _add_split_and_licence(command)
    _add_json(command)
    command.set_defaults(run=_build_video)


def _build_video(arguments: argparse.Namespace) -> None:
    from ha2g_jax.importers.video import settings

    options = {"recognise": arguments.recognise, "pose_command": arguments.pose_command}
    pairs = [*arguments.set, *(f"{name}={value}" for name, value in options.items() if value)]
    stored = settings.read_settings(arguments.settings) if arguments.settings else None
    chosen = settings.from_pairs(pairs, stored)  # an error in them is reported before the slow imports

    from ha2g_jax.data.corpus import Corpus
    from ha2g_jax.importers.video import build

    report = build.build_video(
        arguments.videos,
        arguments.dst,
        settings=chosen,
        runner=arguments.runner,
        workers=arguments.workers,
        address=arguments.address,
        split=arguments.split,
        overlay=arguments.overlay,
        licence=arguments.licence,
    )
    _print_report(report, arguments)
    if not arguments.json:
        counts = Corpus.open(arguments.dst).metadata["video"]
        print(f"both hands seen in {counts['frames_with_both_hands']} of {counts['frames']} frames")


def _add_install_pose(data: Any) -> None:
    command = data.add_parser("install-pose", help="install the pose estimator of build-video (400 MB)")
    command.description = "Install MediaPipe, the pose estimator of build-video, in a separate environment (400 MB)."
    command.add_argument("--python", help="interpreter, Python 3.11 or 3.12 (default: the running one, or one on PATH)")
    command.set_defaults(run=_install_pose)


def _install_pose(arguments: argparse.Namespace) -> None:
    from ha2g_jax.importers.video import pose_environment

    print(pose_environment.install(python=arguments.python))


def _print_report(report: "Report", arguments: argparse.Namespace) -> None:
    from ha2g_jax.data import import_report

    if arguments.json:
        print(json.dumps(import_report.as_json(report), indent=1))
    else:
        print(import_report.as_table(report), arguments.dst, sep="\n")
