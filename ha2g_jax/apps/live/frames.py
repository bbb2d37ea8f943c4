"""The frames of a live run: poses as the rigs of the sinks have them."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from ha2g_jax.motion import rigs, solver
from ha2g_jax.motion.armature import Animation
from ha2g_jax.motion.rigs import Transfer
from ha2g_jax.skeleton import Skeleton


class Frame(NamedTuple):
    """One pose on its way to the sinks.

    Attributes:
        number: number of the frame, from 0.
        seconds: moment of the sound that it belongs to, number / fps.
        heard: time of the clock at which that moment is heard.
        skeleton: skeleton of the model.
        directions: (bones, 3) unit vectors, the pose of the model, interpolated at a higher frame rate.
        animations: the pose as an animation of one frame, by the name of the rig.
    """

    number: int
    seconds: float
    heard: float
    skeleton: Skeleton
    directions: np.ndarray
    animations: dict[str, Animation]


class Rigs:
    """Conversion of direction vectors to the rigs of the sinks, frame by frame."""

    def __init__(self, skeleton: Skeleton, fps: float, names: Iterable[str]) -> None:
        """Prepare the rigs.

        Args:
            skeleton: skeleton of the direction vectors.
            fps: frames per second.
            names: names of the rigs, from `motion.rigs.RIGS`.

        Raises:
            UserError: there is no such rig.
        """
        self._solver = solver.Solver(skeleton, fps)
        own = self._solver.armature
        loaded = [rigs.load_rig(name) for name in sorted(set(names))]
        self._transfers = {rig.name: Transfer.between(own, rig) if rig.name != own.name else None for rig in loaded}
        self._last: dict[str, np.ndarray] = {}
        # The solver imports large libraries when it is used first: here, so that the first frame is not late.
        solver.Solver(skeleton, fps).animate(skeleton.mean_directions[None])

    def convert(self, directions: np.ndarray) -> dict[str, Animation]:
        """Convert the next frame.

        Args:
            directions: (bones, 3) unit vectors.

        Returns:
            An animation of one frame for each rig, by its name.
        """
        if not self._transfers:
            return {}
        own, animations = self._solver.animate(directions[None]), {}
        for name, transfer in self._transfers.items():
            animations[name] = own if transfer is None else transfer.apply(own, self._last.get(name))
            self._last[name] = animations[name].rotations[-1]
        return animations
