"""The standard error is silent while a thread asks for it, and is as before when the last one has ended."""

import contextlib
import os

from ha2g_jax.files.quiet import quiet


def test_contexts_that_overlap_restore_the_standard_error(capfd):
    before = os.fstat(2)
    first, second = contextlib.ExitStack(), contextlib.ExitStack()
    first.enter_context(quiet())
    second.enter_context(quiet())
    first.close()
    os.write(2, b"silent\n")
    second.close()
    os.write(2, b"heard\n")
    after = os.fstat(2)
    assert (after.st_dev, after.st_ino) == (before.st_dev, before.st_ino)
    assert capfd.readouterr().err == "heard\n"
