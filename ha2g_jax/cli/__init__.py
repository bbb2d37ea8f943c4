"""The `ha2g` command: arguments only; each command calls one function of the package."""

import argparse
import io
import json
import os
import pathlib
import signal
import sys
import traceback

from ha2g_jax import __version__
from ha2g_jax.cli import data, evaluate, export, genea, generate, live, serve, study, training, view, web
from ha2g_jax.cli.parser import Parser
from ha2g_jax.cli.termination import termination
from ha2g_jax.errors import UserError
from ha2g_jax.files.compile_cache import keep_programs
from ha2g_jax.files.reading import reason, shown
from ha2g_jax.train.process import prepare_process

_TRAINING = (["train"], ["doctor"], ["benchmark"])  # commands that run training steps


def main(argv: list[str] | None = None) -> int:
    """Run one command and return its exit code.

    Args:
        argv: arguments; by default those of this process.

    Returns:
        0; 1 if `doctor`, `data validate` or `genea check` find an error, or for a fault of this program, whose
        traceback is printed; 2 for a mistake of the user or an error of the system, such as a full disk; 130 for
        Ctrl-C, 141 if the reader of the output has stopped reading, and 143 if `live` is ended by SIGTERM.

    Raises:
        SystemExit: SIGTERM ended another command, with code 143.
    """
    with termination():
        return _run(argv)


