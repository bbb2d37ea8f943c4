"""Start a training run from the command line, by absl flags and ml_collections configs with overrides."""

import pathlib
import re
import runpy
import sys
from collections.abc import Sequence
from typing import NamedTuple

import ml_collections
from absl import flags
from ml_collections import config_flags

from ha2g_jax import config_renames
from ha2g_jax.config import Config, check_fps
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import reading, reason, shown
from ha2g_jax.limits import MAX_CONFIG_BYTES, MAX_SETTING, MAX_SIZE

_EXPECTED = "a config, such as experiments/configs/talk.py"
_PARTS = ("data", "model", "loss", "train")

_USAGE = """\
usage: {program} --config FILE[:SIZE] --workdir DIR [--config.KEY=VALUE ...] [--profile]

Train the model of a config. The same command continues a run that was stopped.

  --config FILE[:SIZE]   config, such as experiments/configs/talk.py:small; sizes are paper, small, study, debug
  --workdir DIR          folder for checkpoints, metrics.jsonl and config.json
  --config.KEY=VALUE     change one setting, such as --config.train.batch_size=64
  --profile              write a trace of a few steps to DIR/profile

To train one model with several processes, start each with the same command and
  --coordinator HOST:PORT   address at which all processes reach process 0; any port that is free there
  --num_processes N         number of processes
  --process_id I            number of this process, from 0
Under Slurm's srun none of these is needed, see docs/scaling.md.
"""


class Arguments(NamedTuple):
    """Values of the flags."""

    config: Config
    workdir: str
    profile: bool
    coordinator: str | None
    num_processes: int | None
    process_id: int | None


def main(argv: Sequence[str] | None = None) -> int:
    """Run one training from flags and return its exit code.

    Args:
        argv: name of the program, then the flags; by default those of this process.

    Raises:
        UserError: a flag, a config or the data cannot be used, or the processes of the run did not all join.
    """
    argv = list(sys.argv if argv is None else argv)
    if {"--help", "-help", "-h"} & set(argv[1:]):
        sys.stdout.write(_USAGE.format(program=argv[0]))
        return 0
    arguments = _parse(argv)

    from ha2g_jax.train import hosts  # this imports JAX, after the flags were read

    hosts.start(arguments.coordinator, arguments.num_processes, arguments.process_id)

    from ha2g_jax.synthesis.samples import write_sample
    from ha2g_jax.train.loop import train

    train(arguments.config, arguments.workdir, profile=arguments.profile, draw_sample=write_sample)
    if hosts.is_first():
        sys.stdout.write(f"{arguments.workdir}\n")
    hosts.stop()
    return 0


def load_config(spec: str, overrides: Sequence[str] = ()) -> Config:
    """Return the config of a file, locked.

    Args:
        spec: "FILE" or "FILE:SIZE", the path of a Python file with a function `get_config(size)`, and a size.
        overrides: flags such as "--config.train.steps=10".

    Raises:
        UserError: there is no such file or size, or an override does not fit.
    """
    return _parse(["ha2g", f"--config={spec}", "--workdir=.", *overrides]).config


def _parse(argv: list[str]) -> Arguments:
    spec, argv = _take_spec(argv)
    values = flags.FlagValues()  # not absl's global ones, so that one process can parse twice
    flags.DEFINE_string("workdir", None, "", flag_values=values)
    flags.DEFINE_boolean("profile", False, "", flag_values=values)
    flags.DEFINE_string("coordinator", None, "", flag_values=values)
    flags.DEFINE_integer("num_processes", None, "", flag_values=values)
    flags.DEFINE_integer("process_id", None, "", flag_values=values)
    try:
        if spec:
            config = _read(spec)
            argv = _with_new_names(argv, config.get("method", "ha2g"))
            config_flags.DEFINE_config_dict("config", config, flag_values=values, sys_argv=argv)
        rest = values(argv)
    except flags.UnrecognizedFlagError as error:
        raise UserError(f"unknown flag --{error.flagname}; see {argv[0]} --help") from error
    except (KeyError, AttributeError) as error:  # raised by ml_collections for a key that the config does not have
        raise UserError(f"unknown setting: {_one_line(error)}; see ha2g_jax/config.py") from error
    except (flags.Error, TypeError, ValueError, ArithmeticError, RecursionError) as error:
        if match := re.search(r"--?config\.data\.fps=(\d+\.\d+)\b", str(error)):
            check_fps(float(match[1]), "config.data.fps")
        raise UserError(_one_line(error)) from error
    if not spec or not values.workdir:
        raise UserError(f"--{'workdir' if spec else 'config'} is missing; see {argv[0]} --help")
    if rest[1:]:
        raise UserError(f"unexpected argument {rest[1]!r}; see {argv[0]} --help")
    _check_numbers(values.config, "config")
    return Arguments(
        config=values.config,
        workdir=values.workdir,
        profile=values.profile,
        coordinator=values.coordinator,
        num_processes=values.num_processes,
        process_id=values.process_id,
    )


