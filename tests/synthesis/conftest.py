"""What tests of files and of streams share."""

import collections
import contextlib
import dataclasses
from typing import Any

import jax
import numpy as np
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


@pytest.fixture
def held_bytes():
    """A function that returns the size of all arrays that a stream refers to, those of its model left out."""

    def size(value: Any, seen: set[int]) -> int:
        if id(value) in seen:
            return 0
        seen.add(id(value))
        if isinstance(value, np.ndarray):
            return value.nbytes
        if isinstance(value, list | tuple | dict | collections.deque):
            return sum(size(item, seen) for item in (value.values() if isinstance(value, dict) else value))
        is_own = type(value).__module__.startswith(("ha2g_jax.synthesis", "ha2g_jax.features", "ha2g_jax.motion"))
        return size(vars(value), seen) if is_own and hasattr(value, "__dict__") else 0

    def held(stream):
        generator = stream._motion.generator
        return size(stream, {id(generator._variables), id(generator._assets), id(stream.spec)})

    return held


@pytest.fixture(scope="module")
def trained_model(debug_model):
    """A model that was trained with windows whose end was hidden."""
    config = debug_model.config.copy_and_resolve_references()
    config.data.lookahead = 0.5
    return dataclasses.replace(debug_model, config=config)
