"""Training state: two networks, each with its parameters, statistics and optimiser state."""

from typing import Any

import flax.struct
import jax


class Network(flax.struct.PyTreeNode):
    """Parameters, BatchNorm running statistics and optimiser state of one network."""

    params: Any
    batch_stats: Any
    opt_state: Any

    @property
    def variables(self) -> dict[str, Any]:
        """Variables {"params", "batch_stats"} for `module.apply`."""
        return {"params": self.params, "batch_stats": self.batch_stats}


class TrainState(flax.struct.PyTreeNode):
    """Networks after `step` steps: those of Eq. 6, or a generator alone.

    `is_finite` tells whether the losses and gradient norms of all steps were finite. Once one was not, the state stays
    as it was before that step.
    """

    step: jax.Array  # () int32
    generator: Network
    discriminator: Network | None  # of the adversarial loss
    average: Any  # running mean over the steps of {"params", "batch_stats"} of the generator, None for no average
    is_finite: jax.Array  # () bool

    @property
    def model(self) -> dict[str, Any]:
        """Variables of the generator to evaluate and to ship: the average if there is one."""
        return self.generator.variables if self.average is None else self.average
