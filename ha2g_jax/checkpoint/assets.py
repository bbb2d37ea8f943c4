"""What a trained model carries beside its weights: skeleton, words, the styles of its speakers, start poses."""

import dataclasses
import functools
from typing import Any

import jax
import numpy as np

from ha2g_jax.data.windows import Windows
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.methods.task import Task
from ha2g_jax.skeleton import SKELETONS, Skeleton, load_skeleton

SCHEMA_VERSION = 1

_NUM_STARTS = 16
_CLIPS_PER_SPEAKER = 8
STATISTICS = ("lengths", "mean_directions", "mean_pose", "angle_mean", "angle_variance", "angle_change")


@dataclasses.dataclass(frozen=True)
class Assets:
    """Attributes:
    skeleton: with the statistics of the training split.
    vocabulary: of the training split.
    speakers: name -> (18,) float32 mean of f_id, in the order of the speakers' indices.
    seed_poses: (K, M, bones, 3) float32 unit vectors, calm starts to generate from.
    hash: of the weights, "" before there are any.
    """

    skeleton: Skeleton
    vocabulary: Vocabulary
    speakers: dict[str, np.ndarray]
    seed_poses: np.ndarray
    hash: str = ""


def calm_starts(windows: Windows, mean_directions: np.ndarray, num_frames: int) -> np.ndarray:
    """Seed poses to generate from: of the starts of windows near the mean pose, those that move least.

    Args:
        windows: of the training split.
        mean_directions: (bones, 3) of the training split.
        num_frames: M.

    Returns:
        (K, M, bones, 3) float32 unit vectors, at most 16 and at most one of a clip.
    """
    starts = np.stack([windows.directions(index)[:num_frames] for index in range(len(windows))])
    distance = np.linalg.norm(starts - mean_directions, axis=-1).mean(axis=(1, 2))
    motion = np.linalg.norm(np.diff(starts, axis=1), axis=-1).sum(axis=1).mean(axis=-1)
    near = np.argsort(distance, kind="stable")[: max(_NUM_STARTS, len(starts) // 4)]
    calmest: dict[int, int] = {}
    for index in near[np.argsort(motion[near], kind="stable")]:
        calmest.setdefault(windows.clip_index(index), index)
    return starts[list(calmest.values())[:_NUM_STARTS]]


def speaker_identities(
    task: Task, variables: dict[str, Any], windows: Windows, names: list[str]
) -> dict[str, np.ndarray]:
    """The mean of f_id of every speaker, as E_ID sees at most eight of the training clips.

    Args:
        task: whose generator has E_ID.
        variables: of the generator.
        windows: of the training split.
        names: of its speakers, by index.

    Returns:
        name -> (18,) float32; nothing for a method that knows no identity.
    """
    if not task.identity_input:
        return {}

    def identity(speaker):
        if task.identity_input == "speaker":
            return np.asarray(encode_identity(task, variables, np.int32(speaker)))
        images = windows.reference_frames(speaker, limit=_CLIPS_PER_SPEAKER)
        return np.mean([encode_identity(task, variables, frames) for frames in images], axis=0)

    return {name: identity(speaker) for speaker, name in enumerate(names)}


@functools.partial(jax.jit, static_argnames="task")
def encode_identity(task: Task, variables: dict[str, Any], identity: jax.Array) -> jax.Array:
    """The mean of f_id (18,) for what E_ID reads of one person: images (M, S, S, 3) or the index () of a speaker."""
    mean, _ = task.generator.apply(variables, identity[None], train=False, method="encode_identity")
    return mean[0]


def to_json(assets: Assets) -> dict[str, Any]:
    """Plain values that `from_json` reads back exactly."""
    return {
        "schema_version": SCHEMA_VERSION,
        "skeleton": {"name": assets.skeleton.name}
        | {name: _numbers(getattr(assets.skeleton, name)) for name in STATISTICS},
        "vocabulary": list(assets.vocabulary.words),
        "speakers": {name: _numbers(f_id) for name, f_id in assets.speakers.items()},
        "seed_poses": _numbers(assets.seed_poses),
        "hash": assets.hash,
    }


def from_json(values: dict[str, Any]) -> Assets:
    """The assets that `to_json` wrote.

    Raises:
        KeyError, TypeError, ValueError: it did not write these.
    """
    if values["schema_version"] != SCHEMA_VERSION:
        raise ValueError(f"schema version {values['schema_version']} instead of {SCHEMA_VERSION}")
    if values["skeleton"]["name"] not in SKELETONS:
        raise ValueError(f"unknown skeleton {values['skeleton']['name']!r}")
    skeleton = load_skeleton(values["skeleton"]["name"])
    statistics = {name: np.asarray(values["skeleton"][name], np.float32) for name in STATISTICS}
    for name, found in statistics.items():
        if found.shape != getattr(skeleton, name).shape:
            raise ValueError(f"{name} has shape {found.shape} instead of {getattr(skeleton, name).shape}")
    seed_poses = np.asarray(values["seed_poses"], np.float32)
    if seed_poses.ndim != 4 or not len(seed_poses) or seed_poses.shape[2:] != (skeleton.num_bones, 3):
        raise ValueError(f"seed_poses has shape {seed_poses.shape} instead of (K, M, {skeleton.num_bones}, 3)")
    return Assets(
        skeleton=dataclasses.replace(skeleton, **statistics),
        vocabulary=Vocabulary(tuple(values["vocabulary"])),
        speakers={name: np.asarray(f_id, np.float32) for name, f_id in values["speakers"].items()},
        seed_poses=seed_poses,
        hash=str(values["hash"]),
    )


def _numbers(array: np.ndarray) -> Any:
    """Nested lists of the shortest decimals that give the same float32."""
    array = np.asarray(array, np.float32)
    return [_numbers(row) for row in array] if array.ndim else float(str(array))
