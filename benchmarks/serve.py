"""Measure how many streams in real time the workers of `ha2g serve` hold, and what happens at twice as many.

python benchmarks/serve.py
python benchmarks/serve.py --workers 2 --hop 3 --json

Every stream sends speech as a microphone does, in messages of 50 ms, each when its last sample is spoken. A frame is
late by the time from its due, which is the moment that it shows plus the latency that the service states, to its
arrival. A number of streams is held if 99 of 100 frames are late by 0.1 s at most. The search doubles the number, then
halves the interval. At last a service with as many places as streams that it holds is asked for twice as many: exit
code 0 if it refuses those for which it has no place, and holds the others.

The service runs on as many cores as it has workers, and this script on the others, where the system can tell it so.
All connections are on this machine.
"""

import argparse
import asyncio
import contextlib
import json
import os
import pathlib
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from memory import peak_memory
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import InvalidStatus

from ha2g_jax.cli.parser import positive
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE, read_audio
from ha2g_jax.motion.windows import DEFAULT_HOP

_SPEECH = pathlib.Path(__file__).parent.parent / "examples" / "hello.wav"
_MESSAGE_SECONDS = 0.05
_LATE_SECONDS = 0.1  # that 99 of 100 frames may be late


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--checkpoint", default="demo", help="'demo' (default), a workdir or a model folder")
    parser.add_argument("--workers", type=positive, default=1, help="workers of the service, one a core (default: 1)")
    parser.add_argument("--hop", type=positive, default=DEFAULT_HOP, help="frames that are computed at once")
    parser.add_argument("--seconds", type=float, default=10, help="length of a stream (default: 10)")
    parser.add_argument("--most", type=positive, default=64, help="streams for each worker at most (default: 64)")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    try:
        rows = measure(arguments.checkpoint, arguments.workers, arguments.hop, arguments.seconds, arguments.most)
    except UserError as error:
        print(f"serve: {error}", file=sys.stderr)
        return 2
    print(json.dumps(rows, indent=1) if arguments.json else as_table(rows))
    return 0 if rows[-1]["held"] and rows[-1]["accepted"] == rows[-1]["places"] else 1


def measure(checkpoint: str, workers: int, hop: int, seconds: float, most: int) -> list[dict[str, Any]]:
    """Return a row for each number of streams that was tried, and at last one for twice as many as were held.

    Args:
        checkpoint: model, see `ha2g serve`.
        workers: workers of the service.
        hop: frames that are computed at once.
        seconds: length of a stream.
        most: streams for each worker at most.

    Raises:
        UserError: the service cannot be started, or holds no stream.
    """
    speech = np.resize(read_audio(_SPEECH), round(seconds * SAMPLE_RATE))
    pcm = np.clip(speech * 32768, -32768, 32767).astype("<i2")
    rows = []
    with service(checkpoint, workers, most) as port:
        asyncio.run(load(port, workers, pcm, hop))  # not timed
        held, refused, number = 0, workers * most + 1, workers
        while held < number < refused:
            rows.append(asyncio.run(load(port, number, pcm, hop)))
            held, refused = (number, refused) if rows[-1]["held"] else (held, number)
            number = min(2 * number, refused - 1) if refused > workers * most else (held + refused) // 2
    places = held // workers
    if not places:
        raise UserError(f"{workers} workers hold {held} streams in real time; take a greater --hop, or a smaller model")
    with service(checkpoint, workers, places) as port:
        asyncio.run(load(port, workers, pcm, hop))
        rows.append(asyncio.run(load(port, 2 * places * workers, pcm, hop)))
    rows[-1] |= {"places": places * workers, "worker_bytes": peak_memory(resource.RUSAGE_CHILDREN)}
    return rows


@contextlib.contextmanager
def service(checkpoint: str, workers: int, sessions: int) -> Iterator[int]:
    """Yield the port of a service that runs in this context.

    Args:
        checkpoint: model.
        workers: number of workers.
        sessions: places for streams of each.

    Raises:
        UserError: the service cannot be started.
    """
    command = [sys.executable, "-m", "ha2g_jax.cli", "serve", "--port", "0", "--rate", "0", "--checkpoint", checkpoint]
    command += ["--workers", str(workers), "--sessions", str(sessions)]
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    if len(cores) >= workers:
        os.sched_setaffinity(0, cores[:workers])  # the service has them from this process
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        if len(cores) > workers:
            os.sched_setaffinity(0, cores[workers:])
        try:
            assert process.stderr is not None
            line = ""
            for line in process.stderr:
                if "ready at" in line:
                    break
            else:
                raise UserError(f"ha2g serve failed: {line.strip() or 'without a message'}")
            yield int(line.rsplit(":", 1)[1])
        finally:
            process.terminate()
            if cores:
                os.sched_setaffinity(0, cores)