def _run(argv: list[str] | None) -> int:
    trains = argv is None and sys.argv[1:2] in _TRAINING
    argv = sys.argv[1:] if argv is None else argv
    _print_any_path()
    try:
        if trains:
            prepare_process()
        keep_programs()
        if argv[:1] == ["train"]:  # takes absl flags: --config, --workdir, --config.key=value
            from ha2g_jax import launch

            return launch.main(["ha2g train", *argv[1:]])
        arguments = _parser().parse_args(argv)
        code = arguments.run(arguments) or 0
        if sys.stdout is not None:  # it was closed before
            sys.stdout.flush()
    except UserError as error:
        print(f"ha2g: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("ha2g: interrupted", file=sys.stderr)
        return 128 + signal.SIGINT
    except BrokenPipeError:  # the reader of the output has stopped reading, as `| head` does
        if sys.stdout is not None:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141  # the exit code of SIGPIPE in a shell
    except MemoryError:
        print("ha2g: out of memory; give a shorter or smaller input, or close other programs", file=sys.stderr)
        return 2
    except OSError as error:
        where = "".join(f" {shown(name)}:" for name in (error.filename, error.filename2) if isinstance(name, str))
        print(f"ha2g:{where} {reason(error).lower()}", file=sys.stderr)
        return 2
    except Exception:
        traceback.print_exc()
        print(f"ha2g: a fault of ha2g {__version__}; please report the text above as SECURITY.md says", file=sys.stderr)
        return 1
    return code


def _print_any_path() -> None:
    """Print names of files that are not UTF-8 with escapes, instead of failing."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


_CONFIG = "a preset, such as talk:small or trimodal:talk:small, or FILE[:SIZE], as for ha2g train"


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog="ha2g", description="Generate gestures from speech.")
    parser.add_argument("--version", action="version", version=f"ha2g {__version__}", help="print the version and end")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    generate.add_command(commands)
    live.add_command(commands)
    export.add_commands(commands)
    view.add_command(commands)
    serve.add_command(commands)
    web.add_command(commands)

    speakers = commands.add_parser("speakers", help="list the speakers of a model, and how they move if that is known")
    speakers.description = "List the speakers of a model, which ha2g generate takes as --speaker and --style."
    speakers.add_argument(
        "--checkpoint", default="demo", help="'demo', a workdir, a model folder or hf://OWNER/NAME (default: demo)"
    )
    speakers.add_argument("--json", action="store_true", help="print JSON instead of a table")
    speakers.set_defaults(run=_speakers)

    commands.add_parser("train", help="train a model (see ha2g train --help)", add_help=False)
    training.add_commands(commands)

    doctor = commands.add_parser("doctor", help="check devices, versions, memory and data, and time one step")
    doctor.add_argument("--config", metavar="CONFIG", help=f"{_CONFIG} (default: the smallest model)")
    doctor.add_argument(
        "--gradients", metavar="CONFIG", help="print the norm of the gradient of each term of the objective instead"
    )
    doctor.add_argument(
        "--checkpoint", nargs="+", default=(), metavar="MODEL", help="with --gradients: runs or models to measure, too"
    )
    doctor.add_argument("--json", action="store_true", help="print JSON instead of text")
    doctor.set_defaults(run=_doctor)

    benchmark = commands.add_parser("benchmark", help="measure the speed of training and generation on this machine")
    benchmark.description = "Measure the speed of training and generation on this machine, as tables in Markdown."
    benchmark.add_argument("--config", metavar="CONFIG", default="talk:small", help=f"{_CONFIG} (default: talk:small)")
    benchmark.add_argument(
        "--batch-size", type=data.positive, metavar="B", help="windows in a step (default: that of the config)"
    )
    benchmark.add_argument(
        "--precision",
        nargs="+",
        choices=("float32", "tensorfloat32", "bfloat16"),
        help="precisions to compare (default: float32 on a CPU, else all)",
    )
    benchmark.add_argument("--steps", type=data.positive, default=10, metavar="N", help="timed steps (default: 10)")
    benchmark.add_argument("--checkpoint", default="demo", help="model for generation (default: demo)")
    benchmark.add_argument("--json", action="store_true", help="print JSON instead of tables")
    benchmark.set_defaults(run=_benchmark)

    describe = commands.add_parser("describe", help="print shapes and parameter counts of every module")
    describe.add_argument("--config", metavar="CONFIG", required=True, help=_CONFIG)
    describe.add_argument("--json", action="store_true", help="print JSON instead of a table")
    describe.set_defaults(run=_describe)

    evaluate.add_command(commands)
    study.add_command(commands)
    genea.add_commands(commands)

    model = commands.add_parser("export-model", help="write the model of a workdir as a folder of safetensors and JSON")
    model.add_argument("workdir", help="workdir of ha2g train, a checkpoint in it, a model folder, or 'demo'")
    model.add_argument("out", type=pathlib.Path, help="folder to write")
    model.set_defaults(run=_export_model)

    publish = commands.add_parser("publish", help="publish a model on the Hugging Face Hub, with a model card")
    publish.add_argument("checkpoint", help="'demo', a workdir of ha2g train, a checkpoint in it, or a model folder")
    publish.add_argument("name", metavar="OWNER/NAME", help="repository on the Hub, which is made if there is none")
    publish.add_argument("--license", required=True, help="licence of the model, such as apache-2.0 or cc-by-4.0")
    publish.add_argument("--scores", type=pathlib.Path, help="Markdown for the card, of ha2g evaluate --markdown")
    publish.add_argument("--private", action="store_true", help="make a new repository private")
    publish.set_defaults(run=_publish)

    weights = commands.add_parser("import-weights", help="write released weights of HA2G or Trimodal as a model folder")
    weights.description = (
        "Write weights that the authors of HA2G or Trimodal released, for PyTorch, as a model folder. Nothing in the "
        "file is run. See docs/released_weights.md."
    )
    weights.add_argument(
        "weights", type=pathlib.Path, metavar="CHECKPOINT", help="file of torch.save, such as best.bin"
    )
    weights.add_argument("-o", "--out", type=pathlib.Path, required=True, metavar="DIR", help="folder to write")
    weights.set_defaults(run=_import_weights)

    onnx = commands.add_parser(
        "export-onnx", help="write a model as an ONNX file, for browsers, engines and fast starts"
    )
    onnx.add_argument("checkpoint", help="'demo', a workdir of ha2g train, a checkpoint in it, or a model folder")
    onnx.add_argument("-o", "--out", type=pathlib.Path, required=True, metavar="FILE", help=".onnx file to write")
    onnx.add_argument(
        "--weights",
        choices=("float32", "float16", "int8"),
        default="float32",
        help="form of the weights in the file; docs/onnx.md has sizes and errors (default: float32)",
    )
    onnx.add_argument("--license", default="", metavar="TEXT", help="licence of the model, which the file states")
    onnx.set_defaults(run=_export_onnx)

    data.add_commands(commands)
    return parser


def _speakers(arguments: argparse.Namespace) -> None:
    from ha2g_jax.synthesis import speakers

    rows = speakers.describe_speakers(arguments.checkpoint)
    print(json.dumps(rows, indent=1) if arguments.json else speakers.as_table(rows))


def _doctor(arguments: argparse.Namespace) -> int:
    from ha2g_jax import launch
    from ha2g_jax.train import doctor, gradients

    if arguments.gradients and arguments.config:
        raise UserError("--gradients and --config both name a config; give one of them")
    if arguments.checkpoint and not arguments.gradients:
        raise UserError("--checkpoint belongs to --gradients: name a config with --gradients CONFIG")
    if arguments.gradients:
        config = launch.load_config(arguments.gradients)
        result = gradients.measure(config, arguments.checkpoint)
        print(json.dumps(result, indent=1) if arguments.json else gradients.as_table(result))
        return 0
    findings = doctor.examine(launch.load_config(arguments.config) if arguments.config else None)
    print(json.dumps(doctor.as_json(findings), indent=1) if arguments.json else doctor.as_text(findings))
    return 0 if doctor.is_well(findings) else 1


def _benchmark(arguments: argparse.Namespace) -> None:
    from ha2g_jax import launch
    from ha2g_jax.evaluation import benchmark

    config = launch.load_config(arguments.config)
    if arguments.batch_size:
        config.train.batch_size = arguments.batch_size
    result = benchmark.measure(config, arguments.checkpoint, arguments.precision, arguments.steps)
    print(json.dumps(result, indent=1) if arguments.json else benchmark.as_tables(result))


def _describe(arguments: argparse.Namespace) -> None:
    from ha2g_jax import launch
    from ha2g_jax.train import describe

    rows = describe.describe(launch.load_config(arguments.config))
    print(json.dumps(rows, indent=1) if arguments.json else describe.as_table(rows))


def _publish(arguments: argparse.Namespace) -> None:
    from ha2g_jax.checkpoint.publishing import publish

    is_private = arguments.private
    print(publish(arguments.checkpoint, arguments.name, arguments.license, arguments.scores, is_private=is_private))


def _export_model(arguments: argparse.Namespace) -> None:
    from ha2g_jax.checkpoint import loading

    print(loading.export(arguments.workdir, arguments.out))


def _import_weights(arguments: argparse.Namespace) -> None:
    from ha2g_jax.checkpoint.released.importing import import_weights

    folder, notes = import_weights(arguments.weights, arguments.out)
    for note in notes:
        print(f"ha2g: {note}", file=sys.stderr)
    print(folder)


def _export_onnx(arguments: argparse.Namespace) -> None:
    from ha2g_jax.checkpoint.onnx import reading

    reading.check_extra("onnx")
    from ha2g_jax.checkpoint.onnx import export

    print(export.export(arguments.checkpoint, arguments.out, weights=arguments.weights, license=arguments.license))
