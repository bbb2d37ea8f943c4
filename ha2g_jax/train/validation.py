"""Evaluate the objective on held-out windows, by which the best checkpoint is chosen."""

import jax
import numpy as np
from jax.sharding import Mesh

from ha2g_jax.checkpoint.state import TrainState
from ha2g_jax.data.windows import Windows
from ha2g_jax.errors import UserError
from ha2g_jax.train import sharding
from ha2g_jax.train.objective import Objective


class Validation:
    """Mean terms of the objective over a split, in the same batches every time.

    Args:
        objective: networks and objective.
        mesh: mesh from `sharding.data_mesh`.
        windows: windows of the split; those that do not fill a batch are left out.
        batch_size: largest number of windows in a batch; batches are smaller if the split has fewer windows.

    Raises:
        UserError: there are fewer windows than devices.
    """

    def __init__(self, objective: Objective, mesh: Mesh, windows: Windows, batch_size: int):
        self._mesh, self._windows = mesh, windows
        self._step = sharding.compile_validation_step(objective, mesh)
        size = min(batch_size, len(windows) // mesh.size * mesh.size)
        if not size:
            raise UserError(
                f"the validation split has {len(windows)} windows for {mesh.size} devices: "
                "use more data or set --config.train.devices=1"
            )
        order = np.random.default_rng(0).permutation(len(windows))  # so that a batch has many speakers, as in training
        batches = order[: len(order) // size * size].reshape(-1, jax.process_count(), size // jax.process_count())
        self._batches = batches[:, jax.process_index()]  # this host's rows of each batch

    def __call__(self, state: TrainState, key: jax.Array) -> dict[str, float]:
        """Return the mean over the split of each term of `validation_step`, by name."""
        metrics = []
        for number, indices in enumerate(self._batches):
            examples = [self._windows[index] for index in indices]
            batch = {name: np.stack([example[name] for example in examples]) for name in examples[0]}
            metrics.append(self._step(state, sharding.shard_batch(self._mesh, batch), jax.random.fold_in(key, number)))
        metrics = jax.device_get(metrics)
        return {name: float(np.mean([terms[name] for terms in metrics])) for name in metrics[0]}