async def load(port: int, number: int, pcm: np.ndarray, hop: int) -> dict[str, Any]:
    """Open streams, let those that are accepted run at once, and return how late their frames were.

    Args:
        port: port of the service.
        number: number of streams.
        pcm: (samples,) of 16 bits at 16 kHz that each of them sends.
        hop: frames that are computed at once.

    Raises:
        UserError: a stream was refused without a time to come back, or broke off.
    """
    async with contextlib.AsyncExitStack() as stack:
        tried = [connect(f"ws://127.0.0.1:{port}/v1/stream", open_timeout=60, proxy=None) for _ in range(number)]
        opened = await asyncio.gather(*(stack.enter_async_context(one) for one in tried), return_exceptions=True)
        streams = [one for one in opened if isinstance(one, ClientConnection)]
        refused = [one for one in opened if isinstance(one, InvalidStatus) and one.response.status_code == 503]
        if len(streams) + len(refused) < number or not all("Retry-After" in one.response.headers for one in refused):
            raise UserError(f"of {number} streams, {len(streams)} were accepted and {len(refused)} refused with 503")
        facts = await asyncio.gather(*(_begin(stream, hop) for stream in streams))
        begin = time.monotonic() + 0.2
        starts = [begin + _MESSAGE_SECONDS * place / len(streams) for place in range(len(streams))]
        found = [_late(*one, pcm) for one in zip(streams, facts, starts, strict=True)]
        late = np.concatenate(await asyncio.gather(*found))
    middle, nearly, last = (float(value) for value in np.percentile(late, (50, 99, 100)))
    row = {"streams": number, "accepted": len(streams), "refused": len(refused), "frames": len(late)}
    return row | {"median_late": middle, "late_99": nearly, "most_late": last, "held": nearly <= _LATE_SECONDS}


async def _begin(stream: ClientConnection, hop: int) -> dict[str, Any]:
    await stream.send(json.dumps({"hop": hop}))
    return json.loads(await stream.recv())


async def _late(stream: ClientConnection, facts: dict[str, Any], start: float, pcm: np.ndarray) -> np.ndarray:
    """Return by how many seconds each frame of a stream was late; its sound begins at a time of the clock."""

    async def send() -> None:
        length = round(_MESSAGE_SECONDS * SAMPLE_RATE)
        for place in range(0, len(pcm), length):
            message = pcm[place : place + length]
            await asyncio.sleep(start + (place + len(message)) / SAMPLE_RATE - time.monotonic())
            await stream.send(message.tobytes())
        await stream.send('{"end": true}')

    sending = asyncio.ensure_future(send())
    late: list[float] = []
    async for text in stream:
        now, message = time.monotonic(), json.loads(text)
        if "error" in message:
            raise UserError(f"a stream ended: {message['error']}")
        for number in range(message.get("first", 0), message.get("first", 0) + len(message.get("frames", ()))):
            due = number / facts["fps"] + facts["latency"]
            if due <= len(pcm) / SAMPLE_RATE:  # the end of the sound completes the others
                late.append(now - start - due)
    await sending
    return np.array(late)


def as_table(rows: list[dict[str, Any]]) -> str:
    names = ("streams", "accepted", "refused", "median late s", "99 % late s", "most s")
    lines = ["{:>8} {:>9} {:>8} {:>14} {:>12} {:>7}  held".format(*names)]
    lines += [
        f"{row['streams']:8d} {row['accepted']:9d} {row['refused']:8d} {row['median_late']:14.3f} "
        f"{row['late_99']:12.3f} {row['most_late']:7.3f}  {'yes' if row['held'] else 'no'}"
        for row in rows
    ]
    held, last = max(row["accepted"] for row in rows if row["held"]), rows[-1]
    lines.append(f"held: {held} streams; with {last['places']} places, {last['refused']} of {last['streams']} refused")
    lines.append(f"memory of a worker: {last['worker_bytes'] / 2**20:.0f} MiB")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
