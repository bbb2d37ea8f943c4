"""Kills a training run again and again, and compares what comes out with a run that was left alone.

python tests/soak_resume.py --kills 10

Every kill is SIGKILL: while the run starts, in the middle of steps, or while a checkpoint is written; then the same
command goes on. At the end all arrays of the last checkpoint (parameters, statistics, optimisers), its record and the
lines of metrics.jsonl (timings aside) must be those of the run left alone, to the last bit. Exit code 0 if they are.
"""

import argparse
import contextlib
import json
import os
import pathlib
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

ROOT = pathlib.Path(__file__).parent.parent
CONFIG = f"{ROOT}/tests/one_stage.py:debug"

STARTING, STEPPING, SAVING = "while starting", "between steps", "while saving"

# None is a multiple of another, so that checkpoints fall between lines and validations.
LOG_EVERY, CHECKPOINT_EVERY, VALIDATE_EVERY = 3, 5, 7

_TIMINGS = {"windows_per_second", "waiting_percent", "seconds", "compile_seconds"}
_POLL_SECONDS = 0.002
_PATIENCE = 600.0  # seconds until a run that neither goes on nor ends counts as stuck


def main(argv: list[str] | None = None) -> int:
    """Runs the soak; returns 0 if nothing differs."""
    from ha2g_jax.data.talk import build

    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kills", type=int, default=10)
    kills = parser.parse_args(argv).kills
    with tempfile.TemporaryDirectory(prefix="soak_resume-") as folder:
        data = pathlib.Path(folder) / "talk"
        build.make_talk(data, speakers=4, minutes=2, seed=0, workers=1)
        return bool(soak(data, pathlib.Path(folder), kills=kills, steps=10 + 12 * kills))


def soak(data: pathlib.Path, folder: pathlib.Path, *, kills: int, steps: int, config: str = CONFIG) -> list[str]:
    """Trains twice into `folder`, killing the second run `kills` times; returns what differs, one line each."""
    whole, broken, log = folder / "whole", folder / "broken", folder / "broken.log"
    pace = leave_alone(command(data, whole, steps, config), whole, folder / "whole.log")
    _say(f"left alone: {steps} steps of {pace.step:.2f} s after {pace.start:.0f} s to start")

    rng = random.Random(0)
    moments = [(SAVING, STEPPING, STARTING)[number % 3] for number in range(kills)]
    rng.shuffle(moments)
    num_killed = 0
    for number, moment in enumerate(moments):
        first, last = (max(1, round(steps * part / (kills + 1))) for part in (number, number + 1))
        target, before = rng.randint(first, min(last, steps - CHECKPOINT_EVERY)), _newest(broken)
        with training(command(data, broken, steps, config), log) as process:
            wait_for(moment, target, broken, process, pace, rng)
            process.kill()
            if process.wait() not in (0, -signal.SIGKILL):
                raise SystemExit(f"the run failed:\n{_end(log)}")
        num_killed += process.returncode == -signal.SIGKILL
        _say(
            f"kill {number + 1} of {kills}: {moment if process.returncode else 'too late'}, last line of step "
            f"{_last_step(broken)}; the run had gone on from step {before}, the next one does from {_newest(broken)}"
        )
    leave_alone(command(data, broken, steps, config), broken, log)
    problems = differences(whole, broken) if num_killed else ["the run was never killed"]
    for problem in problems:
        _say(problem)
    _say("FAILED" if problems else f"the same to the last bit after {kills} kills")
    return problems


class Pace(NamedTuple):
    """Seconds that a run takes to start, and for a step on average."""

    start: float
    step: float


def leave_alone(arguments: list[str], workdir: pathlib.Path, log: pathlib.Path) -> Pace:
    """Waits for a run to end, which it must without an error."""
    began, file = time.monotonic(), _file(workdir)
    with training(arguments, log) as process:
        until(lambda: _file(workdir) != file, process)
        start = time.monotonic() - began
        if process.wait() != 0:
            raise SystemExit(f"the run failed:\n{_end(log)}")
    return Pace(start, (time.monotonic() - began - start) / max(1, _last_step(workdir)))


def wait_for(
    moment: str, target: int, workdir: pathlib.Path, process: subprocess.Popen, pace: Pace, rng: random.Random
) -> None:
    """Waits for a moment of a kind, at or after the step `target` where there are steps."""
    if moment == STARTING:
        file, deadline = _file(workdir), time.monotonic() + rng.uniform(0.0, pace.start)
        until(lambda: _file(workdir) != file or time.monotonic() > deadline, process)
    elif moment == STEPPING:
        until(lambda: _last_step(workdir) >= target, process)
        until_seconds(rng.uniform(0.0, 3 * pace.step), process)
    else:
        until(lambda: _is_saving(workdir, target), process)
        until_seconds(rng.uniform(0.0, 0.05), process)


def command(data: pathlib.Path, workdir: pathlib.Path, steps: int, config: str = CONFIG) -> list[str]:
    """Return the command that trains on `data`; the first and all later starts have the same."""
    settings = {
        "data.path": data,
        "train.steps": steps,
        "train.log_every": LOG_EVERY,
        "train.checkpoint_every": CHECKPOINT_EVERY,
        "train.validate_every": VALIDATE_EVERY,
    }
    return [
        *(sys.executable, "-m", "ha2g_jax.cli", "train", f"--config={config}"),
        f"--workdir={workdir}",
        *(f"--config.{name}={value}" for name, value in settings.items()),
    ]


