"""Start a training run from the command line, by absl flags and ml_collections configs with overrides."""

import pathlib
import re
import runpy
import sys
import traceback
from collections.abc import Sequence
from typing import Any

import ml_collections
from absl import flags
from ml_collections import config_flags

from ha2g_jax.config import presets, settings
from ha2g_jax.config.settings import Config
from ha2g_jax.errors import UserError
from ha2g_jax.files.cache import keep_programs
from ha2g_jax.files.reading import reading, reason, shown
from ha2g_jax.layers.cpu.memory import keep_memory
from ha2g_jax.limits import MAX_PROGRAM_BYTES

_USAGE = """\
usage: {program} --config CONFIG --workdir DIR [--config.KEY=VALUE ...] [--profile]

Train the model of a config. The same command continues a run that was stopped.

  --config CONFIG        one of these three, the size being one of {sizes} (default: paper):
      DATA[:SIZE]            HA2G on the data {data}
      METHOD:DATA[:SIZE]     another method: {methods}
      FILE[:SIZE]            a Python file with a function get_config(size); it is executed
  --workdir DIR          folder for checkpoints, metrics.jsonl and config.json
  --config.KEY=VALUE     change one setting, such as --config.train.batch_size=64; all are below
  --profile              write a trace of a few steps to DIR/profile

For example: {program} --config talk:small --workdir runs/talk
The Talk corpus is made on first use; for other data give --config.data.path=CORPUS, the folder of a corpus.

To train one model with several processes, start each with the same command and
  --coordinator HOST:PORT   address at which all processes reach process 0; any port that is free there
  --num_processes N         number of processes
  --process_id I            number of this process, from 0
Under Slurm's srun none of these is needed, see docs/scaling.md.

Settings of HA2G; other methods have other losses and some further settings:
{settings}
"""
_MAX_LETTERS = 1000  # of a message of a library, which may quote a whole flag


def prepare_process() -> None:
    """Let this process keep its compiled programs and memory; call this in the main thread before JAX is imported."""
    keep_programs()
    keep_memory()


def main(argv: Sequence[str] | None = None) -> int:
    """Run one training from flags, by default the arguments of this process, and return its exit code.

    Raises:
        UserError: a flag, a config or the data cannot be used, or the processes of the run did not all join.
    """
    argv = list(sys.argv if argv is None else argv)
    if {"--help", "-help", "-h"} & set(argv[1:]):
        methods = ", ".join(name for name in presets.METHODS if name != "ha2g")
        data, sizes, rows = ", ".join(presets.DATA), ", ".join(presets.SIZES), settings.as_text()
        sys.stdout.write(_USAGE.format(program=argv[0], sizes=sizes, data=data, methods=methods, settings=rows))
        return 0
    arguments, preset = _parse(argv)

    from ha2g_jax.train import hosts  # this imports JAX, after the flags were read

    hosts.start(arguments.coordinator, arguments.num_processes, arguments.process_id)

    from ha2g_jax.data.talk.build import talk_path
    from ha2g_jax.evaluation.samples import write_sample
    from ha2g_jax.train import fits
    from ha2g_jax.train.loop import train

    fits.check_changes(arguments.config, preset)
    talk_path(arguments.config.data.path)
    train(arguments.config, arguments.workdir, profile=arguments.profile, draw_sample=write_sample)
    if hosts.is_first():
        sys.stdout.write(f"{arguments.workdir}\n")
    hosts.stop()
    return 0


def load_config(spec: str, overrides: Sequence[str] = ()) -> Config:
    """Return the locked config of "DATA[:SIZE]" or "METHOD:DATA[:SIZE]", names of `presets`, or of "FILE[:SIZE]".

    A file is a Python file with a function `get_config(size)`; overrides are flags such as "--config.train.steps=10".

    Raises:
        UserError: there is no such preset, file or size, the file cannot be used, or an override does not fit.
    """
    return _parse(["ha2g train", f"--config={spec}", "--workdir=.", *overrides])[0].config


