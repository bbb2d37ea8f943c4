"""The `ha2g` command: arguments only; each command calls one function of the package."""

import argparse
import json
import os
import pathlib
import signal
import sys
from typing import Any

from ha2g_jax.cli import data, export, generate, view
from ha2g_jax.errors import UserError
from ha2g_jax.skeleton import SKELETONS


def main(argv: list[str] | None = None) -> int:
    """Run one command and return its exit code.

    Args:
        argv: arguments; by default those of this process.

    Returns:
        0; 1 if `doctor` or `data validate` find an error; 2 for a mistake of the user; 130 for Ctrl-C.
    """
    argv = sys.argv[1:] if argv is None else argv
    try:
        if argv[:1] == ["train"]:  # takes absl flags: --config, --workdir, --config.key=value
            from ha2g_jax import launch

            return launch.main(["ha2g train", *argv[1:]])
        arguments = _parser().parse_args(argv)
        code = arguments.run(arguments) or 0
        sys.stdout.flush()
    except UserError as error:
        print(f"ha2g: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("ha2g: interrupted", file=sys.stderr)
        return 128 + signal.SIGINT
    except BrokenPipeError:  # the reader of the output has stopped reading, as `| head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141  # the exit code of SIGPIPE in a shell
    return code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="ha2g", description="Generate gestures from speech.")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    generate.add_command(commands)
    export.add_commands(commands)
    view.add_command(commands)

    commands.add_parser("train", help="train a model (see ha2g train --help)", add_help=False)

    doctor = commands.add_parser("doctor", help="check devices, versions, memory and data, and time one step")
    doctor.add_argument("--config", help="FILE[:SIZE] (default: the smallest model, without data)")
    doctor.add_argument("--json", action="store_true", help="print JSON instead of text")
    doctor.set_defaults(run=_doctor)

    describe = commands.add_parser("describe", help="print shapes and parameter counts of every module")
    describe.add_argument("--config", required=True, help="FILE[:SIZE]")
    describe.add_argument("--json", action="store_true", help="print JSON instead of a table")
    describe.set_defaults(run=_describe)

    _add_evaluate(commands)

    model = commands.add_parser("export-model", help="write the model of a workdir as a folder of safetensors and JSON")
    model.add_argument("workdir", type=pathlib.Path, help="workdir of ha2g train, or a checkpoint in it")
    model.add_argument("out", type=pathlib.Path, help="folder to write")
    model.set_defaults(run=_export_model)

    data.add_commands(commands)
    return parser


def _add_evaluate(commands: Any) -> None:
    evaluate = commands.add_parser("evaluate", help="scores of a checkpoint, or of any folder of motion")
    evaluate.add_argument("--checkpoint", default="demo", help="'demo', a workdir or a model folder")
    evaluate.add_argument("--data", default="talk", help="'talk' or the folder of a corpus")
    evaluate.add_argument("--split", nargs="+", help="splits to score (default: test, of Talk also others)")
    evaluate.add_argument("--speech", type=pathlib.Path, help="score the beats on this recording instead of --data")
    evaluate.add_argument("--motion", type=pathlib.Path, metavar="DIR", help="score motion made by any system")
    evaluate.add_argument(
        "--reference", type=pathlib.Path, metavar="DIR", help="true motion of the same names, with sound"
    )
    evaluate.add_argument("--skeleton", choices=SKELETONS, help="of the two folders (default: found out)")
    evaluate.add_argument(
        "--joint-map", default="auto", help="of .bvh files: auto, mixamo, zeroeggs, beat, ha2g or a YAML file"
    )
    evaluate.add_argument("--autoencoder", type=pathlib.Path, help="a trained pose auto-encoder, for FGD and diversity")
    evaluate.add_argument("--legacy", action="store_true", help="add the scores by the field's old rules")
    evaluate.add_argument("--seed", type=int, default=0)
    form = evaluate.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true")
    form.add_argument("--markdown", action="store_true")
    evaluate.set_defaults(run=_evaluate)


def _doctor(arguments: argparse.Namespace) -> int:
    from ha2g_jax import launch
    from ha2g_jax.train import doctor

    findings = doctor.examine(launch.load_config(arguments.config) if arguments.config else None)
    print(json.dumps(doctor.as_json(findings), indent=1) if arguments.json else doctor.as_text(findings))
    return 0 if doctor.is_well(findings) else 1


def _describe(arguments: argparse.Namespace) -> None:
    from ha2g_jax import launch
    from ha2g_jax.train import describe

    rows = describe.describe(launch.load_config(arguments.config))
    print(json.dumps(rows, indent=1) if arguments.json else describe.as_table(rows))


def _evaluate(arguments: argparse.Namespace) -> None:
    from ha2g_jax.study.evaluation.inputs import knows_strokes
    from ha2g_jax.study.evaluation.table import as_markdown, as_table
    from ha2g_jax.study.talk import evaluate as talk
    from ha2g_jax.study.talk.recording import evaluate_recording

    if arguments.speech:
        scores = evaluate_recording(arguments.checkpoint, arguments.speech, seed=arguments.seed)
        print(json.dumps(scores, indent=1))
        return
    if (arguments.motion is None) != (arguments.reference is None):
        raise UserError("--motion and --reference go together; give both folders")
    wants_metrics = arguments.autoencoder or arguments.legacy or arguments.markdown
    if arguments.motion is None and not wants_metrics and knows_strokes(arguments.data):
        scores = talk.evaluate(arguments.checkpoint, arguments.data, splits=arguments.split, seed=arguments.seed)
        print(json.dumps(scores, indent=1) if arguments.json else talk.as_table(scores))
        return
    results = _evaluate_metrics(arguments)
    if arguments.json:
        print(json.dumps(results, indent=1, allow_nan=False))
    else:
        print((as_markdown if arguments.markdown else as_table)(results))


def _evaluate_metrics(arguments: argparse.Namespace) -> dict[str, Any]:
    from ha2g_jax.study.evaluation.inputs import evaluate_checkpoint, evaluate_folders

    options = {"autoencoder": arguments.autoencoder, "legacy": arguments.legacy, "seed": arguments.seed}
    if arguments.motion is not None:
        return evaluate_folders(
            arguments.motion, arguments.reference, skeleton=arguments.skeleton, joint_map=arguments.joint_map, **options
        )
    if len(arguments.split or ()) > 1:
        raise UserError("these scores are of one split; name one with --split")
    split = arguments.split[0] if arguments.split else None
    return evaluate_checkpoint(arguments.checkpoint, arguments.data, split=split, **options)


def _export_model(arguments: argparse.Namespace) -> None:
    from ha2g_jax.checkpoint import model_folder

    print(model_folder.export(arguments.workdir, arguments.out))
