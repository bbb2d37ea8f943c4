"""The PyTorch steps in a process of their own, so that neither library waits for memory that the other has returned."""

import multiprocessing
from collections.abc import Sequence
from multiprocessing.connection import Connection
from typing import NamedTuple

from ha2g_jax.config.settings import Config
from ha2g_jax.errors import UserError


class Choice(NamedTuple):
    """One way to run the step.

    Attributes:
        passes: number of runs of the cascade, see `step`.
        compiled: whether `torch.compile` compiles the networks and the terms.
    """

    passes: int
    compiled: bool


class TorchProcess:
    """A process with PyTorch steps of a config on the random batch of `ha2g_jax.train.measure.TimedStep`.

    Args:
        config: config of the step.
        choices: steps to make.
        threads: number of threads of PyTorch.
        device: device of PyTorch, "cpu" or "cuda"; a GPU multiplies in TensorFloat-32.
    """

    def __init__(self, config: Config, choices: Sequence[Choice], threads: int, device: str = "cpu"):
        context = multiprocessing.get_context("spawn")
        self._connection, other = context.Pipe()
        arguments = (other, config.to_dict(), list(choices), threads, device)
        self._process = context.Process(target=_serve, args=arguments, daemon=True)
        self._process.start()
        other.close()

    def run(self, number: int) -> float:
        """Run the step of a choice once and return its seconds.

        Args:
            number: place of the choice in `choices`.

        Raises:
            UserError: the process has ended, after an error that it printed or for lack of memory.
        """
        try:
            self._connection.send(number)
            return self._connection.recv()
        except (EOFError, OSError) as error:
            self._process.join()
            raise UserError(f"the process of PyTorch ended (exit code {self._process.exitcode})") from error

    def close(self) -> None:
        """End the process."""
        self._connection.close()
        self._process.join()


def _serve(connection: Connection, values: dict, choices: Sequence[Choice], threads: int, device: str) -> None:
    from ha2g_jax.layers.cpu.memory import keep_memory

    keep_memory()
    import jax
    import torch

    from ha2g_jax.config import settings as configs
    from ha2g_jax.skeleton import load_skeleton
    from ha2g_jax.train.measure import NUM_SPEAKERS, NUM_WORDS, random_batch
    from ha2g_jax.train.objective import build_objective
    from torch_peer.step import TorchStep

    jax.config.update("jax_platforms", "cpu")  # here it only describes the step
    torch.set_num_threads(threads)
    torch.backends.cuda.matmul.allow_tf32 = torch.backends.cudnn.allow_tf32 = True
    torch.backends.cudnn.benchmark = True  # the fastest convolutions of those that there are
    config = configs.from_json(values)
    torch.manual_seed(config.seed)
    objective = build_objective(config, load_skeleton(config.skeleton), NUM_WORDS, NUM_SPEAKERS)
    batch = random_batch(objective.spec, config.train.batch_size, NUM_WORDS, NUM_SPEAKERS)
    steps = [
        TorchStep(config, objective, passes=each.passes, compiled=each.compiled, device=device) for each in choices
    ]
    tensors = steps[0].tensors(batch)
    while True:
        try:
            number = connection.recv()
        except EOFError:
            return
        connection.send(steps[number].run(tensors))
