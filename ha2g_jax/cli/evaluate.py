"""The `ha2g evaluate` command: arguments only; it calls one function of the package."""

import argparse
import json
import pathlib
from typing import Any

from ha2g_jax.cli.parser import READING, add_reading, read_seed, reading, refuse_others
from ha2g_jax.errors import UserError
from ha2g_jax.skeleton import SKELETONS

_DESCRIPTION = """\
Score the motion of one of four inputs, with intervals, next to reference rows that show what each score is worth:

  --checkpoint MODEL --data CORPUS     motion that a model makes for the test speech of a corpus
  --checkpoint MODEL --speech FILE     motion that a model makes for one recording
  --motion FILE --speech FILE          motion of any system, for one recording
  --motion DIR ... --reference DIR     motion made by any systems, against true motion; or files against one file

One of these must be named: --checkpoint alone is scored on the Talk corpus, --data alone with the demo model. On Talk
this takes minutes; the first time, the corpus is made as well, which takes further minutes. All four give results of
the same form: text, --markdown or --json. On Talk, where the causes of motion are known, each section also has scores
against strokes, words and styles. An option that does not apply is an error."""

# The options of each input, beside --seed, --json and --markdown, which all have.
_OPTIONS = {
    "--checkpoint with --data": ("checkpoint", "data", "split", "look_ahead", "autoencoder", "legacy"),
    "--checkpoint with --speech": ("checkpoint", "speech"),
    "--motion with --speech": ("motion", "speech", "skeleton", *READING),
    "--motion with --reference": (
        *("motion", "reference", "skeleton", *READING),
        *("protocol", "body_model", "autoencoder", "legacy"),
    ),
}
_CORPUS, _SPEECH, _FILE, _FOLDERS = _OPTIONS


def add_commands(commands: Any) -> None:
    """Add `evaluate` to the commands of a parser."""
    command = commands.add_parser(
        "evaluate",
        help="scores of a checkpoint on a corpus or a recording, or of any folder of motion",
        description=_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    model = command.add_argument_group("a checkpoint on a corpus or a recording")
    model.add_argument(
        "--checkpoint", help="'demo', a workdir, a model folder or hf://OWNER/NAME (with --data or --speech: demo)"
    )
    model.add_argument("--data", help="'talk' or the folder of a corpus (with --checkpoint: talk)")
    model.add_argument(
        "--split",
        nargs="+",
        help="splits of --data, a section each (default: test and test_unseen_speakers, or val without them)",
    )
    model.add_argument(
        "--look-ahead",
        type=int,
        metavar="FRAMES",
        help="score the motion of a stream that hears this many frames ahead (default: all of the speech)",
    )
    model.add_argument("--speech", type=pathlib.Path, help="a recording of speech, instead of --data")
    folders = command.add_argument_group("folders of motion")
    folders.add_argument(
        "--motion",
        type=pathlib.Path,
        nargs="+",
        action="extend",
        metavar="DIR",
        help="motion made by any system; several folders or files are rows of one table; with --speech, one file",
    )
    folders.add_argument(
        "--reference", type=pathlib.Path, metavar="DIR", help="true motion of the same names, with sound; or one file"
    )
    folders.add_argument("--skeleton", choices=SKELETONS, help="skeleton of both folders (default: that of the files)")
    add_reading(folders)
    folders.add_argument("--protocol", choices=("beat2",), help="add the scores of the papers on BEAT2 (SMPL-X only)")
    folders.add_argument(
        "--body-model", type=pathlib.Path, metavar="FILE", help="SMPLX_NEUTRAL.npz for the joints of --protocol beat2"
    )
    scores = command.add_argument_group("scores")
    scores.add_argument(
        "--autoencoder",
        type=pathlib.Path,
        help="a trained pose auto-encoder, for FGD and diversity (not with --speech)",
    )
    scores.add_argument(
        "--legacy",
        action="store_const",
        const=True,
        help="add the scores by the rules of the public release (not with --speech)",
    )
    scores.add_argument("--seed", type=read_seed, default=0, help="seed of all random choices (default: 0)")
    form = command.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="print the results as JSON")
    form.add_argument("--markdown", action="store_true", help="print the results as Markdown")
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Evaluate the input that the arguments name and print the results.

    Raises:
        UserError: no input is named, an option does not apply to it, or it cannot be evaluated.
    """
    kind = _input_of(arguments)
    refuse_others(arguments, _OPTIONS[kind], sum(_OPTIONS.values(), ()), kind)
    if kind == _CORPUS and arguments.checkpoint is None and arguments.data is None:
        raise UserError(
            "nothing to score; give --checkpoint MODEL --data CORPUS, --checkpoint MODEL --speech FILE, --motion FILE "
            "--speech FILE or --motion DIR --reference DIR, such as --checkpoint demo --data talk (see ha2g evaluate "
            "--help)"
        )
    from ha2g_jax.evaluation import scoring
    from ha2g_jax.evaluation.table import as_markdown, as_table

    if kind == _FILE:
        if len(arguments.motion) > 1 or arguments.motion[0].is_dir():
            raise UserError("--speech is one recording; give one file with --motion, or folders with --reference")
        options = reading(arguments) | {"motion": arguments.motion[0], "skeleton": arguments.skeleton}
        results = scoring.evaluate_recording("", arguments.speech, seed=arguments.seed, **options)
    elif kind == _SPEECH:
        results = scoring.evaluate_recording(arguments.checkpoint or "demo", arguments.speech, seed=arguments.seed)
    else:
        legacy = bool(arguments.legacy)
        options: dict[str, Any] = {"autoencoder": arguments.autoencoder, "legacy": legacy, "seed": arguments.seed}
        if kind == _FOLDERS:
            options |= reading(arguments) | {"skeleton": arguments.skeleton, "protocol": arguments.protocol}
            options |= {"body_model": arguments.body_model}
            results = scoring.evaluate_folders(arguments.motion, arguments.reference, **options)
        else:
            checkpoint, data = arguments.checkpoint or "demo", arguments.data or "talk"
            options |= {"splits": arguments.split, "look_ahead": arguments.look_ahead}
            results = scoring.evaluate_checkpoint(checkpoint, data, **options)
    if arguments.json:
        print(json.dumps(results, indent=1, allow_nan=False))
    else:
        print((as_markdown if arguments.markdown else as_table)(results))


def _input_of(arguments: argparse.Namespace) -> str:
    if arguments.motion is None and arguments.reference is None:
        return _CORPUS if arguments.speech is None else _SPEECH
    if arguments.motion is not None and arguments.reference is None and arguments.speech is not None:
        return _FILE
    if arguments.motion is None or arguments.reference is None:
        raise UserError("--motion and --reference go together; give both folders, or one file with --speech")
    return _FOLDERS
