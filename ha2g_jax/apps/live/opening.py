"""Choice of the source and the sinks of a live run by what the user calls them."""

import contextlib
import pathlib
import sys
from collections.abc import Sequence

from tqdm import tqdm

from ha2g_jax.apps.live import arriving
from ha2g_jax.apps.live.addresses import read_address
from ha2g_jax.apps.live.servers import serving
from ha2g_jax.apps.live.sinks import Recording, Sink, Sinks, UdpSink, WebSocketSink
from ha2g_jax.apps.live.sources import FileSource, Source
from ha2g_jax.apps.live.vmc import PORT, VmcSink
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.files.reading import shown
from ha2g_jax.files.writing import whole_file
from ha2g_jax.limits import MAX_SOUND_RATE, MIN_SOUND_RATE
from ha2g_jax.motion.rigs import OWN, load_rig
from ha2g_jax.viewer.live_page import live_page

_RECORDING = ".npz"


def open_source(text: str, rate: int | None = None, is_fast: bool = False) -> Source:
    """Return a source, whose sound begins when it is asked for.

    Args:
        text: path of a file with sound, "stdin", "microphone" or ws://HOST:PORT.
        rate: samples per second of "stdin", "microphone" or the WebSocket; by default that of the microphone, or 16000.
        is_fast: whether a file is taken as fast as it is computed.

    Raises:
        UserError: the source is not known, cannot be used or does not take these options, or its library is missing.
    """
    if rate is not None and not MIN_SOUND_RATE <= rate <= MAX_SOUND_RATE:
        raise UserError(f"the rate is {rate}; give {MIN_SOUND_RATE} to {MAX_SOUND_RATE} samples per second")
    is_arriving = text in ("stdin", "microphone") or "://" in text
    if is_arriving and is_fast:
        raise UserError(f"--fast is for files; {shown(text)} is heard as it comes")
    if not is_arriving and rate is not None:
        raise UserError("--rate is for stdin, the microphone and WebSockets; a file states its own rate")
    if text == "stdin":
        return arriving.PipeSource(rate or SAMPLE_RATE)
    if text == "microphone":
        return arriving.MicrophoneSource(rate)
    if text.startswith("ws://"):
        return arriving.WebSocketSource(read_address(text), rate or SAMPLE_RATE)
    if is_arriving:
        raise UserError(f"no source {shown(text)}; expected a file, stdin, microphone or ws://HOST:PORT")
    return FileSource(pathlib.Path(text), is_fast)


def open_sinks(texts: Sequence[str], stack: contextlib.ExitStack, rig: str = OWN) -> Sinks:
    """Open sinks.

    Args:
        texts: vmc://HOST[:PORT], udp://HOST:PORT, ws://HOST:PORT to listen on, or a file .npz to write.
        stack: closes the sinks; the files are complete if it is left without an exception, and not written otherwise.
        rig: rig of JSON, one of `motion.rigs.RIGS`.

    Raises:
        UserError: there is no sink, one is not known or cannot be used, or there is no such rig.
    """
    if not texts:
        raise UserError("no sink; give at least one with --sink, such as vmc://127.0.0.1:39539")
    load_rig(rig)
    if len(set(texts)) < len(texts):
        raise UserError("two sinks are the same; give each once")
    senders, recordings = list[Sink](), list[Recording]()
    for text in texts:
        scheme, separator, _ = text.partition("://")
        if separator and scheme == "vmc":
            senders.append(stack.enter_context(contextlib.closing(VmcSink(read_address(text, PORT)))))
        elif separator and scheme == "udp":
            senders.append(stack.enter_context(contextlib.closing(UdpSink(read_address(text), rig))))
        elif separator and scheme == "ws":
            address = read_address(text)
            pages = WebSocketSink(address, rig)
            stack.enter_context(serving(address, pages.serve, live_page("frames")))
            tqdm.write(f"watch at {address._replace(scheme='http')}", file=sys.stderr)
            senders.append(stack.enter_context(contextlib.closing(pages)))
        elif not separator and pathlib.Path(text).suffix.lower() == _RECORDING:
            recordings.append(Recording(stack.enter_context(whole_file(text))))
        else:
            raise UserError(
                f"no sink {shown(text)}; expected vmc://HOST:PORT, udp://HOST:PORT, ws://HOST:PORT or a file .npz"
            )
    return Sinks(tuple(senders), tuple(recordings))
