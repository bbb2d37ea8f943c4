"""The `ha2g model` commands, for models on disk: arguments only; each calls one function of the package."""

import argparse
import pathlib
import sys
from typing import Any

from ha2g_jax.cli.parser import MODEL
from ha2g_jax.progress import stage

WEIGHTS = ("float32", "float16", "int8")


def add_commands(commands: Any) -> None:
    """Add `model` and its subcommands to the commands of a parser."""
    parser = commands.add_parser("model", help="export, publish, import or average models")
    parser.description = "Export, publish, import or average models. See docs/hub.md and docs/onnx.md."
    parts = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    export = parts.add_parser("export", help="write the model of a workdir as a folder of safetensors and JSON")
    export.description = (
        "Write a model as a folder with config.json, assets.json and model.safetensors, all that generation needs."
    )
    export.add_argument("checkpoint", metavar="MODEL", help=MODEL)
    export.add_argument("out", type=pathlib.Path, metavar="FOLDER", help="folder to write")
    export.set_defaults(run=_export)

    onnx = parts.add_parser("onnx", help="write a model as an ONNX file, for browsers, engines and fast starts")
    onnx.description = "Write a model as an ONNX file, which ha2g generate takes as --checkpoint. See docs/onnx.md."
    onnx.add_argument("checkpoint", metavar="MODEL", help=MODEL)
    onnx.add_argument("-o", "--out", type=pathlib.Path, required=True, metavar="FILE", help=".onnx file to write")
    add_weights(onnx)
    onnx.add_argument("--page", action="store_true", help="also write model.json beside it, which ha2g-web reads")
    onnx.set_defaults(run=_onnx)

    publish = parts.add_parser("publish", help="publish a model on the Hugging Face Hub, with a model card")
    publish.description = (
        "Publish a model as one commit on the Hugging Face Hub, with a model card, and print the name that loads it. "
        "See docs/hub.md."
    )
    publish.add_argument("checkpoint", metavar="MODEL", help=MODEL)
    publish.add_argument(
        "name",
        metavar="OWNER/NAME[@BRANCH]",
        help="repository on the Hub, which is created if it does not exist, and an existing branch (default: main)",
    )
    publish.add_argument("--license", required=True, help="licence of the model, such as apache-2.0 or cc-by-4.0")
    publish.add_argument("--scores", type=pathlib.Path, help="Markdown for the card, of ha2g evaluate --markdown")
    publish.add_argument("--private", action="store_true", help="make a new repository private")
    publish.set_defaults(run=_publish)

    weights = parts.add_parser("import", help="write released weights of HA2G or Trimodal as a model folder")
    weights.description = (
        "Write weights that the authors of HA2G or Trimodal released, for PyTorch, as a model folder. Nothing in the "
        "file is run. See docs/released_weights.md."
    )
    weights.add_argument(
        "weights", type=pathlib.Path, metavar="CHECKPOINT", help="file of torch.save, such as best.bin"
    )
    weights.add_argument("-o", "--out", type=pathlib.Path, required=True, metavar="FOLDER", help="folder to write")
    weights.set_defaults(run=_import)

    average = parts.add_parser("average", help="write the average of the weights of several models as one model")
    average.description = (
        "Write a model whose weights are the mean of those of models that were trained from the same weights."
    )
    average.add_argument("models", nargs="+", metavar="MODEL", help=MODEL)
    average.add_argument("-o", "--out", type=pathlib.Path, required=True, metavar="FOLDER", help="folder to write")
    average.set_defaults(run=_average)


def add_weights(command: argparse.ArgumentParser) -> None:
    """Add the options of a model that is written as an ONNX file."""
    command.add_argument(
        "--weights",
        choices=WEIGHTS,
        default=WEIGHTS[0],
        help="form of the weights in the file; docs/onnx.md has sizes and errors (default: float32)",
    )
    command.add_argument("--license", default="", metavar="TEXT", help="licence of the model, which is stored with it")


def _export(arguments: argparse.Namespace) -> None:
    with stage("exporting the model"):
        from ha2g_jax.checkpoint.publishing import export

        folder = export(arguments.checkpoint, arguments.out)
    print(folder)


def _onnx(arguments: argparse.Namespace) -> None:
    from ha2g_jax.checkpoint.onnx.reading import BY
    from ha2g_jax.errors import require

    require("onnx", "onnx", by=BY)
    with stage("exporting the model"):
        from ha2g_jax.checkpoint.onnx import export

        path = export.export(arguments.checkpoint, arguments.out, weights=arguments.weights, license=arguments.license)
    print(path)
    if arguments.page:
        from ha2g_jax.synthesis.onnx_model import write_page_description

        print(write_page_description(path))


def _publish(arguments: argparse.Namespace) -> None:
    with stage("publishing the model"):
        from ha2g_jax.checkpoint.publishing import publish

        options = {"scores": arguments.scores, "is_private": arguments.private}
        name = publish(arguments.checkpoint, arguments.name, arguments.license, **options)
    print(name)


def _import(arguments: argparse.Namespace) -> None:
    with stage("importing the weights"):
        from ha2g_jax.checkpoint.released.importing import import_weights

        folder, notes = import_weights(arguments.weights, arguments.out)
    for note in notes:
        print(f"ha2g: {note}", file=sys.stderr)
    print(folder)


def _average(arguments: argparse.Namespace) -> None:
    with stage("averaging the models"):
        from ha2g_jax.checkpoint.publishing import average_models

        folder = average_models(arguments.models, arguments.out)
    print(folder)
