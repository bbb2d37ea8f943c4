"""The `ha2g data` commands: arguments only; each command calls one function of the package."""

import argparse
import json
import pathlib
from typing import Any

_SKELETONS = ("ted_expressive", "ted_gesture")


def add_commands(commands: Any) -> None:
    """Adds `data` and what is below it to the commands of a parser."""
    parser = commands.add_parser("data", help="import, make, look at and divide data")
    data = parser.add_subparsers(required=True, metavar="COMMAND")
    for add in (
        _add_import_ted,
        _add_import_bvh,
        _add_import_smplx,
        _add_build_video,
        _add_install_pose,
        _add_make_talk,
        _add_inspect_talk,
        _add_stats,
        _add_inspect,
        _add_validate,
        _add_merge,
        _add_split,
    ):
        add(data)


def _add_import_ted(data: Any) -> None:
    command = data.add_parser("import-ted", help="TED-Expressive or TED-Gesture, from their LMDB folders")
    command.add_argument("src", type=pathlib.Path, help="folder of train, val, test or lmdb_..., or one LMDB folder")
    command.add_argument("dst", type=pathlib.Path, help="corpus to make")
    command.add_argument("--split", default="train", help="name of the split, where SRC is one LMDB folder")
    command.add_argument("--workers", type=_positive, help="processes (default: one a core)")
    command.add_argument("--json", action="store_true", help="print the report as JSON")
    command.set_defaults(run=_import_ted)


def _import_ted(arguments: argparse.Namespace) -> None:
    from ha2g_jax.data.ted import importer

    report = importer.import_ted(arguments.src, arguments.dst, split=arguments.split, workers=arguments.workers)
    _print_report(report, arguments)


def _add_import_bvh(data: Any) -> None:
    command = data.add_parser("import-bvh", help="motion capture in BVH, with its audio and words")
    _add_motion_arguments(command, "a .bvh, or a folder of them; audio and transcript lie beside each, with its name")
    command.add_argument(
        "--joint-map", default="auto", help="auto, mixamo, zeroeggs, beat, ha2g, or a YAML file (docs/data.md)"
    )
    command.add_argument("--unit", default="auto", help="metres in one unit of the file (default: by the arms' length)")
    command.set_defaults(run=_import_bvh)


def _import_bvh(arguments: argparse.Namespace) -> None:
    from ha2g_jax.data.mocap import import_bvh

    report = import_bvh.import_bvh(
        arguments.src,
        arguments.dst,
        joint_map=arguments.joint_map,
        unit=arguments.unit,
        **_motion_arguments(arguments),
    )
    _print_report(report, arguments)


def _add_import_smplx(data: Any) -> None:
    command = data.add_parser("import-smplx", help="SMPL-X poses or joint positions (.npz), with audio and words")
    _add_motion_arguments(command, "a .npz of poses (BEAT2) or joint positions, a .npy, or a folder of .npz")
    command.add_argument("--model", type=pathlib.Path, help="your SMPLX_NEUTRAL.npz (default: a template of our own)")
    command.add_argument("--up", choices=("auto", "y", "-y", "z", "-z"), default="auto", help="which axis points up")
    command.add_argument("--source-fps", type=float, help="frames per second of the files (default: what they say)")
    command.set_defaults(run=_import_smplx)


def _import_smplx(arguments: argparse.Namespace) -> None:
    from ha2g_jax.data.mocap import import_smplx

    report = import_smplx.import_smplx(
        arguments.src,
        arguments.dst,
        model=arguments.model,
        up=arguments.up,
        source_fps=arguments.source_fps,
        **_motion_arguments(arguments),
    )
    _print_report(report, arguments)


def _add_motion_arguments(command: argparse.ArgumentParser, src: str) -> None:
    command.add_argument("src", type=pathlib.Path, help=src)
    command.add_argument("dst", type=pathlib.Path, help="corpus to make")
    command.add_argument("--skeleton", choices=_SKELETONS, default=_SKELETONS[0], help="with fingers or without")
    command.add_argument("--speaker", help="name of the speaker (default: the folder's, or the file's)")
    command.add_argument("--audio", type=pathlib.Path, help="the sound of one file, where it has another name")
    command.add_argument("--words", type=pathlib.Path, help="the transcript of one file, where it has another name")
    command.add_argument("--no-words", action="store_true", help="take recordings without a transcript")
    _add_corpus_arguments(command)