@contextlib.contextmanager
def training(arguments: list[str], log: pathlib.Path, **environment: str) -> Iterator[subprocess.Popen]:
    """A run in a process group of its own, of which nothing is left at the end; its output is appended to `log`."""
    values = {
        "JAX_PLATFORMS": "cpu",
        "JAX_COMPILATION_CACHE_DIR": str(ROOT / ".cache" / "jax"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.1",
        **os.environ,
    }
    with log.open("a") as file:
        process = subprocess.Popen(
            arguments, env=values | environment, stdout=file, stderr=subprocess.STDOUT, start_new_session=True
        )
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def until(is_reached: Callable[[], bool], process: subprocess.Popen) -> None:
    """Waits for something to happen, or for the run to end."""
    deadline = time.monotonic() + _PATIENCE
    while not is_reached() and process.poll() is None:
        if time.monotonic() > deadline:
            raise SystemExit(f"the run is stuck for {_PATIENCE:.0f} s: {process.args}")
        time.sleep(_POLL_SECONDS)


def until_seconds(seconds: float, process: subprocess.Popen) -> None:
    """Waits so long, or for the run to end."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(seconds)


def differences(whole: pathlib.Path, broken: pathlib.Path) -> list[str]:
    """What of the second workdir's last checkpoint, record and lines is not as in the first; one line each."""
    problems = []
    if (one := _newest(whole)) != (other := _newest(broken)):
        return [f"the last checkpoint is of step {other} instead of {one}"]
    one, other = _arrays(whole), _arrays(broken)
    for name in sorted(one.keys() | other.keys()):
        if name not in one or name not in other:
            problems.append(f"{name} is in one checkpoint only")
        elif one[name].dtype != other[name].dtype or one[name].tobytes() != other[name].tobytes():
            problems.append(f"{name} differs")
    problems += [f"{name} of the record differs" for name in _odd(*(_record(workdir) for workdir in (whole, broken)))]
    one, other = lines(whole), lines(broken)
    if [line["step"] for line in one] != [line["step"] for line in other]:
        problems.append("metrics.jsonl has lines of other steps")
    for left, right in zip(one, other, strict=False):
        problems += [f"metrics.jsonl, step {left['step']}: {name} differs" for name in _odd(left, right)]
    if not problems and _text(whole)[-1] != _text(broken)[-1]:
        problems.append("the last line of metrics.jsonl differs")
    return problems


def lines(workdir: pathlib.Path) -> list[dict[str, Any]]:
    """The lines of a metrics.jsonl without the timings."""
    return [
        {name: value for name, value in json.loads(line).items() if name not in _TIMINGS} for line in _text(workdir)
    ]


def _odd(one: dict[str, Any], other: dict[str, Any]) -> list[str]:
    return [name for name in sorted(one.keys() | other.keys()) if one.get(name) != other.get(name)]


def _text(workdir: pathlib.Path) -> list[str]:
    path = workdir / "metrics.jsonl"
    return (
        [line for line in path.read_text().splitlines(keepends=True) if line.endswith("}\n")] if path.exists() else []
    )


def _last_step(workdir: pathlib.Path) -> int:
    text = _text(workdir)
    return json.loads(text[-1])["step"] if text else 0


def _file(workdir: pathlib.Path) -> int | None:
    """Tells the metrics.jsonl of one start from that of the next, which replaces it when the steps begin."""
    path = workdir / "metrics.jsonl"
    return path.stat().st_ino if path.exists() else None


def _newest(workdir: pathlib.Path) -> int:
    """The step of the newest checkpoint that is whole, 0 without one."""
    return max((int(path.name) for path in (workdir / "latest").glob("*") if path.name.isdecimal()), default=0)


def _is_saving(workdir: pathlib.Path, step: int) -> bool:
    """Whether a checkpoint of this step or a later one is being written."""
    return any(
        int(path.name.partition(".")[0]) >= step for path in (workdir / "latest").glob("*.orbax-checkpoint-tmp*")
    )


def _arrays(workdir: pathlib.Path) -> dict[str, np.ndarray]:
    """All arrays of the newest checkpoint, read by Orbax alone."""
    import jax
    import orbax.checkpoint as ocp
    from etils import epath

    path = epath.Path(workdir) / "latest" / str(_newest(workdir)) / "state"
    handler = ocp.PyTreeCheckpointHandler()
    as_numpy = jax.tree.map(lambda _: ocp.RestoreArgs(restore_type=np.ndarray), handler.metadata(path).tree)
    state = handler.restore(path, args=ocp.args.PyTreeRestore(restore_args=as_numpy))
    return {jax.tree_util.keystr(name): np.asarray(leaf) for name, leaf in jax.tree_util.tree_leaves_with_path(state)}


def _record(workdir: pathlib.Path) -> dict[str, Any]:
    return json.loads((workdir / "latest" / str(_newest(workdir)) / "record" / "metadata").read_text())


def _end(log: pathlib.Path) -> str:
    return log.read_text()[-2000:]


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
