"""The parser of the commands, and the values and options that several commands have."""

import argparse
import json
from collections.abc import Iterable, Sequence
from typing import Any, NoReturn

from ha2g_jax.errors import UserError
from ha2g_jax.limits import MAX_SEED

_MAX_DIGITS = 9

READING = ("joint_map", "source_fps", "unit")
"""Options of `add_reading`."""

MODEL = "'demo', a workdir of ha2g train, a checkpoint in it, a model folder or hf://OWNER/NAME"
CONFIG = "a preset, such as talk:small or trimodal:talk:small, or FILE[:SIZE], as for ha2g train"


class Parser(argparse.ArgumentParser):
    """A parser whose commands report unknown arguments themselves, and not through the parser of `ha2g`.

    A command with a default for `overrides` takes settings of a config there, such as --config.train.steps=10.
    """

    _arguments: Sequence[str] = ()

    def parse_known_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> tuple[Any, list[str]]:  # type: ignore[override]
        """Parse arguments, all of which must be known; the names of the options among them are `given`."""
        self._arguments = [str(argument) for argument in args or ()]
        values, unknown = super().parse_known_args(args, namespace)
        options = {option: action.dest for action in self._actions for option in action.option_strings}
        given = [self._named(options, argument) for argument in self._arguments]
        values.given = getattr(values, "given", frozenset()) | {options[found[0]] for found in given if found}
        if self.get_default("overrides") is not None:
            values.overrides = [argument for argument in unknown if argument.startswith("--config.")]
            unknown = [argument for argument in unknown if argument not in values.overrides]
        if unknown:
            self.error(f"unknown arguments: {' '.join(unknown)}; see {self.prog} --help")
        return values, unknown

    def error(self, message: str) -> NoReturn:
        """End with the usage and a message, which names a value whose dash makes it look like an option."""
        options = [option for action in self._actions for option in action.option_strings]
        dashed = [it for it in self._arguments if it[:1] == "-" and it[1:2].isalpha() and it[:2] not in options]
        if dashed and ("are required" in message or "expected" in message):
            message += f"; {dashed[0]} begins with a dash: write ./{dashed[0]} for a file, or --OPTION={dashed[0]}"
        super().error(message)

    @staticmethod
    def _named(options: Iterable[str], argument: str) -> list[str]:
        """Return the options that an argument names or abbreviates, of which the parser accepts only one."""
        name = argument.partition("=")[0]
        longer = [option for option in options if name[2:] and name.startswith("--") and option.startswith(name)]
        return [option for option in options if option == name] or longer


def read_seed(text: str) -> int:
    """Parse a seed, a whole number from 0 to `MAX_SEED`.

    Raises:
        UserError: the text is anything else.
    """
    if not (text.isdecimal() and len(text) <= len(str(MAX_SEED)) and int(text) <= MAX_SEED):
        raise UserError(f"the seed is {text[:40]!r}; give a whole number from 0 to {MAX_SEED}")
    return int(text)


def positive(text: str) -> int:
    """Parse a whole number of at least 1."""
    if not text.isdecimal() or not int(text[:_MAX_DIGITS]) >= 1 or len(text) > _MAX_DIGITS:
        raise argparse.ArgumentTypeError(f"{text[:40]!r} is not a whole number from 1 to {'9' * _MAX_DIGITS}")
    return int(text)


def stored_text(value: str) -> str:
    """Parse a text that is stored in a corpus, so that it must be UTF-8."""
    try:
        value.encode()
    except UnicodeEncodeError as error:
        raise argparse.ArgumentTypeError("the text is not UTF-8") from error
    return value


def add_reading(command: Any) -> None:
    """Add the options that reading the motion of other programs may need; None where they are not given."""
    command.add_argument(
        "--joint-map",
        metavar="MAP",
        help="joint names of the files: auto, mixamo, zeroeggs, beat, genea, a rig or a file (default: auto)",
    )
    command.add_argument(
        "--source-fps",
        type=float,
        metavar="FPS",
        help="frames per second of files that state none, or a wrong rate",
    )
    command.add_argument(
        "--unit", type=float, metavar="METRES", help="metres in one unit of the files (default: by the arms' length)"
    )


def reading(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the options of `add_reading` as keyword arguments of `motion.readers.read_motion`."""
    given = {name: getattr(arguments, name) for name in READING}
    return {name: value for name, value in given.items() if value is not None}


def refuse_others(arguments: argparse.Namespace, allowed: Sequence[str], every: Sequence[str], kind: str) -> None:
    """Refuse options of `every` that are given but not `allowed`, because they have no effect with the named `kind`.

    Raises:
        UserError: such an option is given.
    """
    given = [name for name in dict.fromkeys(every) if name not in allowed and name in arguments.given]
    if given:
        options = ", ".join(f"--{name.replace('_', '-')}" for name in given)
        raise UserError(f"{options} {'does' if len(given) == 1 else 'do'} not apply to {kind}; leave {options} out")


def print_verdict(verdict: Any, checked: Any, is_json: bool) -> int:
    """Print the `notes` and the `findings` of a check of a folder or file; return the exit code, 1 for findings."""
    if is_json:
        print(json.dumps(verdict._asdict(), indent=1))
    else:
        notes = [f"note: {note}" for note in verdict.notes]
        print(*notes, *(verdict.findings or [f"{checked} is valid"]), sep="\n")
    return 1 if verdict.findings else 0
