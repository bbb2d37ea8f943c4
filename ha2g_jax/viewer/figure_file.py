"""The file `figure.glb` of the web package: the body in its rest pose, to which a page adds a motion."""

import dataclasses
import pathlib

import numpy as np

from ha2g_jax.motion.armature import Animation, ha2g_armature
from ha2g_jax.motion.formats import glb
from ha2g_jax.skeleton import Skeleton, load_skeleton

_FPS = 15.0


def write_figure(path: str | pathlib.Path, skeleton: Skeleton) -> None:
    """Write the figure of a model as a `.glb` file with one frame, the T-pose.

    Its nodes, mesh and skin are those of every `.glb` of a motion of the model; the page replaces the animation.

    Args:
        path: file to write.
        skeleton: skeleton of the model, whose bone lengths the figure has.

    Raises:
        UserError: the file cannot be written.
    """
    # A motion is exported with the rest pose of the package's skeleton and the bone lengths of the model.
    armature = ha2g_armature(dataclasses.replace(load_skeleton(skeleton.name), lengths=skeleton.lengths))
    glb.write(path, Animation(armature, armature.rest[None], np.zeros((1, 3)), _FPS, {}))