def _motion_arguments(arguments: argparse.Namespace) -> dict[str, Any]:
    return {
        "skeleton": arguments.skeleton,
        "speaker": arguments.speaker,
        "audio": arguments.audio,
        "words": arguments.words,
        "with_words": not arguments.no_words,
        "split": arguments.split,
        "licence": arguments.licence,
    }


def _add_corpus_arguments(command: argparse.ArgumentParser) -> None:
    command.add_argument("--split", default="train", help="name of the split to make (ha2g data split divides it)")
    command.add_argument("--licence", default="", help="of the data, noted in the corpus")
    command.add_argument("--json", action="store_true", help="print the report as JSON")


def _add_build_video(data: Any) -> None:
    command = data.add_parser("build-video", help="videos of speakers: shots, 3-D body and hands, words")
    command.add_argument("videos", type=pathlib.Path, nargs="+", help="video files, or folders of them")
    command.add_argument("dst", type=pathlib.Path, help="corpus to make")
    command.add_argument("--settings", type=pathlib.Path, metavar="JSON", help="a file of settings (docs/data.md)")
    command.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="one of them: min_seconds=5")
    command.add_argument(
        "--recognise", metavar="MODEL", help="Whisper model for videos without a transcript (docs/data.md)"
    )
    command.add_argument("--pose-command", metavar="COMMAND", help="another estimator: reads {video}, writes {out}")
    command.add_argument("--runner", choices=("local", "ray"), default="local", help="ray: nodes share the paths")
    command.add_argument("--address", help="of the Ray cluster (default: the one in RAY_ADDRESS, or a new one)")
    command.add_argument("--workers", type=_positive, help="videos at a time (default: one a core)")
    command.add_argument("--overlay", type=pathlib.Path, help="folder for the videos with the skeleton drawn on them")
    _add_corpus_arguments(command)
    command.set_defaults(run=_build_video)


def _build_video(arguments: argparse.Namespace) -> None:
    from ha2g_jax.data.corpus import Corpus
    from ha2g_jax.data.video import build, settings

    chosen = {"recognise": arguments.recognise, "pose_command": arguments.pose_command}
    pairs = [*arguments.set, *(f"{name}={value}" for name, value in chosen.items() if value)]
    report = build.build_video(
        arguments.videos,
        arguments.dst,
        settings=settings.from_pairs(pairs, settings.read_settings(arguments.settings) if arguments.settings else None),
        runner=arguments.runner,
        workers=arguments.workers,
        address=arguments.address,
        split=arguments.split,
        overlay=arguments.overlay,
        licence=arguments.licence,
    )
    _print_report(report, arguments)
    if not arguments.json:
        seen = Corpus.open(arguments.dst).metadata["video"]
        print(f"both hands seen in {seen['frames_with_both_hands']} of {seen['frames']} frames")


def _add_install_pose(data: Any) -> None:
    command = data.add_parser(
        "install-pose", help="the pose estimator of build-video, in an environment of its own (400 MB)"
    )
    command.add_argument("--python", help="Python 3.11 or 3.12 to make it with (default: found)")
    command.set_defaults(run=_install_pose)


def _install_pose(arguments: argparse.Namespace) -> None:
    from ha2g_jax.data.video import pose_environment

    print(pose_environment.install(python=arguments.python))


def _add_make_talk(data: Any) -> None:
    command = data.add_parser("make-talk", help="the Talk corpus: speech and gestures with known causes")
    command.add_argument("out", type=pathlib.Path)
    command.add_argument("--speakers", type=int, default=24)
    command.add_argument("--minutes", type=float, default=120)
    command.add_argument("--seed", type=int, default=0)
    command.add_argument("--workers", type=_positive, help="processes (default: one a core)")
    command.set_defaults(run=_make_talk)


def _make_talk(arguments: argparse.Namespace) -> None:
    from ha2g_jax.data.talk import build

    build.make_talk(
        arguments.out,
        speakers=arguments.speakers,
        minutes=arguments.minutes,
        seed=arguments.seed,
        workers=arguments.workers,
    )
    print(arguments.out)


def _add_inspect_talk(data: Any) -> None:
    command = data.add_parser("inspect-talk", help="a report on the Talk corpus, with pictures")
    command.add_argument("data", type=pathlib.Path)
    command.add_argument("-o", "--out", type=pathlib.Path, default=pathlib.Path("talk_report"))
    command.add_argument("--recording", type=pathlib.Path, help="a BVH of a real speaker to compare with")
    command.set_defaults(run=_inspect_talk)


