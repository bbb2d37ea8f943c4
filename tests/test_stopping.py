"""A signal is only recorded once there are steps to save; before that it ends the process at once."""

import signal
import subprocess
import sys
import time

import pytest

from ha2g_jax.stopping import on_stop_signals, stop_after_step

SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)

# A process with nothing to save yet; where BUSY, its main thread is where Python cannot answer, as in a compiler.
PROCESS = """
import hashlib, sys, time
from ha2g_jax.stopping import stop_after_step
with stop_after_step() as stop:
    stop.enter_compiler()
    print("ready", flush=True)
    if sys.argv[1] == "idle":
        time.sleep(60)
    hashlib.pbkdf2_hmac("sha256", b"", b"", 200_000_000)  # a minute or more
"""


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_is_noted_and_the_handlers_come_back(number):
    before = [signal.getsignal(each) for each in SIGNALS]
    with stop_after_step() as stop:
        stop.begin()
        assert not stop.is_set()
        signal.raise_signal(number)
        assert stop.is_set()
    assert [signal.getsignal(each) for each in SIGNALS] == before


def test_a_signal_that_is_ignored_as_under_nohup_stays_ignored():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with on_stop_signals(lambda number: pytest.fail("it was handled")):
            signal.raise_signal(signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_second_interrupt_does_not_wait():
    with pytest.raises(KeyboardInterrupt), stop_after_step() as stop:
        stop.begin()
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)


@pytest.mark.parametrize("number", SIGNALS)
def test_before_there_is_anything_to_save_the_process_leaves_with_0(number, capsys):
    with pytest.raises(SystemExit) as exit_info, stop_after_step():
        signal.raise_signal(number)
    assert exit_info.value.code == 0
    assert "nothing was lost" in capsys.readouterr().err


@pytest.mark.parametrize("state", ["idle", "busy"])
def test_a_compiler_is_left_without_an_exception(state):
    command = [sys.executable, "-c", PROCESS, state]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "ready\n"
    time.sleep(0.2)  # into the call
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 0
    assert "nothing was lost" in errors and "Traceback" not in errors


def test_a_check_ends_at_once_while_a_compiler_is_at_work():
    code = (
        "import hashlib; from ha2g_jax.stopping import leaving_on_signals as leaving\nwith leaving(): print('ready', "
    )
    code += "flush=True); hashlib.pbkdf2_hmac('sha256', b'', b'', 200_000_000)"
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None and process.stdout.readline() == "ready\n"
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=20)
    assert process.returncode == 128 + signal.SIGINT and err == "\nha2g: interrupted\n"
