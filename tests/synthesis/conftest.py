"""What tests of files and of streams share."""

import contextlib

import jax
import pytest


@pytest.fixture
def compilations():
    """A context in which what JAX compiles is recorded, and which gives the list of it."""

    @contextlib.contextmanager
    def record():
        compiled: list[str] = []

        def note(event: str, *_, **__) -> None:
            if event.startswith("/jax/core/compile"):
                compiled.append(event)

        jax.monitoring.register_event_duration_secs_listener(note)
        try:
            yield compiled
        finally:
            jax.monitoring.unregister_event_duration_listener(note)

    return record
