"""The `ha2g` command: arguments only; each command calls one function of the package."""

import argparse
import io
import logging
import os
import signal
import sys
import traceback
from collections.abc import Sequence

from ha2g_jax import __version__
from ha2g_jax.cli.parser import Parser
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import reason, shown
from ha2g_jax.stopping import ending_on_signals

# Commands by what they are for, in the order of the help.
GROUPS = {
    "make": ("generate", "export", "speakers"),
    "live": ("live", "serve"),
    "train": ("data", "train", "runs", "doctor"),
    "measure": ("evaluate", "study", "genea"),
    "publish": ("model", "web"),
}

# Earlier names of commands, which still work but are not in the help.
ALIASES = {
    ("video",): ("export",),
    ("keyframes",): ("export",),
    ("view",): ("export",),
    ("plot",): ("runs",),
    ("describe",): ("doctor", "--describe"),
    ("benchmark",): ("doctor", "--benchmark"),
    ("average",): ("model", "average"),
    ("publish",): ("model", "publish"),
    ("export-model",): ("model", "export"),
    ("export-onnx",): ("model", "onnx"),
    ("import-weights",): ("model", "import"),
    ("data", "import-ted"): ("data", "import", "--kind", "ted"),
    ("data", "import-bvh"): ("data", "import", "--kind", "bvh"),
    ("data", "import-smplx"): ("data", "import", "--kind", "smplx"),
    ("data", "install-pose"): ("data", "build-video", "--install"),
    ("data", "inspect-talk"): ("data", "inspect"),
    ("data", "stats"): ("data", "inspect"),
    ("data", "validate"): ("data", "inspect", "--check"),
}

# Files that these wrote without --out.
_OUT = {("view",): "view.html", ("plot",): "training.html", ("data", "inspect-talk"): "talk_report.html"}


def main(argv: list[str] | None = None) -> int:
    """Run one command, of this process or of `argv`, and return its exit code.

    Returns:
        0; 1 if `doctor`, `data inspect --check` or `genea check` find an error, if `study analyse` has no participant
        left, or for an error of this program, whose traceback is printed; 2 for a mistake of the user or an error of
        the system, such as a full disk; 130 for Ctrl-C, 141 if the reader of the output has stopped reading, and 143 if
        `live` is ended by SIGTERM, 129 if its terminal is closed.

    Raises:
        SystemExit: SIGTERM ended another command, with code 143, or a closed terminal did, with code 129.
    """
    with ending_on_signals():
        return _run(current_names(sys.argv[1:] if argv is None else argv), is_process=argv is None)


def current_names(argv: Sequence[str]) -> list[str]:
    """Return the arguments with an earlier name of a command replaced by the current one, see `ALIASES`."""
    for old, new in ALIASES.items():
        if tuple(argv[: len(old)]) == old:
            has_out = any(argument.startswith(("-o", "--out")) for argument in argv)
            out = ["--out", _OUT[old]] if old in _OUT and not has_out else []
            return [*new, *argv[len(old) :], *out]
    return list(argv)


def _run(argv: list[str], *, is_process: bool) -> int:
    _print_any_path()
    logging.getLogger("jax._src.xla_bridge").addFilter(_shorten)
    try:
        # What takes long to import is imported here, so that Ctrl-C meanwhile prints no traceback.
        from ha2g_jax.files.cache import keep_programs
        from ha2g_jax.files.writing import check_out

        if is_process and (argv[:1] == ["train"] or argv[:1] == ["doctor"]):  # these run training steps
            from ha2g_jax.launch import prepare_process

            prepare_process()
        keep_programs()
        if argv[:1] == ["train"]:  # takes absl flags: --config, --workdir, --config.key=value
            from ha2g_jax import launch

            return launch.main(["ha2g train", *argv[1:]])
        arguments = make_parser().parse_args(argv)
        if getattr(arguments, "out", None) is not None:
            check_out(arguments.out)
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
    except Exception as error:
        # Named, as importing JAX for the type takes long.
        if type(error).__name__ == "JaxRuntimeError" and "RESOURCE_EXHAUSTED" in str(error):
            why = str(error).splitlines()[0]
            print(
                f"ha2g: the memory of a device is too small ({why}); lower the batch size or give shorter speech",
                file=sys.stderr,
            )
            return 2
        if trouble := _trouble_of_jax():
            print(f"ha2g: {trouble}", file=sys.stderr)
            return 2
        traceback.print_exc()
        print(f"ha2g: an error of ha2g {__version__}; report the text above as SECURITY.md says", file=sys.stderr)
        return 1
    return code


def _trouble_of_jax() -> str:
    """Return why JAX does not start on this machine, and what to change; empty if it starts."""
    platforms = os.environ.get("JAX_PLATFORMS", "")
    try:
        import jax

        jax.devices()
    # Without the plugin of CUDA it is an AssertionError, with packages of two versions a RuntimeError or ImportError.
    except (AssertionError, ImportError, RuntimeError) as error:
        if platforms:
            install = "install its plugin, such as pip install -U 'jax[cuda13]'"
            return f"JAX has no platform {shown(platforms)} on this machine: unset JAX_PLATFORMS, or {install}"
        return f"JAX does not start ({reason(error)}): install its packages in one version, pip install -U jax jaxlib"
    return ""


def _shorten(record: logging.LogRecord) -> bool:
    """Let JAX say in one line why a plugin does not start, and what to install."""
    if record.exc_info and (error := record.exc_info[1]):
        text = record.getMessage()
        extra = next((name for name in ("cuda12", "cuda13") if name in f"{text} {error}"), "cuda13")
        advice = f"install JAX and its plugin in one version, such as pip install -U 'jax[{extra}]'"
        record.msg, record.args, record.exc_info = f"{text} ({reason(error)}): {advice}", (), None
    return True


def _print_any_path() -> None:
    """Print names of files that are not UTF-8 with escapes, instead of failing."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of `ha2g`, with the commands of `GROUPS`."""
    from ha2g_jax.cli import data, evaluate, export, genea, generate, live, model, serve, study, train

    parser = Parser(
        prog="ha2g", usage="ha2g [-h] [--version] COMMAND ...", formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--version", action="version", version=f"ha2g {__version__}", help="print the version and end")
    commands = parser.add_subparsers(prog="ha2g", required=True, metavar="COMMAND", help=argparse.SUPPRESS)
    for part in (generate, live, export, serve, train, evaluate, study, genea, model, data):
        part.add_commands(commands)
    helps = {action.dest: action.help for action in commands._choices_actions}
    lines = ["Generate gestures from speech.", ""]
    for group, names in GROUPS.items():
        lines += [f"{group}:", *(f"  {name:<10} {helps[name]}" for name in names), ""]
    parser.description = "\n".join([*lines, "ha2g COMMAND --help has the options of a command."])
    return parser