def _parse(argv: list[str]) -> tuple[Any, Config]:
    """Return the values of the flags, whose names are those of `_USAGE`, as attributes; and the config without the
    changes of the flags.
    """
    spec, argv = _take_spec(argv)
    if not spec:
        raise UserError(f"--config is missing; see {argv[0]} --help")
    values = flags.FlagValues()  # not absl's global ones, so that one process can parse twice
    flags.DEFINE_boolean("profile", False, "", flag_values=values)
    for name in ("workdir", "coordinator"):
        flags.DEFINE_string(name, None, "", flag_values=values)
    for name in ("num_processes", "process_id"):
        flags.DEFINE_integer(name, None, "", flag_values=values)
    try:
        preset = _read(spec)
        changed = preset.copy_and_resolve_references()
        config_flags.DEFINE_config_dict("config", changed, flag_values=values, sys_argv=argv)
        rest = values(argv)
    except flags.UnrecognizedFlagError as error:
        raise UserError(f"unknown flag --{shown(error.flagname)}; see {argv[0]} --help") from error
    except (KeyError, AttributeError) as error:  # raised by ml_collections for a key that the config does not have
        raise UserError(f"unknown setting: {_one_line(error)}; see {argv[0]} --help") from error
    except (flags.Error, TypeError, ValueError, ArithmeticError, IndexError, RecursionError) as error:
        raise UserError(_one_line(error)) from error
    if not values.workdir:
        raise UserError(f"--workdir is missing; see {argv[0]} --help")
    if rest[1:]:
        raise UserError(f"unexpected argument '{shown(rest[1])}'; see {argv[0]} --help")
    settings.check(values.config)
    return values, preset


def _take_spec(argv: list[str]) -> tuple[str, list[str]]:
    """Return the value of --config, "" without one, and the rest; `config_flags` would report a missing file late."""
    for index, argument in enumerate(argv):
        if match := re.fullmatch(r"--?config=(.*)", argument, re.DOTALL):
            return match[1], argv[:index] + argv[index + 1 :]
        if re.fullmatch(r"--?config", argument):
            return "".join(argv[index + 1 : index + 2]), argv[:index] + argv[index + 2 :]
    return "", argv


def _read(spec: str) -> Config:
    """Return the config of a preset, or the one that `get_config` of "FILE[:SIZE]" returns.

    A file with the name of a preset must be given as ./NAME, so that no file is executed by mistake.
    """
    path, _, size = spec.partition(":")
    if path in presets.DATA:
        return presets.make(path, size)
    if path in presets.METHODS:
        return presets.parse(size or "talk", path)
    with reading(path, "a preset or a config file"):
        is_file = pathlib.Path(path).is_file()
        if is_file and pathlib.Path(path).stat().st_size > MAX_PROGRAM_BYTES:
            raise UserError(f"{shown(path)} has more than {MAX_PROGRAM_BYTES} bytes; expected a config of some lines")
    if not is_file:
        known = ", ".join([*presets.DATA, *presets.METHODS])
        raise UserError(f"no config {shown(path)}; expected a preset, such as talk:small ({known}), or FILE[:SIZE]")
    config = _of_program(path, size)
    if not isinstance(config, ml_collections.ConfigDict):
        raise UserError(
            f"{shown(path)} has no function get_config(size) that returns a ConfigDict; see experiments/configs"
        )
    return config


def _of_program(path: str, size: str) -> object:
    """Return what `get_config` of the user's own program returns; None if it has no such function."""
    try:
        get_config = runpy.run_path(path).get("get_config")
        return get_config(*([size] if size else [])) if get_config else None
    except UserError:
        raise
    except (Exception, SystemExit) as error:
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == path]
        where = f" in line {lines[-1]}" if lines else ""
        raise UserError(
            f"the config {shown(path)} failed{where} with {type(error).__name__}: {reason(error)}; it must be a Python "
            "file, see experiments/configs"
        ) from error


def _one_line(error: Exception) -> str:
    # ml_collections quotes the message about a misspelt key, including its line breaks.
    message = str(error).replace("\\n", ". ").replace("\\'", "").replace("'", "")
    message = " ".join(message.split())
    return message if len(message) <= _MAX_LETTERS else f"{message[:_MAX_LETTERS]}..."
