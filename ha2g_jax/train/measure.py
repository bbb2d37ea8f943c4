"""Measure the training step of a config on random data: time, speed and memory."""

import time
from typing import Any, NamedTuple

import jax
import numpy as np

from ha2g_jax.config.settings import Config
from ha2g_jax.data.corpus import TRAIN, Corpus
from ha2g_jax.methods.method import Spec, example_batch
from ha2g_jax.skeleton import load_skeleton, normalize
from ha2g_jax.train import sharding
from ha2g_jax.train.objective import build_objective, init_state
from ha2g_jax.train.operations import count_operations

# Sizes of the tables of words and speakers where no corpus is given: about those of TED.
NUM_WORDS, NUM_SPEAKERS = 20_000, 1_000


class Memory(NamedTuple):
    """Memory of a compiled step on each device, in bytes.

    Attributes:
        arguments: size of the state and the batch that the step takes.
        outputs: size of the state and the metrics that the step returns.
        aliased: part of the outputs that reuses the memory of arguments.
        temporary: size of all intermediate values.
    """

    arguments: int
    outputs: int
    aliased: int
    temporary: int

    @property
    def total(self) -> int:
        """Bytes that the step needs in all."""
        return self.arguments + self.outputs - self.aliased + self.temporary


class TimedStep:
    """The training step of a config, compiled for the devices of the config but not yet run.

    Args:
        config: settings, see `ha2g_jax.config.settings.paper`.
        corpus: corpus whose numbers of words and speakers are the sizes of the tables; None for the sizes of TED.

    Attributes:
        objective: networks and terms of the step.
        batch: the random batch, on the devices.
        batch_size: windows in a step, on all devices together.
        num_devices: devices that the step runs on.
        operations: floating-point operations of the matrix products and convolutions of a step, on all devices.
        compile_seconds: seconds to trace and compile; less if the program was in the compilation cache.
        memory: memory of the step, None if the compiler does not report it.

    Raises:
        UserError: a setting cannot be used, or the batch does not split over the devices.
    """

    def __init__(self, config: Config, corpus: Corpus | None = None):
        skeleton = corpus.skeleton if corpus else load_skeleton(config.skeleton)
        num_words = len(corpus.vocabulary()) if corpus else NUM_WORDS
        num_speakers = len(corpus.speakers_of(TRAIN)) if corpus else NUM_SPEAKERS
        self.objective = objective = build_objective(config, skeleton, num_words, num_speakers)
        self._mesh = sharding.data_mesh(jax.devices()[: config.train.devices or None])
        self.batch_size, self.num_devices = config.train.batch_size, self._mesh.size
        data = random_batch(objective.spec, self.batch_size, num_words, num_speakers)
        self.batch = sharding.shard_batch(self._mesh, data)
        self._key = jax.random.key(config.seed)
        self._state: Any = None

        started = time.perf_counter()
        self._shapes = jax.eval_shape(lambda key: init_state(objective, key), self._key)
        # The function of `compile_step` compiles when it is called; this compiles the same program from shapes alone.
        step = jax.jit(sharding.compile_step(objective, self._mesh), donate_argnums=0)
        traced = step.trace(self._shapes, self.batch, self._key)
        self._step = traced.lower().compile()
        self.compile_seconds = time.perf_counter() - started
        self.operations = count_operations(traced.jaxpr.jaxpr)
        self.memory = _memory(self._step)

    def run(self) -> float:
        """Run one step and return its seconds; the first call also creates the state, which is not timed."""
        if self._state is None:
            # The time does not depend on the numbers, and the program that initialises the state compiles slowly.
            state = jax.tree.map(lambda x: np.full(x.shape, 0.01, x.dtype), self._shapes)
            self._state = sharding.replicate(self._mesh, state)
        started = time.perf_counter()
        self._state, metrics = self._step(self._state, self.batch, self._key)
        jax.block_until_ready((self._state, metrics))
        return time.perf_counter() - started


def random_batch(spec: Spec, size: int, num_words: int, num_speakers: int) -> dict[str, np.ndarray]:
    """Return noise in the shapes, types and units of a batch, see `ha2g_jax.data.windows`.

    Args:
        spec: networks and sizes.
        size: windows in the batch.
        num_words: number of words in the vocabulary.
        num_speakers: number of speakers.
    """
    random = np.random.default_rng(0)

    def draw(name: str, shape: tuple[int, ...]) -> np.ndarray:
        match name:
            case "mel" | "asr_mel" | "audio":
                low, high = {"mel": (-80, 0), "asr_mel": (-1.5, 1.5), "audio": (-1, 1)}[name]
                return random.uniform(low, high, shape).astype(np.float32)
            case "directions":
                directions = random.normal(0, 0.3, shape) + spec.skeleton.mean_directions
                return normalize(directions.astype(np.float32))
            case "images":
                return random.integers(256, size=shape, dtype=np.uint8)
        return random.integers(num_speakers if name == "speaker" else num_words, size=shape, dtype=np.int32)

    one = jax.eval_shape(lambda: example_batch(spec))
    return {name: draw(name, (size, *array.shape[1:])) for name, array in one.items()}


def _memory(step: jax.stages.Compiled) -> Memory | None:
    found = step.memory_analysis()
    if found is None:
        return None
    return Memory(
        arguments=found.argument_size_in_bytes,
        outputs=found.output_size_in_bytes,
        aliased=found.alias_size_in_bytes,
        temporary=found.temp_size_in_bytes,
    )
