"""Assets of a trained model beside its weights: skeleton, vocabulary, styles of its speakers, seed poses."""

import dataclasses
from typing import Any

import numpy as np

from ha2g_jax.features.text import Vocabulary
from ha2g_jax.skeleton import SKELETONS, Skeleton, load_skeleton

SCHEMA_VERSION = 1

STATISTICS = ("lengths", "mean_directions", "mean_pose", "angle_mean", "angle_variance", "angle_change")


@dataclasses.dataclass(frozen=True)
class Assets:
    """Assets of a trained model.

    Attributes:
        skeleton: skeleton with the statistics of the training split.
        vocabulary: words of the training split.
        speakers: name -> (style_dim,) float32 style, in the order of the speakers' indices.
        seed_poses: (K, M, bones, 3) float32 unit vectors, calm poses that generation starts from.
        hash: hash of the weights, "" before training.
    """

    skeleton: Skeleton
    vocabulary: Vocabulary
    speakers: dict[str, np.ndarray]
    seed_poses: np.ndarray
    hash: str = ""


def to_json(assets: Assets) -> dict[str, Any]:
    """Return assets as plain values, from which `from_json` restores them exactly."""
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
    """Return the assets that `to_json` wrote.

    Args:
        values: plain values of `to_json`.

    Raises:
        KeyError, TypeError, ValueError: the values are not assets.
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
    """Return nested lists of the shortest decimals that give the same float32."""
    array = np.asarray(array, np.float32)
    return [_numbers(row) for row in array] if array.ndim else float(str(array))