def _inspect_talk(arguments: argparse.Namespace) -> None:
    from ha2g_jax.study.corpus.talk_report import write_report

    print(write_report(arguments.data, arguments.out, recording=arguments.recording))


def _add_stats(data: Any) -> None:
    command = data.add_parser("stats", help="hours, speakers, words, bones and angles of a corpus")
    command.add_argument("data", type=pathlib.Path)
    command.add_argument("--json", action="store_true")
    command.set_defaults(run=_stats)


def _stats(arguments: argparse.Namespace) -> None:
    from ha2g_jax.study.corpus.statistics import as_table, summarise

    summary = summarise(arguments.data)
    print(json.dumps(summary, indent=1) if arguments.json else as_table(summary))


def _add_inspect(data: Any) -> None:
    command = data.add_parser("inspect", help="a page on a corpus, with clips to watch")
    command.add_argument("data", type=pathlib.Path)
    command.add_argument("-o", "--out", type=pathlib.Path, help="the page (default: DATA.html)")
    command.add_argument("--samples", type=int, default=4, help="clips to watch")
    command.set_defaults(run=_inspect)


def _inspect(arguments: argparse.Namespace) -> None:
    from ha2g_jax.study.corpus.report import write_report

    folder = arguments.data.resolve() if arguments.data.name in ("", "..") else arguments.data
    page = arguments.out or folder.with_name(f"{folder.name}.html")
    print(write_report(arguments.data, page, num_samples=arguments.samples))


def _add_validate(data: Any) -> None:
    command = data.add_parser("validate", help="look at every record of a corpus; exit code 1 if one is not well")
    command.add_argument("data", type=pathlib.Path)
    command.add_argument("--json", action="store_true")
    command.set_defaults(run=_validate)


def _validate(arguments: argparse.Namespace) -> int:
    from ha2g_jax.data import validation

    verdict = validation.examine(arguments.data)
    if arguments.json:
        print(json.dumps(verdict._asdict(), indent=1))
    else:
        notes = [f"note: {note}" for note in verdict.notes]
        print(*notes, *(verdict.findings or [f"{arguments.data} is well"]), sep="\n")
    return 1 if verdict.findings else 0


def _add_merge(data: Any) -> None:
    command = data.add_parser("merge", help="several corpora of one skeleton as one")
    command.add_argument("sources", type=pathlib.Path, nargs="+")
    command.add_argument("dst", type=pathlib.Path, help="corpus to make")
    command.add_argument("--same-speakers", action="store_true", help="speakers of one name are one person")
    command.set_defaults(run=_merge)


def _merge(arguments: argparse.Namespace) -> None:
    from ha2g_jax.data import merge

    merge.merge(arguments.sources, arguments.dst, same_speakers=arguments.same_speakers)
    print(arguments.dst)


def _add_split(data: Any) -> None:
    command = data.add_parser("split", help="divide a corpus anew into training, validation and test")
    command.add_argument("src", type=pathlib.Path)
    command.add_argument("dst", type=pathlib.Path, help="corpus to make")
    command.add_argument("--by", choices=("talk", "speaker"), default="talk", help="what is never divided")
    command.add_argument("--shares", nargs=3, type=float, default=(0.8, 0.1, 0.1), metavar=("TRAIN", "VAL", "TEST"))
    command.add_argument("--seed", type=int, default=0)
    command.set_defaults(run=_split)


def _split(arguments: argparse.Namespace) -> None:
    from ha2g_jax.data import division

    shares: dict[str, float] = dict(zip(("train", "val", "test"), arguments.shares, strict=True))
    division.divide(arguments.src, arguments.dst, by=arguments.by, shares=shares, seed=arguments.seed)
    print(arguments.dst)


def _positive(text: str) -> int:
    if not text.isdecimal() or not int(text):
        raise argparse.ArgumentTypeError(f"{text} is not a number of 1 or more")
    return int(text)


def _print_report(report: dict[str, Any], arguments: argparse.Namespace) -> None:
    from ha2g_jax.data import import_report

    if arguments.json:
        print(json.dumps(import_report.as_json(report), indent=1))
    else:
        print(import_report.as_table(report), arguments.dst, sep="\n")