def _take_spec(argv: list[str]) -> tuple[str, list[str]]:
    """Return the value of --config, "" without one, and the other arguments.

    `config_flags` would read the file through a deprecated function of Python, and report a missing file late.
    """
    for index, argument in enumerate(argv):
        if match := re.fullmatch(r"--?config=(.*)", argument):
            return match[1], argv[:index] + argv[index + 1 :]
        if re.fullmatch(r"--?config", argument):
            return "".join(argv[index + 1 : index + 2]), argv[:index] + argv[index + 2 :]
    return "", argv


def _read(spec: str) -> Config:
    """Return the config that `get_config` of "FILE[:SIZE]" returns."""
    path, _, size = spec.partition(":")
    with reading(path, _EXPECTED):
        if not pathlib.Path(path).is_file():
            raise UserError(
                f"no config file {shown(path)!r}; expected FILE[:SIZE], such as experiments/configs/talk.py:small"
            )
        if pathlib.Path(path).stat().st_size > MAX_CONFIG_BYTES:
            raise UserError(f"{shown(path)} has more than {MAX_CONFIG_BYTES} bytes; expected {_EXPECTED}")
    try:
        get_config = runpy.run_path(path).get("get_config")
        config = get_config(*([size] if size else [])) if get_config else None
    except UserError:
        raise
    except SyntaxError as error:
        raise UserError(f"{shown(path)} is not a Python file ({_one_line(error)}); see experiments/configs") from error
    except (Exception, SystemExit) as error:  # a config is a program of the user, which may raise anything
        found = f"{type(error).__name__}: {reason(error)}"
        raise UserError(f"{shown(path)} fails ({found}); correct it, see experiments/configs") from error
    if not isinstance(config, ml_collections.ConfigDict):
        raise UserError(
            f"{shown(path)} has no function get_config(size) that returns a ConfigDict; see experiments/configs"
        )
    _check_parts(config, path)
    values, renamed = config_renames.with_new_names(config.to_dict())
    config_renames.warn(renamed, shown(path))
    return ml_collections.ConfigDict(values) if renamed else config


def _check_parts(config: Config, path: str) -> None:
    """Check that a config has the parts that all configs have."""
    for name in _PARTS:
        if not isinstance(config.get(name), ml_collections.ConfigDict):
            raise UserError(f"{shown(path)} returns a config without the part {name}; start from ha2g_jax.config.paper")
    for name in ("method", "skeleton"):
        if not isinstance(config.get(name), str):
            raise UserError(f"{shown(path)} returns a config without a {name}; start from ha2g_jax.config.paper")


def _check_numbers(part: Config, name: str) -> None:
    """Check that all numbers of a config are finite, and that sizes are such that networks can be built."""
    for key, value in part.items():
        if isinstance(value, ml_collections.ConfigDict):
            _check_numbers(value, f"{name}.{key}")
            continue
        for number in value if isinstance(value, (tuple, list)) else (value,):
            if isinstance(number, (int, float)) and not -MAX_SETTING <= number <= MAX_SETTING:
                text = f"{number:g}" if isinstance(number, float) else "a number of many digits"
                raise UserError(f"{name}.{key} is {text}; expected a number of at most {MAX_SETTING:,}")
            # Whole numbers of the networks are sizes, and so are those of images.
            is_size = name.startswith("config.model") or key in ("image_size", "num_reference_images")
            if is_size and type(number) is int and not 1 <= number <= MAX_SIZE:
                raise UserError(f"{name}.{key} is {number}; expected 1 to {MAX_SIZE:,}: set --{name}.{key}")
            if key == "dropout" and not 0 <= number < 1:
                raise UserError(f"{name}.{key} is {number}; expected at least 0 and less than 1: set --{name}.{key}")


def _with_new_names(argv: list[str], method: str) -> list[str]:
    """Return the arguments with the present names of settings in place of old ones, which are named on stderr."""
    renamed, arguments = [], []
    for argument in argv:
        if match := re.fullmatch(r"(--?config\.)([\w.]+)(.*)", argument, re.DOTALL):
            new = config_renames.new_name(match[2], method)
            if new != match[2]:
                renamed.append((match[2], new))
            argument = f"{match[1]}{new}{match[3]}"
        arguments.append(argument)
    config_renames.warn(renamed, "the command")
    return arguments


def _one_line(error: Exception) -> str:
    # ml_collections quotes the message about a misspelt key, including its line breaks.
    message = str(error).replace("\\n", ". ").replace("\\'", "").replace("'", "")
    return reason(ValueError(message))
