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
        """Variables as `module.apply` takes them."""
        return {"params": self.params, "batch_stats": self.batch_stats}


class TrainState(flax.struct.PyTreeNode):
    """The networks after `step` steps: those of Eq. 6, or a generator alone.

    Attributes:
        step: () int32 number of steps taken.
        generator, discriminator: networks as they are trained; None for a method without a discriminator.
        average: {"params", "batch_stats"} of the generator, their running mean over the steps; None where the
            objective keeps none.
        is_finite: () bool, whether the losses and gradient norms of all steps were finite. Once one was not, no
            step changes anything: the state stays as it was before that step.
    """

    step: jax.Array
    generator: Network
    discriminator: Network | None
    average: Any
    is_finite: jax.Array

    @property
    def model(self) -> dict[str, Any]:
        """Variables of the generator to evaluate and to ship: their average where there is one."""
        return self.generator.variables if self.average is None else self.average
